# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error that a user can cause: it says what, got, limit, unit and where."""

LONGEST_LINE = 1500  # characters of a fault; what names it stands at its beginning
MOST_FAULTS = 1000  # of one input, told one by one: who has more mends these first


class CastError(Exception):
    """Bad input, refused. `faults` holds one line each, all faults of an input at once."""

    def __init__(self, *faults: str):
        self.faults = tuple(_one_line(fault) for fault in faults)
        super().__init__("\n".join(self.faults))


def _one_line(text: str) -> str:
    """Text that a terminal can show on one line, whatever names of files and keys are in it."""
    text = text if len(text) <= LONGEST_LINE else text[: LONGEST_LINE - 1] + "…"
    return text if text.isprintable() else "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class Faults:
    """Collects the faults of one input so that a user sees them all at once."""

    def __init__(self, where: str):
        self.where = where
        self._lines: list[str] = []
        self._more = 0
        self._said: set[str] = set()

    def add(self, place: str, message: str, *, last: bool = False) -> None:
        """Note what is wrong at a place; once the `last` word on it is said, no more is."""
        if place in self._said:
            return
        if last:
            self._said.add(place)
        if len(self._lines) < MOST_FAULTS:
            self._lines.append(f"{self.where}: {place}: {message}" if place else f"{self.where}: {message}")
        else:
            self._more += 1

    def __len__(self) -> int:
        return len(self._lines) + self._more

    def raise_if_any(self) -> None:
        if self._lines:
            raise CastError(*self._lines, *([f"{self.where}: and {self._more} more faults"] if self._more else []))
