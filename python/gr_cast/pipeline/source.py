# SPDX-License-Identifier: GPL-3.0-or-later
"""The stack's repository, mirrored in the storage: its commits, their parents and their files."""

import re
import subprocess
from pathlib import Path

from ..core.errors import CastError
from .stages import fingerprint


class Source:
    """A mirror of a repository: an address or a folder."""

    def __init__(self, address: str, storage: Path):
        local = Path(address)
        self.address = str(local.resolve()) if local.is_dir() else address
        slug = re.sub(r"[^\w.-]+", "-", Path(self.address).name.removesuffix(".git")) or "stack"
        self.name = f"{slug}-{fingerprint(self.address)[:8]}"
        self._mirror = storage / "repositories" / f"{self.name}.git"

    def update(self) -> None:
        """Fetch what is new."""
        if not (self._mirror / "HEAD").is_file():
            _git("clone", "--quiet", "--mirror", "--", self.address, str(self._mirror))
        else:
            self._told("fetch", "--quiet", "--prune", "origin", "+refs/*:refs/*")

    def commit(self, name: str) -> str:
        """The full hash of a commit by any name that Git knows."""
        try:
            return self._told("rev-parse", "--verify", "--quiet", "--end-of-options", f"{name}^{{commit}}").strip()
        except CastError:
            raise CastError(f"{self.address}: got {name!r}, needs a commit of this repository") from None

    def parent(self, commit: str) -> str | None:
        """The first parent, None of a first commit."""
        parents = self._told("rev-list", "--parents", "-n", "1", commit).split()[1:]
        return parents[0] if parents else None

    def subject(self, commit: str) -> str:
        return self._told("log", "-1", "--format=%s", commit).strip()

    def time_s(self, commit: str) -> int:
        """When it was committed, seconds of 1970: the date of all that is made of it."""
        return int(self._told("log", "-1", "--format=%ct", commit))

    def tree(self, commit: str) -> str:
        """The hash of its files."""
        return self._told("rev-parse", f"{commit}^{{tree}}").strip()

    def between(self, good: str, bad: str) -> list[str]:
        """Commits after `good` up to `bad`, the oldest first, along first parents. Raises CastError if `good` is no ancestor."""
        if subprocess.run(["git", "-C", self._mirror, "merge-base", "--is-ancestor", good, bad], check=False).returncode:
            raise CastError(f"{good[:12]} is no ancestor of {bad[:12]}: nothing lies between them")
        return self._told("rev-list", "--reverse", "--first-parent", f"{good}..{bad}").split()

    def check_out(self, commit: str, folder: Path) -> None:
        """Write the files of a commit, and nothing of Git's, into a new folder."""
        folder.mkdir(parents=True)
        archive = folder.with_name(f"{folder.name}.tar")
        self._told("archive", f"--output={archive}", commit)
        subprocess.run(["tar", "-x", "-C", folder, "-f", archive], check=True)
        archive.unlink()

    def _told(self, *words: str) -> str:
        return _git("-C", str(self._mirror), *words)


def _git(*words: str) -> str:
    try:
        done = subprocess.run(["git", *words], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise CastError("git: not installed") from None
    if done.returncode:
        raise CastError(f"git {words[-1]}: {' '.join(done.stderr.split()) or 'failed without a word'}")
    return done.stdout
