#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Installs the ray tracer and Dask in a Python environment of their own, so that GNU Radio's NumPy stays as it is.
# Run again, it does nothing where all is there, and starts anew where a run was cut short.
# Usage: bash apps/install_raytracer.sh [FOLDER]; elsewhere than the default, set CAST_RAYTRACER=FOLDER/bin/python.
#        bash apps/install_raytracer.sh --second [FOLDER]: a second tracer, which tests compare the first with; elsewhere, set
#        CAST_DIFFERT=FOLDER/bin/python.
#        bash apps/install_raytracer.sh --server [FOLDER]: Buildbot, for cast_pipeline.py serve; elsewhere, set
#        CAST_SERVER=FOLDER/bin/python.
set -euo pipefail
source "$(dirname "${BASH_SOURCE[0]}")/setup.sh"
unset PYTHONHOME PYTHONPATH PIP_PREFIX PIP_TARGET PIP_USER # each would put packages elsewhere

name=raytracer modules="distributed, sionna.rt, xarray, zarr"
sees=(--system-site-packages) # its NumPy is GNU Radio's kind, so that emulator and Dask meet in one Python
debian=(libllvm19 python3-venv) # the tracer's compiler on the CPU, older ones fail
needs_mb=2000                # about half in the end, the rest while unpacking
if [ "${1:-}" = --second ]; then
    name=differt modules=differt.geometry sees=()
    shift
elif [ "${1:-}" = --server ]; then
    name=server modules="buildbot, buildbot_worker, buildbot_www" sees=() debian=(git python3-venv) needs_mb=400
    shift
fi
lock=$(dirname "${BASH_SOURCE[0]}")/requirements/$name.lock
folder=${1:-${XDG_DATA_HOME:-${HOME:?is not set: name a FOLDER}/.local/share}/gr_cast/$name}
folder=${folder%/}
mark=$folder/made-by-gr_cast # in folders that this script made, the only ones that it removes

fail() { echo "error: $*" >&2; exit 2; }

starts() {
    "$folder/bin/python" -W ignore -c "
import glob, os
os.environ.update({'DRJIT_LIBLLVM_PATH': path for path in glob.glob('/usr/lib/*/libLLVM.so.19.1')})
import $modules"
}

remove() {
    local away
    away=$(mktemp -d "$folder.removed-XXXXXX")
    mv "$folder" "$away" && rm -rf "$away"
}

if [ -x "$folder/bin/python" ] && starts 2>/dev/null; then
    echo "$folder: installed"
    cmp -s "$lock" "$folder/installed.lock" || echo "its versions are not those of $lock: remove the folder and run this again to have these"
    exit
fi
[ ! -e "$folder" ] || [ -e "$mark" ] || fail "$folder: is there, and not made by this script: choose another folder"
[ ! -e "$mark" ] || remove # a run was cut short
mkdir -p "$folder" 2>/dev/null && : 2>/dev/null >"$mark" || fail "$folder: cannot be made"
trap remove EXIT # what is there works, or is not there
free_mb=$(($(df -Pk "$folder" | awk 'NR == 2 {print $4}') / 1024))
[ "$free_mb" -ge "$needs_mb" ] || fail "$folder: $free_mb MB free on this disk, needs $needs_mb MB"
install_missing "${debian[@]}"
say "installing $name from PyPI in $folder, $(grep -c == "$lock") releases"
/usr/bin/python3 -m venv "${sees[@]}" "$folder"
"$folder/bin/python" -m pip install -q --retries 2 --only-binary :all: --require-hashes -r "$lock" ||
    fail "PyPI: the packages did not install, the lines above say why (network, proxy, disk); nothing else has changed"
starts || fail "$folder: what was installed does not start, the lines above say why"
cp "$lock" "$folder/installed.lock"
trap - EXIT
echo "$folder: installed"
