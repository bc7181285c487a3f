# SPDX-License-Identifier: GPL-3.0-or-later
"""Links of a network as tables, and what changes them: which taps hold from which sample to which."""

import heapq
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np

from ...core.errors import CastError
from ..reference import quantize
from .form import DELAY_TYPE, MOST_TAPS

_NO_TAPS = np.zeros(0, DELAY_TYPE), np.zeros(0, np.complex64)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Taps of all links, checked once: delays in samples and gains, (receivers, transmitters, taps), zero where there is none.

    Arrays of DELAY_TYPE and complex64 are not copied; made by the device's `pinned()`, they go to it straight from there.
    """

    delays: np.ndarray
    gains: np.ndarray

    def __post_init__(self):
        delays, gains = np.asarray(self.delays), np.ascontiguousarray(self.gains, np.complex64)
        if delays.shape != gains.shape or delays.ndim != 3:
            raise CastError(f"taps: got shapes {delays.shape} and {gains.shape}, needs one (receivers, transmitters, taps)")
        if delays.size and not (delays.min() >= 0 and delays.max() < MOST_TAPS):
            raise CastError(f"delay: got {delays.min()} to {delays.max()}, expected 0 to {MOST_TAPS - 1} samples")
        if not np.isfinite(gains).all():
            raise CastError("gain of a tap: not a finite number")
        delays = np.ascontiguousarray(delays, DELAY_TYPE)
        for name, array in (("delays", delays.view()), ("gains", gains.view())):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    @cached_property
    def longest(self) -> int:
        """The longest delay in samples."""
        return int(self.delays.max(initial=0))


@dataclass(frozen=True, kw_only=True)
class Layer:
    """Taps of all links, (receivers, transmitters, taps): delays in samples and gains, zero where there is none. Their gains are
    multiplied by weight + slope · (samples since the segment's begin)."""

    delays: np.ndarray
    gains: np.ndarray
    weight: float = 1.0
    slope: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Segment:
    """Samples begin … end-1 of a chunk, in which no link changes; equal `version`s have equal taps."""

    begin: int
    end: int
    version: int
    layers: tuple[Layer, ...]


@dataclass(frozen=True, kw_only=True)
class _Ramp:
    begin: int
    end: int
    base: tuple[np.ndarray, np.ndarray]
    slope: tuple[np.ndarray, np.ndarray]  # change over the whole of it


class Links:
    """All links of a network, and the updates that are still to come."""

    def __init__(self, n_inputs: int, n_outputs: int, n_taps: int):
        self.n_taps = n_taps
        self.position = 0
        self.late = 0
        self.version = 0
        self._shape = (n_outputs, n_inputs)
        self._order = count()
        self.clear()

    def clear(self) -> None:
        """No link has taps from the next sample on, and no update is pending."""
        self._pending = []
        self._delays = np.zeros((*self._shape, 1), DELAY_TYPE)
        self._gains = np.zeros((*self._shape, 1), np.complex64)
        self._loss_gain = np.ones(self._shape, np.float32)
        self._enabled = np.ones(self._shape, bool)
        self._is_plain = True  # no loss, all on
        self._ramps: dict[tuple[int, int], _Ramp] = {}
        self._tap_bits = getattr(self, "_tap_bits", None)
        self.version += 1

    def round_taps(self, bits: int | None) -> None:
        """Taps of `bits` within ±2 from now on; None: as they come."""
        self._tap_bits = bits
        self._gains = self._rounded(self._gains)
        self.version += 1

    def _rounded(self, gains: np.ndarray) -> np.ndarray:
        if self._tap_bits is None:
            return np.asarray(gains, np.complex64)
        return quantize(gains, 2.0, self._tap_bits).astype(np.complex64)

    def schedule(self, tx: int, rx: int, at: int | None, *, taps=None, ramp=0, gain=None, enabled=None) -> None:
        """Queue a change of one link; one without sample number, or late, holds from the next sample. `taps`: delays, gains."""
        for name, node, limit in (("tx", tx, self._shape[1]), ("rx", rx, self._shape[0])):
            if not 0 <= node < limit:
                raise CastError(f"{name}: got {node}, expected 0 to {limit - 1}")
        if taps is not None:
            taps = self._checked(*taps)
        self._queue(at, ("link", (rx, tx), taps, ramp, gain, enabled))

    def schedule_all(self, at: int | None, table: Table) -> None:
        """Queue new taps of every link."""
        if table.gains.shape[:2] != self._shape:
            raise CastError(f"taps: got {table.gains.shape[:2]} receivers and transmitters, needs {self._shape}")
        if table.longest >= self.n_taps:
            raise CastError(f"delay: got {table.longest}, expected 0 to {self.n_taps - 1} samples")
        self._queue(at, ("all", table))

    def _checked(self, delays, gains):
        delays, gains = np.asarray(delays, np.int32).ravel(), np.asarray(gains, np.complex64).ravel()
        if delays.shape != gains.shape:
            raise CastError(f"taps: got {delays.size} delays and {gains.size} gains, expected as many")
        if delays.size and not (delays.min() >= 0 and delays.max() < self.n_taps):
            raise CastError(f"delay: got {delays.min()} to {delays.max()}, expected 0 to {self.n_taps - 1} samples")
        if not np.isfinite(gains).all():
            raise CastError("gain of a tap: not a finite number")
        return _sum(delays, gains)

    def _queue(self, at: int | None, event: tuple) -> None:
        self.late += at is not None and at < self.position
        heapq.heappush(self._pending, (self.position if at is None else max(at, self.position), next(self._order), event))

    def _apply(self, event: tuple) -> None:
        self.version += 1
        if event[0] == "all":
            self._delays, self._gains = event[1].delays, self._rounded(event[1].gains)
            self._ramps.clear()
            return
        _, link, taps, ramp, gain, enabled = event
        if enabled is not None:
            self._enabled[link] = enabled
        if gain is not None:
            self._loss_gain[link] = gain
        if not (enabled is None and gain is None):
            self._is_plain = bool((self._loss_gain * self._enabled == 1).all())
        if taps is None:
            return
        delays, gains = taps[0], self._rounded(taps[1])
        before = self._ramps.pop(link, None)
        if ramp:
            now = _kept(self._delays[link], self._gains[link])
            if before:  # an update in mid-ramp starts from where the taps are now
                done = (self.position - before.begin) / (before.end - before.begin)
                now = _sum(np.r_[before.base[0], before.slope[0]], np.r_[before.base[1], before.slope[1] * done])
            slope = _sum(np.r_[delays, now[0]], np.r_[gains, -now[1]])
            self._ramps[link] = _Ramp(begin=self.position, end=self.position + ramp, base=now, slope=slope)
        self._delays, self._gains = _put(self._delays, self._gains, link, delays, gains)

    def cut(self, n: int) -> list[Segment]:
        """The next n samples in segments between changes; leaves the position behind them."""
        first, end, segments = self.position, self.position + n, []
        while self.position < end:
            self._apply_due()
            until = min([end, *(at for at, *_ in self._pending[:1]), *(ramp.end for ramp in self._ramps.values())])
            segments.append(
                Segment(begin=self.position - first, end=until - first, version=self.version, layers=tuple(self._layers()))
            )
            self.position = until
        return segments

    def skip(self, n: int) -> None:
        """As cut, where nobody wants the samples."""
        end = self.position + n
        while self._pending and self._pending[0][0] <= end:
            self.position = max(self.position, self._pending[0][0])
            self._apply_due()
        self.position = end
        self._apply_due()

    def seek(self, position: int) -> None:
        """The next sample is number `position`, of a stream that begins anew; ramps arrive at once."""
        if position != self.position:
            self._ramps.clear()
            self.version += 1
            self.position = position

    def _apply_due(self) -> None:
        for link in [link for link, ramp in self._ramps.items() if ramp.end <= self.position]:
            del self._ramps[link]
            self.version += 1
        while self._pending and self._pending[0][0] <= self.position:
            self._apply(heapq.heappop(self._pending)[2])

    def _layers(self):
        self._delays.flags.writeable = self._gains.flags.writeable = False  # held by the segment from now on
        delays, gains = self._delays, self._gains
        groups: dict[tuple[int, int], dict] = {}
        if self._ramps:
            delays, gains = delays.copy(), gains.copy()
        for link, ramp in self._ramps.items():
            delays, gains = _put(delays, gains, link, *ramp.base)
            groups.setdefault((ramp.begin, ramp.end), {})[link] = ramp.slope
        yield Layer(delays=delays, gains=self._played(gains))
        for (begin, end), slopes in groups.items():
            table = np.zeros((*self._shape, 1), DELAY_TYPE), np.zeros((*self._shape, 1), np.complex64)
            for link, slope in slopes.items():
                table = _put(*table, link, *slope)
            length = end - begin
            yield Layer(delays=table[0], gains=self._played(table[1]), weight=(self.position - begin) / length, slope=1 / length)

    def _played(self, gains: np.ndarray) -> np.ndarray:
        return gains if self._is_plain else gains * (self._loss_gain * self._enabled)[..., None]

    @property
    def active(self) -> tuple[int, int]:
        """Links that are on and have taps, and their taps, at the next sample."""
        self._apply_due()
        taps = np.count_nonzero(self._gains, axis=-1) * self._enabled
        return int(np.count_nonzero(taps)), int(taps.sum())


def _put(delays, gains, link, new_delays, new_gains):
    """The tables with this link's row replaced, wider where it needs to be."""
    more = len(new_delays) - delays.shape[-1]
    if more > 0:
        room = ((0, 0), (0, 0), (0, more))
        delays, gains = np.pad(delays, room), np.pad(gains, room)
    elif not (delays.flags.writeable and gains.flags.writeable):
        delays, gains = delays.copy(), gains.copy()
    delays[link], gains[link] = 0, 0
    delays[link][: len(new_delays)], gains[link][: len(new_gains)] = new_delays, new_gains
    return delays, gains


def _kept(delays, gains):
    used = gains != 0
    return delays[used], gains[used]


def _sum(delays, gains):
    """One gain per delay, in order of delay, without zeros."""
    if not len(delays):
        return _NO_TAPS
    unique, where = np.unique(delays, return_inverse=True)
    total = np.zeros(len(unique), np.complex128)
    np.add.at(total, where, gains)
    return _kept(unique.astype(DELAY_TYPE), total.astype(np.complex64))
