# SPDX-License-Identifier: GPL-3.0-or-later
"""An image: a tarball as LXC and LXD take it, `rootfs/` with metadata beside it, looked into without unpacking it."""

import posixpath
import re
import shutil
import stat
import subprocess
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import CastError
from .storage import split_suffix

RADIO_API = "/root/radio_api"
METADATA = "metadata.yaml"
_METADATA_KEYS = ("architecture", "creation_date")  # without which LXD takes no image
OWN_PLACES = ("/root/", "/opt/", "/home/", "/srv/", "/usr/local/")  # where a team's own programs lie
MOST_FILES = 2_000_000
MOST_TEXT = 1 << 20  # bytes of a program that is read
_LINKS = 40


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A file of an image: its mode with type, its bytes, where it links to."""

    mode: int
    size: int
    target: str = ""


@dataclass(frozen=True, kw_only=True)
class Image:
    """Every path of an image to its entry, and the text of the team's own programs."""

    path: Path
    entries: dict[str, Entry]
    texts: dict[str, str]
    metadata: str | None = None

    @property
    def metadata_faults(self) -> list[str]:
        """What is wrong with the metadata beside `rootfs/`."""
        if self.metadata is None:
            return [f"missing: LXD takes no image without it: needs {' and '.join(_METADATA_KEYS)}"]
        return [f"{key} is missing" for key in _METADATA_KEYS if not re.search(rf"(?m)^\W*{key}\W*:", self.metadata)]

    def resolved(self, path: str) -> str:
        """A path of the image with links followed, as a container would."""
        path = posixpath.normpath(path)
        for _ in range(_LINKS):
            steps = path.strip("/").split("/")
            heads = ["/" + "/".join(steps[: n + 1]) for n in range(len(steps))]
            link = next((head for head in heads if head in self.entries and self.entries[head].target), None)
            if link is None:
                break
            target = posixpath.join(posixpath.dirname(link), self.entries[link].target)
            path = posixpath.normpath(target + path[len(link) :])
        return path

    def entry(self, path: str) -> Entry | None:
        return self.entries.get(self.resolved(path))

    @property
    def size(self) -> int:
        """Bytes once unpacked."""
        return sum(entry.size for entry in self.entries.values())


@contextmanager
def opened(path: Path) -> Iterator[tarfile.TarFile]:
    """The tarball's members one after the other. CastError where it is none; Zstandard goes through `zstd`."""
    unpacker = None
    try:
        if split_suffix(path.name)[1] == ".tar.zst":
            if shutil.which("zstd") is None:
                raise CastError(f"{path}: zstd: not installed (Debian: apt install zstd)")
            unpacker = subprocess.Popen(["zstd", "-dcq", path], stdout=subprocess.PIPE)
            tar = tarfile.open(fileobj=unpacker.stdout, mode="r|")
        else:
            tar = tarfile.open(path, mode="r|*")
        with tar:
            yield tar
    except (tarfile.TarError, EOFError, OSError, ValueError) as error:
        if isinstance(error, OSError) and error.filename:
            raise
        raise CastError(f"{path}: not a tarball: {' '.join(str(error).split())}") from None
    finally:
        if unpacker:
            unpacker.stdout.close()
            unpacker.kill()
            unpacker.wait()


def read(path: Path) -> Image:
    """Look into an image. Raises CastError where it is no tarball or what it holds could not be unpacked safely."""
    entries, texts, faults, metadata = {}, {}, [], None
    with opened(path) as tar:
        for count, member in enumerate(tar):
            if count >= MOST_FILES:
                raise CastError(f"{path}: got more than {MOST_FILES} files, limit {MOST_FILES}")
            if ".." in member.name.split("/") or member.name.startswith("/"):
                faults.append(f"{path}: {member.name!r}: leaves the image: needs names without .. and no / at the beginning")
                continue
            name = posixpath.normpath(member.name)
            if name == METADATA and member.isreg() and member.size <= MOST_TEXT:
                metadata = tar.extractfile(member).read().decode("utf-8", errors="replace")
            if not name.startswith("rootfs/"):
                continue
            place = name.removeprefix("rootfs")
            target = member.linkname if member.issym() else ""
            entries[place] = Entry(mode=member.mode | _kind(member), size=member.size if member.isreg() else 0, target=target)
            if member.islnk():
                entries[place] = entries.get("/" + posixpath.normpath(member.linkname).removeprefix("rootfs/"), entries[place])
            if member.isreg() and place.startswith(OWN_PLACES) and member.size <= MOST_TEXT:
                data = tar.extractfile(member).read()
                if b"\0" not in data:
                    texts[place] = data.decode("utf-8", errors="replace")
    if faults:
        raise CastError(*faults[:20])
    if not entries:
        raise CastError(f"{path}: no rootfs/ in it: needs an LXC or LXD image, not split")
    return Image(path=path, entries=entries, texts=texts, metadata=metadata)


def _kind(member: tarfile.TarInfo) -> int:
    if member.isdir():
        return stat.S_IFDIR
    return stat.S_IFLNK if member.issym() else stat.S_IFREG
