# SPDX-License-Identifier: GPL-3.0-or-later
"""Sounding campaigns of a place: one NumPy archive each, of complex responses or of power alone."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...core import arrays
from ...core.documents import listed
from ...core.errors import Faults

KINDS = ("response", "power")
_ARRAYS = {  # kind → the arrays that it must have, and may have
    "response": ({"tx", "rx", "time_s", "frequency_hz", "response", "noise_power"}, set()),
    "power": ({"tx", "rx", "time_s", "power_db", "std_db"}, {"limits_db"}),
}
_POSITION = "position_"  # then a node's name; of power files
_LEAST_NOISE, _MOST_NOISE = 1e-40, 1e40  # of power received over power transmitted
_MOST_DB = 400.0  # up or down: beyond all receivers
_WIDEST_HZ = 1e10  # offsets from the carrier, up or down
_UNEVEN = 1e-6  # of a frequency step: what single precision leaves of equal ones


@dataclass(frozen=True, kw_only=True)
class Sounding:
    """A campaign of L links at T instants. Responses (L, T, K) are received over transmitted amplitude at K offsets from the
    carrier, with the variance of one entry in `noise_power` (L,); power (L, T) is in dB, with the meter's error `std_db` (L,)
    and where it is blind and saturates, `limits_db`. NaN is missing. `position_m` holds nodes that were tracked, (T, 3)."""

    file: str
    kind: str
    vault: bool
    tx: tuple[str, ...]
    rx: tuple[str, ...]
    time_s: np.ndarray
    frequency_hz: np.ndarray | None = None
    response: np.ndarray | None = None
    noise_power: np.ndarray | None = None
    power_db: np.ndarray | None = None
    std_db: np.ndarray | None = None
    limits_db: np.ndarray | None = None
    position_m: dict[str, np.ndarray]


def read(path: Path, kind: str, vault: bool, nodes: tuple[str, ...] | None, limit: int) -> Sounding:
    """One campaign's file between `nodes` (None: not known), of at most `limit` bytes. CastError has all its faults."""
    content, faults = arrays.read(path, limit), Faults(str(path))
    needed, possible = _ARRAYS[kind]
    tracked = {name for name in content if kind == "power" and name.startswith(_POSITION)}
    for name in sorted({*content} - needed - possible - tracked):
        faults.add(name, f"unknown array, a {kind} file knows {listed(sorted(needed | possible))}")
    for name in sorted(needed - {*content}):
        faults.add(name, "is missing")
    take = _Taker(content, faults)
    tx, rx = (take.names(side, nodes) for side in ("tx", "rx"))
    links = len(tx)
    if "tx" in content and "rx" in content and len(rx) != links:
        faults.add("rx", f"got {len(rx)} names, tx has {links}")
    for index, (a, b) in enumerate(zip(tx, rx, strict=False)):
        if a == b:
            faults.add(f"rx[{index}]", f"{a} is its own transmitter")
    time_s = take.numbers("time_s", (None,), "s", -1e9, 1e9)
    instants = time_s.size
    own = {}
    if kind == "response":
        own["frequency_hz"] = take.numbers("frequency_hz", (None,), "Hz", -_WIDEST_HZ, _WIDEST_HZ)
        _check_steps(own["frequency_hz"], faults)
        own["response"] = take.responses("response", (links, instants, own["frequency_hz"].size))
        own["noise_power"] = take.numbers("noise_power", (links,), "", _LEAST_NOISE, _MOST_NOISE)
    else:
        own["power_db"] = take.numbers("power_db", (links, instants), "dB", -_MOST_DB, _MOST_DB, missing=True)
        own["std_db"] = take.numbers("std_db", (links,), "dB", 1e-6, 100.0)
        if "limits_db" in content:  # either way round: a meter saturates above where it is blind
            own["limits_db"] = np.sort(take.numbers("limits_db", (2,), "dB", -np.inf, np.inf))
    if all(np.isnan(own[name]).all() for name in ("response", "power_db") if name in own and own[name].size) and not faults:
        faults.add("", "all of its entries are missing")
    position_m = {}
    for array in sorted(tracked):
        node = array.removeprefix(_POSITION)
        if nodes is not None and node not in nodes:
            faults.add(array, f"no node of the SPEC, needs one of {listed(nodes)}")
        position_m[node] = take.numbers(array, (instants, 3), "m", -1e6, 1e6)
    faults.raise_if_any()
    return Sounding(file=path.name, kind=kind, vault=vault, tx=tx, rx=rx, time_s=time_s, position_m=position_m, **own)


def _check_steps(frequency_hz: np.ndarray, faults: Faults) -> None:
    step_hz = np.diff(frequency_hz)
    if step_hz.size and not (step_hz > 0).all():
        faults.add("frequency_hz", "needs to ascend")
    elif step_hz.size and np.ptp(step_hz) > _UNEVEN * np.abs(frequency_hz).max():
        faults.add("frequency_hz", f"got steps of {step_hz.min():g} to {step_hz.max():g} Hz, needs equal ones")


class _Taker:
    """Arrays by name and what they must be; what is not there gives an empty one, a fault by then."""

    def __init__(self, content: dict[str, np.ndarray], faults: Faults):
        self._content, self._faults = content, faults

    def names(self, name: str, known: tuple[str, ...] | None) -> tuple[str, ...]:
        values = self._content.get(name)
        if values is None:
            return ()
        try:
            names = tuple(values.tolist()) if values.ndim == 1 and values.dtype.kind == "U" else ()
        except ValueError:  # not the numbers of any characters
            names = ()
        if not names:
            self._faults.add(name, f"got {values.dtype.name} {values.shape}, needs a list of one name or more")
        for index, one in enumerate(names):
            if known is not None and one not in known:
                self._faults.add(f"{name}[{index}]", f"got {one[:60]!r}, no node of the SPEC, needs one of {listed(known)}")
        return names

    def _shaped(self, name: str, kinds: str, shape: tuple, needs: str) -> np.ndarray | None:
        values = self._content.get(name)
        if values is None:
            return None
        wanted = tuple(got if want is None else want for got, want in zip(values.shape, shape, strict=False))
        if values.dtype.kind not in kinds:
            self._faults.add(name, f"got {values.dtype.name}, needs {needs}")
        elif values.shape != wanted or len(values.shape) != len(shape) or not values.size:
            size = " × ".join("any" if want is None else str(want) for want in shape)
            self._faults.add(name, f"got {' × '.join(map(str, values.shape)) or 'one number'} numbers, needs {size}")
        else:
            return values
        return None

    def numbers(self, name: str, shape: tuple, unit: str, low: float, high: float, *, missing: bool = False) -> np.ndarray:
        values = self._shaped(name, "iuf", shape, "real numbers")
        if values is None:
            return np.zeros([0] * len(shape))
        values = values.astype(np.float64)
        with np.errstate(invalid="ignore"):
            bad = ~((values >= low) & (values <= high)) & ~(np.isnan(values) if missing else False)
        if bad.any():
            at = np.unravel_index(int(np.argmax(bad)), values.shape)
            limits = f"in {low:g} to {high:g}" if np.isfinite(low) else "and no NaN"
            more = f", as {int(bad.sum()) - 1} more" if bad.sum() > 1 else ""
            place = f"{name}[{', '.join(map(str, at))}]"
            self._faults.add(place, f"got {values[at]:g}{more}, needs numbers{f' of {unit}' if unit else ''} {limits}")
        return values

    def responses(self, name: str, shape: tuple) -> np.ndarray:
        values = self._shaped(name, "c", shape, "complex numbers")
        if values is None:
            return np.zeros((0, 0, 0), np.complex64)
        with np.errstate(over="ignore", invalid="ignore"):
            values = values.astype(np.complex64)
        if np.isinf(values).any():
            at = np.unravel_index(int(np.argmax(np.isinf(values))), values.shape)
            self._faults.add(f"{name}[{', '.join(map(str, at))}]", "is infinite; NaN says missing")
        return values
