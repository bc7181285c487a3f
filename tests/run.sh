#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Installs what is missing, builds, and runs every check: style, C++ tests with sanitizers, pytest.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/../apps/setup.sh"

test_packages=(
    python3-pytest python3-hypothesis python3-pytest-timeout python3-pytest-xdist python3-distributed mgen iperf3 iproute2
    xvfb xauth gir1.2-gtk-3.0 x11-apps imagemagick clang-format python3-venv man-db
    python3-sphinx python3-myst-parser python3-nbsphinx python3-jsonschema pandoc
)
install_missing "${run_packages[@]}" "${test_packages[@]}"
build "$root/build"
build "$root/build-sanitize" -DCAST_SANITIZE=ON -DCMAKE_BUILD_TYPE=RelWithDebInfo

# Tools that Debian does not package, apart from GNU Radio's own Python packages.
tools=$root/build/tools lock=$root/apps/requirements/checks.lock
if ! cmp -s "$lock" "$tools/installed.lock"; then
    say "installing ruff, mypy and sigmf in build/tools"
    /usr/bin/python3 -m venv "$tools"
    "$tools/bin/python" -m pip install -q --only-binary :all: --require-hashes -r "$lock"
    cp "$lock" "$tools/installed.lock"
fi

cd "$root"
say "style"
"$tools/bin/ruff" check -q python apps tests docs
"$tools/bin/ruff" format --check -q python apps tests docs
"$tools/bin/mypy"
git ls-files '*.cc' '*.h' '*.cu' | xargs clang-format --dry-run --Werror

say "C++ tests, plain and with sanitizers"
[ -w "${HOME:-}" ] || export HOME=$root/build # GNU Radio's transforms keep a lock there
ctest --test-dir build --output-on-failure
ctest --test-dir build-sanitize --output-on-failure

say "pytest"
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 # two tests run at once: products in threads wait for each other
exec /usr/bin/python3 -m pytest tests -q -n 2 --dist loadfile "$@"
