# SPDX-License-Identifier: GPL-3.0-or-later
"""What `cmake --install` leaves works on its own: programs without environment, the library for other modules."""

import os
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    folder = tmp_path_factory.mktemp("prefix")
    # DESTDIR leaves the build's own prefix alone.
    subprocess.run(
        ["cmake", "--install", ROOT / "build"], check=True, stdout=subprocess.DEVNULL, env=os.environ | {"DESTDIR": str(folder)}
    )
    return next(folder.rglob("bin/cast_sounder.py")).parent.parent


def run(*command, **about):
    bare = {"HOME": os.environ.get("HOME", "/"), "PATH": "/usr/bin:/bin"}
    told = subprocess.run([str(part) for part in command], capture_output=True, text=True, env=bare, timeout=300, **about)
    assert told.returncode == 0, told.stdout + told.stderr
    return told.stdout


def test_an_installed_program_runs_with_no_environment(prefix, tmp_path):
    shown = run(prefix / "bin" / "cast_sounder.py", "run", "--frames", 20, "--output", tmp_path, cwd=tmp_path)
    assert "written" in shown
    where = "import sys; sys.argv = ['x']; import _program, gr_cast; print(gr_cast.__file__)"
    found = run("/usr/bin/python3", "-c", where, cwd=prefix / "share" / "gr_cast" / "apps")
    assert Path(found.strip()).is_relative_to(prefix)


def test_another_module_can_link_the_library(prefix, tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.18)\nproject(user CXX)\nfind_package(gnuradio-cast REQUIRED)\n"
        "add_executable(user user.cc)\ntarget_link_libraries(user gnuradio::gnuradio-cast)\n"
    )
    (tmp_path / "user.cc").write_text(
        "#include <gnuradio/cast/glfsr_source.h>\n"
        "int main() { return gr::cast::glfsr_source::make(8)->mask() == 0x8E ? 0 : 1; }\n"
    )
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={prefix}", "-G", "Ninja")
    run("cmake", "--build", tmp_path / "build")
    run(tmp_path / "build" / "user")
