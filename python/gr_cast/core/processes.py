# SPDX-License-Identifier: GPL-3.0-or-later
"""Programs of others that run beside this one: started, watched, and ended with it, however it ends."""

import subprocess
import time
from pathlib import Path

from .errors import CastError

_PATIENCE_S = 5.0
_LAST_LINES = 4


class Processes:
    """What each prints goes to NAME.out in `folder`. Leaving the context ends them all, the newest first."""

    def __init__(self, folder: Path):
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._running, self._finished, self._may_end = folder, {}, set(), set()
        self._begin = time.monotonic()

    def start(self, name: str, words: list[str], *, into: Path | None = None, at: Path | None = None) -> None:
        """Run `words`, in the folder `at`, what it prints on its standard output into the file `into`, where they are given."""
        try:
            with open(self._folder / f"{name}.out", "wb") as errors, open(into or errors.name, "ab") as out:
                # The kernel ends it when this process is gone.
                bound = ["setpriv", "--pdeathsig", "TERM", *words]
                self._running[name] = subprocess.Popen(bound, stdout=out, stderr=errors, stdin=subprocess.DEVNULL, cwd=at)
        except FileNotFoundError as error:
            raise CastError(f"{error.filename}: not installed") from None

    def check(self) -> None:
        """Raises CastError where one has ended that was not waited for, with the last lines of its output."""
        for name, process in self._running.items():
            if name in self._may_end and process.poll() == 0:
                continue
            if name not in self._finished and process.poll() is not None:
                raise CastError(
                    f"{name}: ended after {time.monotonic() - self._begin:.1f} s with status {process.returncode}"
                    f"{self.last_words(name)}; what was recorded until then is kept"
                )

    def may_end(self, name: str) -> None:
        """From now on one that ends with status 0 is through."""
        self._may_end.add(name)

    def has_ended(self, name: str) -> bool:
        """Whether one that ends by itself is through; from then on it counts as finished."""
        if self._running[name].poll() is not None:
            self._finished.add(name)
        return name in self._finished

    def last_words(self, name: str) -> str:
        """The last lines that it printed, in brackets; nothing where it said nothing."""
        text = (self._folder / f"{name}.out").read_text(errors="replace")
        lines = [line for part in text.splitlines() if (line := "".join(filter(str.isprintable, part)).strip(" ."))]
        return f" ({' | '.join(lines[-_LAST_LINES:])})" if lines else ""

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in reversed(self._running.values()):
            process.terminate()
            try:
                process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
