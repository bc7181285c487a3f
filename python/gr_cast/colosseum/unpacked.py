# SPDX-License-Identifier: GPL-3.0-or-later
"""Images unpacked once and shared by all containers, which only read them: each writes to a layer of its own."""

import contextlib
import fcntl
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

from ..core.errors import CastError
from ..core.files import digest_of, written_aside
from . import image as images
from .container import INIT

_LOCK = ".lock"


def unpacked(path: Path, cache: Path) -> Path:
    """The root of an image, unpacked below `cache` where it is not yet. Raises CastError for what is none."""
    folder = cache / digest_of(path)[:32]
    if folder.is_dir():
        return folder / "rootfs"
    images.read(path)  # refuses what leaves its folder
    cache.mkdir(parents=True, exist_ok=True, mode=0o700)
    with written_aside(folder) as aside:
        aside.mkdir(mode=0o755)
        words = ["tar", "-xpf", str(path), "-C", str(aside), "--numeric-owner", "--delay-directory-restore"]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        root = aside / "rootfs"
        if done.returncode or not root.is_dir():
            raise CastError(f"{path}: cannot be unpacked: {done.stderr.strip().splitlines()[:1]}")
        for place in ("proc", "sys", "dev", "tmp", "run", "root", "logs"):
            if not (root / place).is_symlink():
                (root / place).mkdir(exist_ok=True)
        if not (root / "sbin/init").exists() and not (root / "sbin/init").is_symlink():
            (root / ".init").write_text(INIT)
            (root / ".init").chmod(0o755)
    return folder / "rootfs"


@contextlib.contextmanager
def held(cache: Path) -> Iterator[None]:
    """While this lasts, also of a process that is killed in it, nobody removes unpacked images."""
    cache.mkdir(parents=True, exist_ok=True, mode=0o700)
    with open(cache / _LOCK, "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        yield


def kept(cache: Path) -> list[Path]:
    """The images that lie there unpacked."""
    return (
        [path for path in sorted(cache.iterdir()) if path.is_dir() and path.name[0] != "."]
        if os.access(cache, os.R_OK | os.X_OK)
        else []
    )


def remove_unused(cache: Path) -> tuple[int, int]:
    """(number, bytes) of the unpacked images that are removed: all where nobody holds them, else none."""
    if not cache.is_dir():
        return 0, 0
    with open(cache / _LOCK, "w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return 0, 0
        found = kept(cache)
        size = used_bytes(*found)
        for folder in found:
            shutil.rmtree(folder)
        return len(found), size


def used_bytes(*folders: Path) -> int:
    """What folders take on the disk; links are not followed."""
    total = 0
    for folder in folders:
        for place, _, names in os.walk(folder):
            for name in names:
                try:
                    total += os.lstat(os.path.join(place, name)).st_blocks * 512
                except OSError:
                    continue
    return total


def copy_logs(source: Path, target: Path) -> None:
    """Copy what containers left in /logs: files, folders and links as they are, nothing that is read without an end."""

    def special(folder: str, names: list[str]) -> list[str]:
        return [n for n in names if not (os.path.islink(p := os.path.join(folder, n)) or os.path.isfile(p) or os.path.isdir(p))]

    shutil.copytree(source, target, symlinks=True, ignore=special, dirs_exist_ok=True)
