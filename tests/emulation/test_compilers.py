# SPDX-License-Identifier: GPL-3.0-or-later
"""The vector kernels compile with gcc and with clang, without a warning."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("kernel", ["vector_kernels", "lane_fft"])
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_vector_kernels_compile_with_either_compiler(compiler, kernel, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"NO {compiler.upper()}: the vector kernels are not compiled with it")
    options = ["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", f"-I{ROOT / 'lib'}", f"-I{ROOT / 'include'}"]
    source = ROOT / "lib" / "kernel" / f"{kernel}.cc"
    subprocess.run([compiler, *options, "-c", source, "-o", tmp_path / "kernels.o"], check=True)
