# SPDX-License-Identifier: GPL-3.0-or-later
"""The one error that a user can cause: it says what, got, limit, unit and where."""


class CastError(Exception):
    """Bad input, refused. `faults` holds one line each, all faults of an input at once."""

    def __init__(self, *faults: str):
        self.faults = faults
        super().__init__("\n".join(faults))


class Faults:
    """Collects the faults of one input so that a user sees them all at once."""

    def __init__(self, where: str):
        self.where = where
        self._lines: list[str] = []

    def add(self, place: str, message: str) -> None:
        self._lines.append(f"{self.where}: {place}: {message}" if place else f"{self.where}: {message}")

    def __bool__(self) -> bool:
        return bool(self._lines)

    def raise_if_any(self) -> None:
        if self._lines:
            raise CastError(*self._lines)
