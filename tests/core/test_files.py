# SPDX-License-Identifier: GPL-3.0-or-later
"""What is written is whole or not there, and what was there stays until then."""

import errno
import os
import re
import subprocess
import sys
import tempfile

import pytest
from gr_cast.core import files
from gr_cast.core.errors import CastError


def folder_of(path, text):
    path.mkdir()
    (path / "file").write_text(text)


def test_a_folder_that_cannot_be_put_in_place_leaves_the_one_before(tmp_path, monkeypatch):
    folder_of(tmp_path / "out", "old")
    real, calls = os.replace, []

    def replace(source, target):
        calls.append(target)
        if len(calls) == 2:  # the old one is out of the way, the new one does not get there
            raise OSError(errno.EIO, "disk", str(source))
        real(source, target)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises(OSError), files.written_aside(tmp_path / "out") as aside:
        folder_of(aside, "new")
    monkeypatch.undo()
    assert (tmp_path / "out" / "file").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    with files.written_aside(tmp_path / "out") as aside:
        folder_of(aside, "new")
    assert (tmp_path / "out" / "file").read_text() == "new" and len(list(tmp_path.iterdir())) == 1


def test_what_fails_while_it_is_written_leaves_nothing(tmp_path):
    (tmp_path / "out").write_text("old")
    with pytest.raises(ZeroDivisionError), files.written_aside(tmp_path / "out") as aside:
        aside.write_text("half")
        1 / 0  # noqa: B018
    assert (tmp_path / "out").read_text() == "old" and len(list(tmp_path.iterdir())) == 1


def test_only_what_dead_writers_left_is_swept(tmp_path):
    with files.written_aside(tmp_path / "x") as living:
        mine = living.name.removesuffix(f"{os.getpid()}.x")
        dead = tmp_path / f"{mine}4194999.x"
        for path in (living, dead, tmp_path / "x"):
            path.touch()
        files.sweep_dead(tmp_path)
        assert living.exists() and not dead.exists() and (tmp_path / "x").exists()


@pytest.mark.parametrize("place", [("unshare", "--uts", "sh", "-c", 'hostname other && exec "$@"', "-"), ("unshare", "-pf")])
def test_what_another_machine_or_container_writes_aside_in_a_shared_folder_is_not_swept(place, tmp_path):
    """Their process numbers are not ours: who is 4 there may be nobody here."""
    code = """if True:
        import sys
        from gr_cast.core.files import written_aside
        with written_aside(sys.argv[1]) as aside:
            aside.touch()
            print(flush=True)
            input()
            print(aside.exists())"""
    about = os.environ | {"PYTHONPATH": str(files.Path(files.__file__).parents[2])}
    words = [*place, sys.executable, "-c", code, str(tmp_path / "x")]
    there = subprocess.Popen(words, env=about, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if there.stdout.readline() != "\n":
        pytest.skip(f"no namespaces: {there.communicate()[1]}")
    (aside,) = tmp_path.iterdir()
    with_dead_number = aside.rename(tmp_path / re.sub(r"\d+(?=\.x$)", "4194999", aside.name))
    files.sweep_dead(tmp_path)
    assert with_dead_number.exists()
    with_dead_number.rename(aside)
    assert there.communicate("\n")[0] == "True\n"


def test_a_folder_for_a_while_goes_with_its_process_or_with_the_next_one(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    code = """if True:
        import os, signal
        from gr_cast.core.files import passing_folder
        with passing_folder() as folder:
            (folder / "stays").mkdir(mode=0o500)
            os.symlink("/", folder / "root")
            os.kill(os.getpid(), signal.SIGKILL)"""
    words = [sys.executable, "-c", code]
    about = {"TMPDIR": str(tmp_path), "PYTHONPATH": str(files.Path(files.__file__).parents[2])}
    assert subprocess.run(words, env=os.environ | about, check=False).returncode == -9
    (killed,) = tmp_path.iterdir()
    with files.passing_folder() as mine, files.passing_folder() as other:
        (mine / "locked").mkdir(mode=0o500)
        assert set(tmp_path.iterdir()) == {mine.parent, other.parent} and killed not in (mine.parent, other.parent)
        with files.locked(mine):  # as who works in a folder does
            pass
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_to_is_refused_before_the_work(tmp_path):
    files.check_writable(tmp_path / "not" / "yet" / "there")
    (tmp_path / "file").touch()
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(CastError, match="file: is a file, needs a folder"):
            files.check_writable(place)
    with pytest.raises(CastError, match="cannot be written"):
        files.check_writable(next(p for p in map(files.Path, ("/proc/1", "/sys")) if not os.access(p, os.W_OK)) / "x")


def test_a_file_that_cannot_be_written_is_refused_before_the_work_and_by_its_own_name(tmp_path):
    (tmp_path / "file").touch()
    files.check_target(tmp_path / "file")
    files.check_target(tmp_path / "new")
    for path, said in (("file/x", "file: is a file, needs a folder"), ("not/x", "no folder .*not"), (".", "is a folder")):
        with pytest.raises(CastError, match=said):
            files.check_target(tmp_path / path)
    with pytest.raises(NotADirectoryError) as error:
        files.write_text(tmp_path / "file" / "x", "")
    assert error.value.filename == str(tmp_path / "file" / "x")  # not the name that it has aside
