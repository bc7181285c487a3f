#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# What works here must work elsewhere. Each part runs in a folder of its own, which is removed in the end.
# Usage: bash tests/bench/compat.sh user [PYTEST ARGUMENT…]             without root, HOME not writable, spaces in the path: demo and suite
#        bash tests/bench/compat.sh python PYTHON [PYTEST ARGUMENT…]    that Python, newest NumPy and pytest (PyPI): tests without GNU Radio
#        bash tests/bench/compat.sh system SUITE [PYTEST ARGUMENT…]     a fresh Debian or Ubuntu with its own GNU Radio: built and tested; root, debootstrap
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
part=${1:-}
shift || true
work=$(mktemp -d "${TMPDIR:-/tmp}/gr_cast.XXXXXX")
trap 'rm -rf --one-file-system "$work"' EXIT

as_user() { # without root's rights, in a home that nothing can be written to
    local other=()
    [ "$(id -u)" -ne 0 ] || other=(setpriv --reuid=65534 --regid=65534 --clear-groups)
    "${other[@]}" env -u XDG_DATA_HOME -u XDG_CACHE_HOME -u XDG_CONFIG_HOME HOME="$work/home" TMPDIR="$work/tmp" "$@"
}

case $part in
user)
    git clone -q "$root" "$work/a checkout"
    mkdir -p "$work/home" "$work/tmp"
    [ "$(id -u)" -ne 0 ] || chown -R 65534:65534 "$work"
    chmod a-w "$work/home"
    cd "$work/a checkout"
    as_user bash apps/demo.sh
    as_user bash tests/run.sh "$@"
    ;;
python)
    python=${1:?PYTHON is missing, such as python3.12}
    shift
    "$python" -m venv "$work/venv"
    "$work/venv/bin/python" -m pip install -q 'numpy>=2' 'pytest>=9' scipy matplotlib pyyaml pyzmq hypothesis pytest-timeout pytest-xdist
    "$work/venv/bin/python" -m pip freeze
    cd "$root"
    # Tests of programs and of boxes start Debian's Python, and those of blocks need its GNU Radio.
    mapfile -t tests < <(grep -rLE 'gnuradio|blocks|cmake|apps/|PROGRAM|diagnose_bank' tests --include='test_*.py' | grep -vE 'tests/(apps|blocks|colosseum)')
    # As the programs have it: threads that wait for each other in small products took a hundred times as long.
    OPENBLAS_NUM_THREADS=1 CAST_BUILD=$root "$work/venv/bin/python" -B -m pytest -q -p no:cacheprovider "${tests[@]}" "$@"
    ;;
system)
    suite=${1:?SUITE is missing, such as trixie or noble}
    shift
    system=$work/system
    trap 'umount "$system/proc" "$system/dev" 2>/dev/null || true; rm -rf --one-file-system "$work"' EXIT
    cp -a /usr/share/debootstrap "$work/debootstrap"
    [ -e "$work/debootstrap/scripts/$suite" ] || ln -s gutsy "$work/debootstrap/scripts/$suite" # an Ubuntu younger than debootstrap
    components=main
    [ "$(readlink "$work/debootstrap/scripts/$suite")" != gutsy ] || components=main,universe
    DEBOOTSTRAP_DIR=$work/debootstrap debootstrap --variant=minbase --components="$components" "$suite" "$system" >/dev/null
    mount -t proc proc "$system/proc"
    mount --bind /dev "$system/dev"
    git clone -q "$root" "$system/root/a checkout"
    source "$root/apps/setup.sh"
    more=(python3-pytest python3-hypothesis python3-pytest-timeout python3-pytest-xdist git)
    chroot "$system" apt-get update -qq
    chroot "$system" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${run_packages[@]}" "${more[@]}" >/dev/null
    chroot "$system" bash -c 'cd "/root/a checkout" && source apps/setup.sh && build "$root/build" && /usr/bin/python3 -m pytest -q "$@"' - "$@"
    ;;
*)
    sed -n 's/^# \?//;4,6p' "${BASH_SOURCE[0]}" >&2
    exit 2
    ;;
esac
