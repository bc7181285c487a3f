#!/usr/bin/env bash
set -euo pipefail
cmake -S . -B build-conda -G Ninja ${CMAKE_ARGS} \
    -DCMAKE_INSTALL_PREFIX="$PREFIX" -DPYTHON_EXECUTABLE="$PYTHON" -DPython3_EXECUTABLE="$PYTHON" \
    -DCAST_PYTHON_DIR="${SP_DIR#"$PREFIX"/}" -DBUILD_TESTING=OFF
cmake --build build-conda --parallel "${CPU_COUNT}"
cmake --install build-conda
