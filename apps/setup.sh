# SPDX-License-Identifier: GPL-3.0-or-later
# Sourced by demo.sh and tests/run.sh: installs what is missing, then builds. Quick when nothing is missing.

say() { printf '\n== %s\n' "$*"; }

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
export GR_DONT_LOAD_PREFS=1 MPLBACKEND=Agg

run_packages=(
    gnuradio gnuradio-dev libuhd-dev python3-uhd pybind11-dev libspdlog-dev libsndfile1-dev libgmp-dev libzmq3-dev
    g++ cmake ninja-build
    python3-argcomplete python3-numpy python3-scipy python3-matplotlib python3-yaml python3-zmq
)

# install_missing PACKAGE…: asks dpkg first, so that a second run needs no network and no rights.
install_missing() {
    local missing=()
    for package in "$@"; do
        dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
    done
    [ ${#missing[@]} -eq 0 ] && return
    say "installing ${missing[*]}"
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        command -v sudo >/dev/null || { echo "error: not root and no sudo: install ${missing[*]}" >&2; exit 2; }
        as_root=(sudo)
    fi
    "${as_root[@]}" apt-get update -qq
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
}

# build FOLDER [CMAKE_OPTION…]
build() {
    local folder=$1
    shift
    local hint=
    [ -e "$folder/build.ninja" ] || hint=" (some minutes the first time; log: ${folder#"$root"/}.log)"
    say "building in ${folder#"$root"/}$hint"
    cmake -S "$root" -B "$folder" -G Ninja "$@" >"$folder.log" 2>&1 &&
        cmake --build "$folder" >>"$folder.log" 2>&1 ||
        { tail -n 40 "$folder.log" >&2; echo "error: build failed, whole log in $folder.log" >&2; exit 1; }
    rm -f "$folder.log"
}
