# SPDX-License-Identifier: GPL-3.0-or-later
"""What `cmake --install` leaves works on its own: programs without environment, the library for other modules."""

import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BUILD = Path(os.environ.get("CAST_BUILD", ROOT / "build"))


def install_in(folder: Path) -> Path:
    """The prefix of an install below a folder; DESTDIR leaves the build's own prefix alone."""
    command = ["cmake", "--install", BUILD]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=os.environ | {"DESTDIR": str(folder)})
    return next(folder.rglob("bin/cast_sounder")).parent.parent


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    return install_in(tmp_path_factory.mktemp("prefix"))


def run(*command, env=None, **about):
    bare = {"HOME": os.environ.get("HOME", "/"), "PATH": "/usr/bin:/bin"} | (env or {})
    told = subprocess.run([str(part) for part in command], capture_output=True, text=True, env=bare, timeout=300, **about)
    assert told.returncode == 0, told.stdout + told.stderr
    return told.stdout


def test_an_installed_program_runs_with_no_environment(prefix, tmp_path):
    shown = run(prefix / "bin" / "cast_sounder", "run", "--frames", 20, "--output", tmp_path, cwd=tmp_path)
    assert "written" in shown
    where = "import sys; sys.argv = ['x']; import _program, gr_cast; print(gr_cast.__file__)"
    found = run("/usr/bin/python3", "-c", where, cwd=prefix / "share" / "gr_cast" / "apps")
    assert Path(found.strip()).is_relative_to(prefix)


def test_a_checkout_may_lie_in_the_root_folder():
    """As in a container, where /src/apps has no three folders above it."""
    if subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode:
        pytest.skip("NO NAMESPACES: a checkout cannot be mounted in the root folder")
    programs = "; ".join(
        f"/usr/bin/python3 /mnt/apps/cast_{name}" for name in ("sounder.py --version", "grc.py --version", "doctor.py")
    )
    mounted = ["unshare", "-rm", "sh", "-c", f"mount --rbind '{ROOT}' /mnt && {{ {programs}; }}"]
    told = subprocess.run(mounted, capture_output=True, text=True, timeout=300)
    assert "Traceback" not in told.stderr and "in /mnt/" in told.stdout, told.stderr


def test_every_file_of_the_package_is_installed_with_its_run_bits(prefix):
    """Git is the judge of what the package is: a container that an install builds had no radio API."""
    told = subprocess.run(["git", "-C", ROOT, "ls-files", "-s", "python/gr_cast"], capture_output=True, text=True)
    if told.returncode or not told.stdout:
        pytest.skip("NO GIT REPOSITORY: what belongs to the package is not known")
    installed = next(prefix.rglob("gr_cast/__init__.py")).parent
    for line in told.stdout.splitlines():
        about, name = line.split("\t")
        path = installed / Path(name).relative_to("python/gr_cast")
        if "bindings" not in path.parts and path.name != "CMakeLists.txt":
            assert path.is_file(), f"{name} is not installed"
            assert not about.startswith("100755") or os.access(path, os.X_OK), f"{name} has no run bit"


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


PROGRAMS = sorted(path.stem for path in (ROOT / "apps").glob("cast_*.py"))


def test_programs_have_no_suffix_a_manual_page_and_a_version(prefix):
    assert sorted(path.name for path in (prefix / "bin").iterdir()) == PROGRAMS
    for name in PROGRAMS:
        page = run("man", "--warnings", "-l", prefix / "share" / "man" / "man1" / f"{name}.1", env={"MANWIDTH": "80"})
        assert re.search(rf"NAME\n +{name} +- +\S", page) and "EXIT STATUS" in page
    assert re.fullmatch(r"cast_sounder \d+\.\d+\.\d+ \(gr-cast\)\n", run(prefix / "bin" / "cast_sounder", "--version"))


def test_a_shell_completes_commands_and_options(prefix):
    pytest.importorskip("argcomplete", reason="NO ARGCOMPLETE: completion is not tested")

    def completed(line):
        script = (
            f"source {prefix}/share/bash-completion/completions/cast_sounder\n"
            f'COMP_LINE={line!r} COMP_POINT={len(line)} COMP_TYPE=9\n_python_argcomplete cast_sounder\necho "${{COMPREPLY[@]}}"'
        )
        return run("bash", "-c", script, env={"PATH": f"{prefix}/bin:/usr/bin:/bin"}).split()

    assert completed("cast_sounder pro") == ["process"]
    assert {"--scenario", "--all-links"} <= set(completed("cast_sounder run --"))


def test_the_doctor_names_the_lines_with_which_gnu_radio_finds_an_install_anywhere(prefix, tmp_path):
    """Before: three things are missing and three lines are printed; with those lines alone all is found, by grcc too."""
    bare = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    ill = subprocess.run([prefix / "bin" / "cast_doctor"], capture_output=True, text=True, env=bare, timeout=60)
    lines = re.findall(r"export \S+", ill.stdout)
    assert ill.returncode == 1 and len(lines) == ill.stdout.count("MISSING") == 3
    cured = "\n".join(lines)
    well = run("bash", "-c", f"{cured}\ncast_doctor", env=bare)
    assert "all that GNU Radio needs is found" in well
    flowgraph = prefix / "share" / "gr_cast" / "apps" / "flowgraphs" / "loopback_headless.grc"
    run("bash", "-c", f"{cured}\ngrcc -o {tmp_path} {flowgraph}", env=bare)
    heard = tmp_path / "heard.cf32"
    run("bash", "-c", f"{cured}\n/usr/bin/python3 {tmp_path}/loopback_headless.py -n 3 -o {heard}", env=bare)
    assert heard.stat().st_size == 3 * 511 * 8


def test_the_blocks_are_in_gnu_radios_own_package_too(prefix):
    package = next(prefix.glob("lib/python3*/*-packages"))
    shown = run(
        "/usr/bin/python3", "-c", "from gnuradio import blocks, cast; print(cast.channel_emulator)", env={"PYTHONPATH": package}
    )
    assert "gr_cast" in shown


def test_uninstall_leaves_nothing_of_an_install(tmp_path):
    install_in(tmp_path)
    run("cmake", "-P", ROOT / "cmake" / "uninstall.cmake", cwd=BUILD, env={"DESTDIR": str(tmp_path)})
    left = [path for path in tmp_path.rglob("*") if path.is_symlink() or path.is_file() or "cast" in path.name]
    assert left == []
