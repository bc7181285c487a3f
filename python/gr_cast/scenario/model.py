# SPDX-License-Identifier: GPL-3.0-or-later
"""The one scenario model: which node hears which through which taps, over time.

A link from tx to rx is `h(t, tau) = 10^(-base_loss_db/20) * sum_p gain_p(t) * delta(tau - delay_p(t))`; a pair of nodes
that has no link hears nothing. Colosseum's channel emulator plays 512 taps on a 10 ns grid (Bonati et al., DySPAN 2021).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from ..core.errors import CastError, Faults
from ..core.files import NAME_RULE, is_name
from ..core.units import amplitude_from_db, db_from_amplitude, db_from_power

GRID_STEP_S = 10e-9
GRID_TAPS = 512
MAX_DELAY_S = (GRID_TAPS - 1) * GRID_STEP_S
MOST_GAIN_DB = 120.0  # of a tap: no channel, and far from what single precision holds
MAX_NODES = 256  # antennas of the emulator's mesh
INTERPOLATIONS = ("hold", "linear")


@dataclass(frozen=True, kw_only=True)
class LinkTaps:
    """Taps of one link: `delay_s` (T, P) float64 and `gain` (T, P) complex128, T = 1 when they do not change.

    An unused tap has gain 0. Raises CastError for shapes that differ or values that are not finite.
    """

    delay_s: np.ndarray
    gain: np.ndarray

    def __post_init__(self):
        delay_s = np.array(self.delay_s, np.float64, ndmin=2)
        gain = np.array(self.gain, np.complex128, ndmin=2)
        if delay_s.shape != gain.shape or delay_s.ndim != 2 or gain.size == 0:
            raise CastError(f"taps: got shapes {delay_s.shape} and {gain.shape}, delay_s and gain need one shape (T, P)")
        if not (np.isfinite(delay_s).all() and np.isfinite(gain).all()):
            raise CastError("taps: delay_s and gain must be finite")
        if (most_db := db_from_amplitude(np.abs(gain).max())) > MOST_GAIN_DB + 1e-9:
            raise CastError(f"taps: gain: got {most_db:.0f} dB, limit {MOST_GAIN_DB:g} dB")
        for name, value in (("delay_s", delay_s), ("gain", gain)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def is_static(self) -> bool:
        return self.gain.shape[0] == 1

    def __eq__(self, other):
        return (
            isinstance(other, LinkTaps) and np.array_equal(self.delay_s, other.delay_s) and np.array_equal(self.gain, other.gain)
        )


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Nodes and the links between them, on one clock `time_s` (T,), strictly ascending from 0.

    `links` maps (tx, rx) to LinkTaps. `base_loss_db` is the loss of the set-up on every link, `link_base_loss_db` that of
    single links in its place. `bandwidth_hz` is the band that the taps stand for. `interpolation` says how taps move between
    two instants: held or linear. After the last instant the last taps stay. `position_m` maps a node to (T or 1, 3) metres.
    Raises CastError with all faults.
    """

    name: str
    nodes: tuple[str, ...]
    links: dict[tuple[str, str], LinkTaps]
    time_s: np.ndarray = field(default_factory=lambda: np.zeros(1))
    description: str = ""
    center_frequency_hz: float | None = None
    bandwidth_hz: float | None = None
    base_loss_db: float = 0.0
    link_base_loss_db: dict[tuple[str, str], float] = field(default_factory=dict)
    interpolation: str = "hold"
    position_m: dict[str, np.ndarray] = field(default_factory=dict)

    def __post_init__(self):
        time_s = np.array(self.time_s, np.float64, ndmin=1)
        time_s.flags.writeable = False
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "nodes", tuple(self.nodes))
        faults = Faults(self.name)
        self._check(faults)
        faults.raise_if_any()

    def _check(self, faults: Faults) -> None:
        if not 1 <= len(self.nodes) <= MAX_NODES:
            faults.add("nodes", f"got {len(self.nodes)}, needs 1 to {MAX_NODES}")
        if len(set(self.nodes)) != len(self.nodes):
            faults.add("nodes", "the same node is named twice")
        for node in self.nodes[:MAX_NODES]:
            if not is_name(node):
                faults.add("nodes", f"got {node[:60]!r}, needs a name: {NAME_RULE}")
        if self.interpolation not in INTERPOLATIONS:
            faults.add("interpolation", f"got {self.interpolation!r}, needs one of {', '.join(INTERPOLATIONS)}")
        for place in ("center_frequency_hz", "bandwidth_hz"):
            value = getattr(self, place)
            if value is not None and not 0 < value < np.inf:
                faults.add(place, f"got {value}, needs a finite number of Hz above 0")
        steps = self.time_s
        if steps.ndim != 1 or steps[0] != 0 or not np.isfinite(steps).all() or (np.diff(steps) <= 0).any():
            faults.add("time_s", "needs finite seconds, ascending from 0")
        for place, loss in [("base_loss_db", self.base_loss_db)] + [
            (f"link {link_name(key)}: base_loss_db", loss) for key, loss in self.link_base_loss_db.items()
        ]:
            if not np.isfinite(loss):
                faults.add(place, f"got {loss}, needs a finite number of dB")
        known = set(self.nodes)
        for key, taps in self.links.items():
            if not known.issuperset(key):
                faults.add(f"link {link_name(key)}", "names a node that is not in nodes")
            if taps.gain.shape[0] not in (1, steps.size):
                faults.add(f"link {link_name(key)}", f"got {taps.gain.shape[0]} instants, time_s has {steps.size}")
            for tap, line in taps_off_grid(taps):
                faults.add(f"link {link_name(key)}: tap {tap + 1}", line)
        for node, place in self.position_m.items():
            place = np.asarray(place)
            if node not in known or place.shape not in ((1, 3), (steps.size, 3)) or not np.isfinite(place).all():
                faults.add(f"node {node}", f"position_m: needs finite metres of shape (1, 3) or ({steps.size}, 3)")

    @property
    def is_static(self) -> bool:
        return all(taps.is_static for taps in self.links.values())


def link_name(key: tuple[str, str]) -> str:
    """How messages and tables name a link: tx>rx."""
    return f"{key[0]}>{key[1]}"


def taps_off_grid(taps: LinkTaps):
    """(tap, what is wrong) of every tap that no 512-tap filter on the 10 ns grid can play."""
    used = taps.gain != 0
    # Half a picosecond of room for decimal delays that binary numbers cannot hold.
    off = used & ((taps.delay_s < -5e-13) | (taps.delay_s > MAX_DELAY_S + 5e-13))
    for tap in np.flatnonzero(off.any(axis=0)):
        delay_s = taps.delay_s[np.argmax(off[:, tap]), tap]
        yield (
            int(tap),
            f"delay_s: got {delay_s:.4g} s (tap index {round(delay_s / GRID_STEP_S)} on the 10 ns grid), "
            f"limit 0 to {MAX_DELAY_S * 1e6:.2f} us (index {GRID_TAPS - 1})",
        )


def base_loss_db(scenario: Scenario, key: tuple[str, str]) -> float:
    """The loss of the set-up that applies to one link, in dB."""
    return scenario.link_base_loss_db.get(key, scenario.base_loss_db)


def played_gain(scenario: Scenario, key: tuple[str, str]) -> np.ndarray:
    """The link's complex tap gains (T or 1, P) with its base loss applied: what an emulator multiplies by."""
    return scenario.links[key].gain * amplitude_from_db(-base_loss_db(scenario, key))


def taps_at(scenario: Scenario, key: tuple[str, str], time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Delays (n, P) in s and gains (n, P), without base loss, at any instants `time_s` (n,) >= 0.

    Held at the last instant at or before; or linear in between (real and imaginary part, and delay), as the scenario says.
    """
    taps, clock = scenario.links[key], scenario.time_s
    when = np.atleast_1d(np.asarray(time_s, np.float64))
    if taps.is_static:
        shape = (when.size, taps.gain.shape[1])
        return np.broadcast_to(taps.delay_s, shape), np.broadcast_to(taps.gain, shape)
    before = np.clip(np.searchsorted(clock, when, side="right") - 1, 0, clock.size - 1)
    if scenario.interpolation == "hold" or clock.size == 1:
        return taps.delay_s[before], taps.gain[before]
    after = np.minimum(before + 1, clock.size - 1)
    span = np.where(after > before, clock[after] - clock[before], 1.0)
    share = np.clip((when - clock[before]) / span, 0.0, 1.0)[:, None]
    gain = (1 - share) * taps.gain[before] + share * taps.gain[after]
    # An unused tap has no delay of its own: it fades in or out where its neighbour in time is.
    first = np.where(taps.gain[before] != 0, taps.delay_s[before], taps.delay_s[after])
    last = np.where(taps.gain[after] != 0, taps.delay_s[after], first)
    return (1 - share) * first + share * last, gain


def tap_power_db(scenario: Scenario, key: tuple[str, str]) -> np.ndarray:
    """Power of all taps of one link over time (T or 1,), in dB, base loss applied: sum of |gain|^2."""
    return db_from_power(np.sum(np.abs(played_gain(scenario, key)) ** 2, axis=1))


def impulse_response(taps: LinkTaps) -> np.ndarray:
    """The 512-tap filter that the hardware plays, (T or 1, 512) complex128: every tap at its nearest 10 ns step."""
    filters = np.zeros((taps.gain.shape[0], GRID_TAPS), np.complex128)
    index = np.clip(np.rint(taps.delay_s / GRID_STEP_S).astype(int), 0, GRID_TAPS - 1)
    np.add.at(filters, (np.arange(filters.shape[0])[:, None], index), taps.gain)
    return filters


def reciprocal(links: dict[tuple[str, str], LinkTaps]) -> dict[tuple[str, str], LinkTaps]:
    """Add the way back of every link that has none: the same taps."""
    return links | {(rx, tx): taps for (tx, rx), taps in links.items() if (rx, tx) not in links}


def resampled(scenario: Scenario, step_s: float) -> Scenario:
    """The same scenario at instants `step_s` apart, and at its end: coarser ones leave out what lies between."""
    if not 0 < step_s < np.inf:
        raise CastError(f"{scenario.name}: step: got {step_s} s, needs a finite number above 0")
    end_s = scenario.time_s[-1]
    clock = np.unique(np.append(np.arange(0, end_s + 1e-9, step_s), end_s))
    rows = np.clip(np.searchsorted(scenario.time_s, clock + 1e-9, side="right") - 1, 0, None)
    links = {}
    for key, taps in scenario.links.items():
        delay_s, gain = taps_at(scenario, key, clock + 1e-9)  # a hair later: rounding must not hold the instant before
        links[key] = taps if taps.is_static else LinkTaps(delay_s=delay_s, gain=gain)
    position_m = {node: track if len(track) == 1 else track[rows] for node, track in scenario.position_m.items()}
    return replace(scenario, links=links, time_s=clock, position_m=position_m)


def begun_at(scenario: Scenario, at_s: float, held_s: float = 0.0) -> Scenario:
    """The scenario from `at_s` on, after its links stood for `held_s` as they are then. Raises CastError outside of it."""
    end_s = scenario.time_s[-1]
    if not (at_s >= 0 and (at_s <= end_s or scenario.is_static)):
        raise CastError(f"{scenario.name}: at: got {at_s:g} s, the scenario lasts from 0 to {end_s:g} s")
    if scenario.is_static:
        return scenario
    later = scenario.time_s > at_s
    clock = np.concatenate([[at_s], *([[at_s]] if held_s > 0 else []), scenario.time_s[later]])
    links = {}
    for key, taps in scenario.links.items():
        delay_s, gain = taps_at(scenario, key, clock)
        links[key] = taps if taps.is_static else LinkTaps(delay_s=delay_s, gain=gain)
    rows = np.clip(np.searchsorted(scenario.time_s, clock, side="right") - 1, 0, None)
    position_m = {node: track if len(track) == 1 else track[rows] for node, track in scenario.position_m.items()}
    time_s = clock - at_s + held_s
    time_s[0] = 0.0
    return replace(scenario, links=links, time_s=time_s, position_m=position_m)


def with_more_loss(scenario: Scenario, loss_db: float) -> Scenario:
    """The same scenario with `loss_db` more on every link."""
    losses_db = {key: loss + loss_db for key, loss in scenario.link_base_loss_db.items()}
    return replace(scenario, base_loss_db=scenario.base_loss_db + loss_db, link_base_loss_db=losses_db)


def with_base_loss(scenario: Scenario, loss_db: float) -> Scenario:
    """The same scenario behind another set-up: `loss_db` on every link."""
    return replace(scenario, base_loss_db=loss_db, link_base_loss_db={})
