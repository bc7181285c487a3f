#!/usr/bin/env bash
# SPDX-License-Identifier: GPL-3.0-or-later
# Installs the ray tracer and Dask in a Python environment of their own, so that GNU Radio's NumPy stays as it is.
# Usage: bash apps/install_raytracer.sh [FOLDER]; elsewhere than the default, set CAST_RAYTRACER=FOLDER/bin/python.
set -euo pipefail
folder=${1:-${XDG_DATA_HOME:-$HOME/.local/share}/gr_cast/raytracer}

if [ ! -e /usr/lib/x86_64-linux-gnu/libLLVM.so.19.1 ]; then
    sudo=$([ "$(id -u)" = 0 ] || echo sudo)
    $sudo apt-get update -q
    $sudo apt-get install -y -q libllvm19 python3-venv # its compiler on the CPU; older ones fail
fi
[ -x "$folder/bin/python" ] || /usr/bin/python3 -m venv --system-site-packages "$folder"
"$folder/bin/pip" install -q "numpy<2" sionna-rt dask distributed xarray zarr
"$folder/bin/python" -W ignore -c 'import sionna.rt; print("ray tracer", sionna.rt.__version__)'
