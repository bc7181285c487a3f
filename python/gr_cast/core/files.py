# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are whole or not there: written aside, then renamed."""

import fcntl
import hashlib
import json
import os
import platform
import re
import shutil
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path

from . import interrupts
from .errors import CastError

_ASIDE = ".aside-"
_PASSING = "gr-cast-"
_NAME = re.compile(r"\w[^/\\>]*")
LONGEST_NAME = 128  # bytes in UTF-8: suffixes and marks still fit into the 255 of a file system
NAME_RULE = f"a letter, digit or _ first, then any character but / \\ >, at most {LONGEST_NAME} bytes"


def _here() -> str:
    """Whose process numbers are meant, as 8 hex digits: those of this machine, in this namespace of processes."""
    machine = Path("/etc/machine-id").read_bytes() if is_file(Path("/etc/machine-id")) else b""
    return hashlib.sha256(machine + f"{platform.node()} {os.stat('/proc/self/ns/pid').st_ino}".encode()).hexdigest()[:8]


def _mine() -> str:
    """How what this process writes aside is marked."""
    return f"{_ASIDE}{_here()}-{os.getpid()}"


def is_name(text: str) -> bool:
    """Whether a text can name a node, a recording, an id: whatever becomes one step of a path. The rule: NAME_RULE."""
    return _NAME.fullmatch(text) is not None and text.isprintable() and len(text.encode()) <= LONGEST_NAME


def is_inside(name: str) -> bool:
    """Whether a name, with folders before it perhaps, stays inside the folder that it is put behind."""
    return all(is_name(step) for step in name.removeprefix("./").split("/"))


def is_file(path: Path) -> bool:
    """Whether a path names a file; a name that none can have names none."""
    try:
        return path.is_file()
    except OSError:
        return False


@contextmanager
def written_aside(path: str | Path):
    """Gives a path beside `path` to write a file or folder to; puts it in the place of `path` when all went well,
    removes it otherwise."""
    path = Path(path)
    aside = path.with_name(f"{_mine()}.{path.name}")  # the suffix stays: writers go by it
    _remove(aside)  # of a killed process that had the same number
    try:
        yield aside
        with interrupts.held_back():
            _put(aside, path)
    except OSError as error:
        if error.filename and not str(error.filename).startswith(str(aside)):
            raise
        # A write that fails, on a full disk say, does not know its file, or knows it by the name that nobody has to.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None
    finally:
        with interrupts.held_back():
            _remove(aside)


def _put(aside: Path, path: Path) -> None:
    if not (aside.is_dir() and path.is_dir()):
        os.replace(aside, path)
        return
    before = path.with_name(f"{_mine()}.before.{path.name}")  # nothing replaces a folder in one step
    os.replace(path, before)
    try:
        os.replace(aside, path)
    except OSError:
        os.replace(before, path)
        raise
    _remove(before)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        with suppress(NotADirectoryError):  # below a file there is nothing
            path.unlink(missing_ok=True)


@contextmanager
def locked(folder: Path):
    """One process at a time works in `folder`. Raises CastError if it is taken."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError:
        raise CastError(f"{folder}: another run is at work here: wait for its end, or choose another folder") from None
    finally:
        os.close(handle)


def sweep(folder: Path) -> None:
    """Remove what killed writers left aside. Only for a folder that is `locked`."""
    for left in folder.glob(f"{_ASIDE}*"):
        _remove(left)


def sweep_dead(folder: Path) -> None:
    """Remove what writers left aside that were killed and are gone; others may be at work in `folder`."""
    begins = f"{_ASIDE}{_here()}-"  # of another machine that shares the folder nothing is known
    for left in folder.glob(f"{begins}*"):
        number = left.name.removeprefix(begins).partition(".")[0]
        if number.isdigit() and not Path(f"/proc/{number}").exists():
            _remove(left)


@contextmanager
def passing_folder():
    """A new folder for a while, where the system keeps such. What killed processes of this user left there is removed first."""
    place = Path(tempfile.gettempdir())
    for left in place.glob(f"{_PASSING}*"):
        with suppress(CastError, OSError):  # it is in use, or has gone
            if left.lstat().st_uid == os.geteuid():
                with locked(left):
                    _remove_stubborn(left)
    made = Path(tempfile.mkdtemp(prefix=f".{_PASSING}"))
    with locked(made):  # before it has a name that others sweep
        folder = made.rename(place / made.name.removeprefix("."))
        (inside := folder / "gr-cast").mkdir()  # which whoever works there may lock
        try:
            yield inside
        finally:
            with interrupts.held_back():
                _remove_stubborn(folder)


def _remove_stubborn(folder: Path) -> None:
    """Remove a folder with those in it that nobody may write to: some builds make such."""
    for root, names, _ in os.walk(folder):
        for path in (Path(root, name) for name in names):
            if not path.is_symlink():
                path.chmod(0o700)
    shutil.rmtree(folder)


def check_writable(folder: Path) -> None:
    """Raises CastError where `folder` can be neither written to nor made: before the work, not after it."""
    there = next(path for path in (folder.absolute(), *folder.absolute().parents) if path.exists())
    if not there.is_dir():
        raise CastError(f"{there}: is a file, needs a folder")
    if not os.access(there, os.W_OK | os.X_OK):
        raise CastError(f"{there}: cannot be written to")


def check_target(path: str | Path) -> None:
    """Raises CastError where no file can be written under this name, in a folder that is there: before the work, not after it."""
    path = Path(path)
    check_writable(path.parent)
    if not path.parent.exists():
        raise CastError(f"{path}: no folder {path.parent}")
    if path.is_dir():
        raise CastError(f"{path}: is a folder, needs a file")


def digest_of(path: str | Path) -> str:
    """Hexadecimal SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_text(path: str | Path, text: str) -> None:
    with written_aside(path) as aside:
        aside.write_text(text, encoding="utf-8")


def write_json(path: str | Path, value) -> None:
    """JSON as the standard has it: NaN and infinities are refused, callers say null."""
    write_text(path, json.dumps(value, indent=1, allow_nan=False) + "\n")
