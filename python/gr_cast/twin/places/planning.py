# SPDX-License-Identifier: GPL-3.0-or-later
"""Where to sound, before anyone measures: which positions make objects, materials and nodes of a place known.

How long every path is changes with the place of each object and node that it meets, how strong it is with their reflections. With
the noise these slopes give the Fisher information of a sounding, what nobody knows of a link's phase, delay and gain taken out.
Positions are chosen one after the other, each the one that adds most nats to what is known (D-optimal).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.documents import listed
from ...core.errors import CastError, Faults
from ...core.units import SPEED_OF_LIGHT_M_PER_S, amplitude_from_db
from ...scenario.create.geometry import Solid
from ...scenario.create.nodes import Node
from ...scenario.create.spec import Spec
from .predict import Predictor
from .standing import APART_M, standing
from .world import Radio, World
from .world import of_spec as world_of_spec

PROBE = "new"
TONES = 32  # of the band: a response as it is planned
INSTANTS = 6  # of links that move
USUAL, MOST = 150, 4000  # positions of a grid
UNKNOWN = ("phase", "delay", "gain")  # of each response by itself
DOUBT = {"reflection_db": 3.0, "place_m": 0.3}  # before anyone measures, standard deviations
KNOWN = {"reflection_db": 1.0, "place_m": 0.03}  # of what counts as known
_PER_DB = np.log(10) / 20


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What is asked of a plan: links (`TX>RX`) of a campaign that is made anyway, nodes that a position sounds with (all still
    ones where none is named), the region (x0, y0, x1, y1) with height and step of its grid, how many positions."""

    links: tuple[str, ...] = ()
    anchors: tuple[str, ...] = ()
    region_m: Sequence[float] | None = None
    height_m: float = 1.5
    step_m: float | None = None
    count: int = 4
    max_depth: int = 2
    snr_db: float = 25.0
    unknown: tuple[str, ...] = ("phase", "delay")

    def check(self, spec: Spec) -> None:
        """Raises CastError with every fault."""
        faults, names = Faults(spec.id), [node.name for node in spec.nodes]
        for link in self.links:
            tx, _, rx = link.partition(">")
            if tx not in names or rx not in names or tx == rx:
                faults.add("--link", f"got {link!r}, needs TX>RX of two nodes of the SPEC: {listed(names)}")
        for name in self.anchors:
            if name not in names:
                faults.add("--anchor", f"got {name!r}, no node of the SPEC, needs one of {listed(names)}")
        if not self.anchors and all(node.is_moving for node in spec.nodes):
            faults.add("--anchor", "all nodes of the SPEC move: name those that a position sounds with")
        if self.region_m is not None and not (self.region_m[0] < self.region_m[2] and self.region_m[1] < self.region_m[3]):
            faults.add("--region", f"got {' '.join(f'{x:g}' for x in self.region_m)} m, needs X0 < X1 and Y0 < Y1")
        for option, value, low, high, unit in (
            ("height", self.height_m, -1e4, 1e4, " m"),
            ("step", self.step_m, 0.01, 1e4, " m"),
            ("positions", self.count, 1, 50, ""),
            ("depth", self.max_depth, 0, 3, ""),
            ("snr", self.snr_db, -20, 80, " dB"),
        ):
            if value is not None and not low <= value <= high:
                faults.add(f"--{option}", f"got {value:g}, needs {low:g} to {high:g}{unit}")
        faults.raise_if_any()


@dataclass(frozen=True, kw_only=True)
class Number:
    """One thing to know: the strength of an object's reflections, or where an object or node is along `axis`."""

    level: str
    name: str
    what: str
    axis: tuple[float, float, float] | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Sight:
    """What soundings tell: `information` (N, N) of all numbers, objects that paths are reflected by (`lit`), and those that stand
    in the way of one (`shading`)."""

    information: np.ndarray
    lit: frozenset[str]
    shading: frozenset[str]

    def __add__(self, other: "Sight") -> "Sight":
        return Sight(
            information=self.information + other.information, lit=self.lit | other.lit, shading=self.shading | other.shading
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """Chosen positions (K, 3) with what each adds in nats; sights of the campaign, and with each position in turn (K + 1)."""

    numbers: tuple[Number, ...]
    objects: tuple[str, ...]
    positions_m: np.ndarray
    gains_nats: tuple[float, ...]
    sights: tuple[Sight, ...]
    grid_m: np.ndarray
    first_nats: np.ndarray
    noise_power: float
    everywhere: frozenset[str]  # lit from any position of the grid

    def deviations(self, stage: int) -> np.ndarray:
        """(N,) standard deviations after the campaign and so many positions."""
        return np.sqrt(np.diag(np.linalg.inv(_doubt(self.numbers) + self.sights[stage].information)))

    def known(self, stage: int) -> np.ndarray:
        """(N,) bool."""
        return self.deviations(stage) <= [KNOWN[number.what] for number in self.numbers]


def numbers_of(world: World, nodes: Sequence[str]) -> tuple[Number, ...]:
    """What is to be known of a place: every object's reflections and its place along the normals of its faces, these nodes'
    places."""
    out = []
    for index, name in enumerate(world.mesh.names):
        out.append(Number(level="object", name=name, what="reflection_db"))
        axes = [axis * np.sign(axis[np.argmax(np.abs(axis))]) for axis in world.axes(index)]
        out += [Number(level="object", name=name, what="place_m", axis=tuple(axis.tolist())) for axis in axes]
    return (*out, *(Number(level="node", name=n, what="place_m", axis=tuple(a)) for n in nodes for a in np.eye(3).tolist()))


def of_spec(spec: Spec, solids: Sequence[Solid], wanted: Wanted, progress=lambda done, all_: None):
    """(world, links, anchors, Plan) of a SPEC and its objects. CastError names every fault of what is wanted."""
    wanted.check(spec)
    world = world_of_spec(spec, solids)
    world = replace(world, max_depth=min(wanted.max_depth, spec.max_depth), diffraction=False)
    links = [tuple(link.split(">")) for link in dict.fromkeys(wanted.links)]
    anchors = list(dict.fromkeys(wanted.anchors)) or [node.name for node in spec.nodes if not node.is_moving]
    grid_m = grid(world, wanted)
    time_s = np.linspace(0, spec.duration_s, INSTANTS)
    return world, links, anchors, plan(
        world, links, time_s, anchors, grid_m, wanted.count,
        bandwidth_hz=spec.bandwidth_hz, snr_db=wanted.snr_db, unknown=wanted.unknown, progress=progress,
    )  # fmt: skip


def grid(world: World, wanted: Wanted) -> np.ndarray:
    """Positions (n, 3) of the region at which a radio may stand. CastError where there are fewer than wanted, or too many."""
    nodes_m = np.concatenate([radio.node.waypoints_m for radio in world.radios.values()])
    x0, y0, x1, y1 = wanted.region_m or (*nodes_m[:, :2].min(axis=0), *nodes_m[:, :2].max(axis=0))
    step_m = wanted.step_m or max(np.sqrt((x1 - x0) * (y1 - y0) / USUAL), (x1 - x0 + y1 - y0) / USUAL, 0.01)
    sides = [low + step_m * (0.5 + np.arange(max(int((high - low) / step_m), 1))) for low, high in ((x0, x1), (y0, y1))]
    count = len(sides[0]) * len(sides[1])
    if count > MOST:
        raise CastError(f"--step: got {step_m:g} m, {count} positions in the region, limit {MOST}")
    points = np.stack([*(side.ravel() for side in np.meshgrid(*sides, indexing="ij")), np.full(count, wanted.height_m)], axis=1)
    points = points[standing(world, points)]
    if len(points) < wanted.count:
        where = f"inside the place, outside objects, {APART_M:g} m from nodes"
        raise CastError(
            f"--region: {len(points)} positions of its grid are {where}, needs {wanted.count}: choose a smaller --step"
        )
    return points


def plan(
    world: World,
    links: Sequence[tuple[str, str]],
    time_s: np.ndarray,
    anchors: Sequence[str],
    grid_m: np.ndarray,
    count: int,
    *,
    bandwidth_hz: float,
    snr_db: float,
    unknown: Sequence[str],
    progress: Callable[[int, int], None] = lambda done, all_: None,
) -> Plan:
    """`count` positions of the grid (n, 3), at which one more node sounds with the `anchors`, after a campaign of `links`.

    The noise is `snr_db` below the median power of all links, of the campaign and of the grid.
    """
    frequency_hz = bandwidth_hz * ((np.arange(TONES) + 0.5) / TONES - 0.5)
    numbers = numbers_of(world, sorted({*anchors, *(name for link in links for name in link)}))
    probed = replace(world, radios={**world.radios, PROBE: Radio(node=Node(name=PROBE, waypoints_m=grid_m[0]))})
    probe = Predictor([PROBE] * len(anchors), anchors, np.arange(len(grid_m)), frequency_hz, {PROBE: grid_m})
    campaign = Predictor(*zip(*links, strict=True), time_s, frequency_hz) if links else None
    noise = np.median([*_powers(probed, probe), *(_powers(world, campaign) if campaign else ())]) / amplitude_from_db(snr_db) ** 2
    noise = max(float(noise), 1e-300)
    sights = [Sight(information=np.zeros((len(numbers),) * 2), lit=frozenset(), shading=frozenset())]
    if campaign:
        for index in range(len(links)):
            for one in _sights(world, campaign, index, numbers, unknown, noise).values():
                sights[0] += one
    from_here = [Sight(information=sights[0].information * 0, lit=frozenset(), shading=frozenset()) for _ in grid_m]
    for index in range(len(anchors)):
        for instant, one in _sights(probed, probe, index, numbers, unknown, noise).items():
            from_here[instant] += one
        progress(index + 1, len(anchors))
    chosen, gains, first = [], [], None
    for _ in range(count):
        nats = added_nats(_doubt(numbers) + sights[-1].information, np.array([one.information for one in from_here]))
        first = nats if first is None else first
        best = int(np.argmax(np.where(np.isin(np.arange(len(nats)), chosen), -1.0, nats)))
        chosen.append(best)
        gains.append(float(nats[best]))
        sights.append(sights[-1] + from_here[best])
    return Plan(
        numbers=numbers, objects=world.mesh.names, positions_m=grid_m[chosen], gains_nats=tuple(gains), sights=tuple(sights),
        grid_m=grid_m, first_nats=first, noise_power=noise, everywhere=frozenset().union(*(one.lit for one in from_here)),
    )  # fmt: skip


def added_nats(have: np.ndarray, more: np.ndarray) -> np.ndarray:
    """(n,) by which information `more` (n, N, N) beside what is known shrinks the doubt: half of ln det's growth."""
    root = np.linalg.inv(np.linalg.cholesky(have))
    return 0.5 * np.linalg.slogdet(np.eye(len(have)) + root @ more @ root.T)[1]


def _doubt(numbers: Sequence[Number]) -> np.ndarray:
    return np.diag([DOUBT[number.what] ** -2.0 for number in numbers])


def _powers(world: World, predictor: Predictor) -> np.ndarray:
    """Of every response that is any."""
    power = (np.abs(predictor.response(world)) ** 2).mean(axis=2).ravel()
    return power[power > 0]


def _sights(world: World, predictor: Predictor, index: int, numbers, unknown, noise_power: float) -> dict[int, Sight]:
    """What one link tells at each of its instants, or at one where nothing moves."""
    table, traced = predictor.path_table(world, index), predictor.traced(world, index)
    names, owner = np.array(world.mesh.names), world.faces.owner
    used, rates, per_metre = _rates(world, predictor.links[index], table, numbers)
    turn = -2j * np.pi * (world.carrier_hz + predictor.frequency_hz) / SPEED_OF_LIGHT_M_PER_S
    phasor = table.gain[:, None] * np.exp(np.outer(table.way.length_m, turn))
    crossed = traced.paths.pair[traced.paths.crossing_path]
    out = {}
    for instant in range(table.many):
        rows = (table.instant == instant) & (table.gain != 0)
        met = table.paths.faces[rows]
        h = phasor[rows].sum(axis=0)
        columns = rates[:, rows] @ phasor[rows] * np.where(per_metre[:, None], turn, 1.0)
        information = np.zeros((len(numbers),) * 2)
        information[np.ix_(used, used)] = fisher(columns, h, predictor.frequency_hz, unknown, noise_power)
        out[instant] = Sight(
            information=information,
            lit=frozenset(names[np.unique(owner[met[met >= 0]])].tolist()),
            shading=frozenset(names[np.unique(owner[traced.paths.crossing_face[crossed == instant]])].tolist()),
        )
    return out


def _rates(world: World, link, table, numbers) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(which numbers change anything (U,), rates (U, n) of every path, whether each is of its length): ln amplitude per dB, or m
    per m."""
    met = table.paths.faces
    own = np.where(met >= 0, world.faces.owner[met], -1)
    direction = table.way.direction
    step = np.where((met >= 0)[:, :, None], direction[:, :-1] - direction[:, 1:], 0.0)
    used, rows, per_metre = [], [], []
    for place, number in enumerate(numbers):
        if number.level == "node":
            along = {link[0]: -direction[:, 0], link[1]: direction[:, -1]}.get(number.name)
            row = None if along is None else along @ np.array(number.axis)
        else:
            bounces = own == world.mesh.index(number.name)
            if not bounces.any():
                continue
            normal = world.faces.normal[met]
            row = bounces.sum(axis=1) * _PER_DB
            if number.axis is not None:
                row = (bounces * (step * normal).sum(axis=2) * (normal @ np.array(number.axis))).sum(axis=1)
        if row is not None and row.any():
            used.append(place)
            rows.append(row)
            per_metre.append(number.axis is not None)
    return np.array(used, int), np.array(rows).reshape(len(used), len(met)), np.array(per_metre, bool)


def fisher(
    columns: np.ndarray, h: np.ndarray, frequency_hz: np.ndarray, unknown: Sequence[str], noise_power: float
) -> np.ndarray:
    """(U, U) information of one response `h` (K,) with slopes `columns` (U, K), the link's own unknown numbers taken out."""
    own = {"phase": 1j * h, "delay": -2j * np.pi * frequency_hz * h, "gain": h}
    real = np.concatenate([columns.real, columns.imag], axis=1)
    for vector in (
        np.linalg.qr(np.array([np.r_[own[k].real, own[k].imag] for k in unknown]).T)[0].T if h.any() and unknown else ()
    ):
        real = real - np.outer(real @ vector, vector)
    return 2 / noise_power * real @ real.T
