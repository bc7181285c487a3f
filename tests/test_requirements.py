# SPDX-License-Identifier: GPL-3.0-or-later
"""Optional tools: exact releases with hashes, in folders that are ours alone."""

import os
import re
import subprocess
from pathlib import Path

import pytest

APPS = Path(__file__).resolve().parent.parent / "apps"
LOCKS = sorted((APPS / "requirements").glob("*.lock"))
RELEASE = re.compile(r"([\w.-]+)==([\w.+]+)( ; [^\\]+)? \\\n((?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+)")


@pytest.mark.parametrize("lock", LOCKS, ids=lambda lock: lock.stem)
def test_every_release_is_exact_and_hashed_and_no_address_is_written(lock):
    text = lock.read_text()
    body = re.sub(r"^#.*\n", "", text, flags=re.MULTILINE)
    assert RELEASE.sub("", body) == "" and "//" not in text
    releases = {name: version for name, version, *_ in RELEASE.findall(body)}
    wanted = [line for line in lock.with_suffix(".in").read_text().split("\n") if line and not line.startswith("#")]
    assert {re.split("[<>=]", line)[0] for line in wanted} <= set(releases)
    if "numpy<2" in wanted:
        assert releases["numpy"].startswith("1.")


def test_every_list_of_tools_has_a_lock():
    assert [lock.stem for lock in LOCKS] == sorted(path.stem for path in (APPS / "requirements").glob("*.in")) != []


@pytest.fixture
def install(tmp_path):
    """install(FOLDER): the run of install_raytracer.sh, which thinks that Debian's packages are there and finds no PyPI."""
    stubs = tmp_path / "stubs"
    stubs.mkdir()
    (stubs / "dpkg-query").write_text("#!/bin/sh\necho install ok installed\n")
    (stubs / "dpkg-query").chmod(0o755)
    lost = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(stubs), "PIP_EXTRA_INDEX_URL": "", "PIP_CONFIG_FILE": os.devnull}

    def run(*arguments, **environment):
        about = os.environ | lost | {"PATH": f"{stubs}:/usr/bin:/bin"} | environment
        command = ["bash", APPS / "install_raytracer.sh", *arguments]
        return subprocess.run(command, env=about, capture_output=True, text=True, timeout=300)

    return run


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_an_install_that_goes_on_after_a_cut_and_fails_leaves_nothing_and_removes_nothing_that_was_there(install, tmp_path):
    home = tmp_path / "a home"
    for kept in ("tracer.removed", "tracer.removed-x", "other"):
        (home / kept).mkdir(parents=True)
        (home / kept / "mine").write_text("kept")
    before = files(home)
    (home / "tracer").mkdir()
    for left in ("made-by-gr_cast", "half"):
        (home / "tracer" / left).write_text("of a run that was cut short")
    done = install(f"{home / 'tracer'}/")
    assert done.returncode == 2 and "packages did not install" in done.stderr, done.stderr
    assert files(home) == before and not (home / "tracer").exists() and len(list(home.iterdir())) == 3


@pytest.mark.parametrize("mine", ["pyvenv.cfg", "notes.txt", None])
def test_a_folder_that_the_install_did_not_make_is_refused(install, tmp_path, mine):
    folder = tmp_path / "mine"
    folder.mkdir()
    if mine:
        (folder / mine).write_text("kept")
    before = files(folder)
    done = install(folder)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "not made by this script" in done.stderr
    assert folder.is_dir() and files(folder) == before


def test_a_home_that_cannot_be_written_to_is_told_in_one_line(install):
    done = install(HOME="/proc/self/home", XDG_DATA_HOME="")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1) and "/proc/self/home/.local/share" in done.stderr
