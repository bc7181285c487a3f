# SPDX-License-Identifier: GPL-3.0-or-later
"""What a world sounds like on the links of one sounding: H(f, t) = Σ a·exp(−j2π(f_c + f)τ) over its paths."""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, amplitude_from_db
from ...scenario.create import fields, images, wedges
from . import carrying, passer
from .ends import Ends
from .remembered import remembered
from .world import World, interned

_ENDS_KEPT = 64  # sets of radios
_AT_ONCE = 2_000_000  # phasors in memory at the same time


@dataclass(frozen=True, kw_only=True)
class Traced:
    """Paths of one link, blocked ones too: the pairs of points are its instants, or one where nothing moves."""

    paths: images.Paths
    touched: list[int]  # objects that its paths meet or cross
    key: tuple  # of what they were traced in: another world that they are the same in has the same


@dataclass(frozen=True, kw_only=True)
class Table:
    """Paths that are there: `instant` (n,) of `many`, `gain` without the phase of the delay, geometry."""

    paths: images.Paths
    instant: np.ndarray
    gain: np.ndarray
    way: fields.Optics
    many: int


@dataclass(frozen=True, kw_only=True)
class Bent:
    """Diffracted paths of a link: `instant` (n,) of `many`, `gain` without the phase of the delay, length, number of the edge."""

    instant: np.ndarray
    gain: np.ndarray
    length_m: np.ndarray
    edge: np.ndarray
    many: int


class Predictor:
    """Responses (L, T, K) of worlds on links (tx, rx names) at `time_s` (T,) and `frequency_hz` (K,) from the carrier.
    Nodes that were `tracked`, name → (T, 3), are there and not where their SPEC has them."""

    def __init__(self, tx, rx, time_s: np.ndarray, frequency_hz: np.ndarray, tracked: Mapping[str, np.ndarray] | None = None):
        self.tracked = tracked or {}
        self.links = list(zip(tx, rx, strict=True))
        self.time_s, self.frequency_hz = np.asarray(time_s, float), np.asarray(frequency_hz, float)
        self._traced: OrderedDict = OrderedDict()
        self._known: OrderedDict = OrderedDict()
        self._tables: OrderedDict = OrderedDict()
        self._bent: OrderedDict = OrderedDict()
        self._ends: OrderedDict = OrderedDict()  # by number in memory, with what has it
        self._places: OrderedDict = OrderedDict()

    def response(self, world: World) -> np.ndarray:
        return self._responses(world, range(len(self.links)))

    def link_response(self, world: World, index: int) -> np.ndarray:
        """(T, K) of one link."""
        return self._responses(world, [index])[0]

    def _responses(self, world: World, which: Sequence[int]) -> np.ndarray:
        law, (keys, traced) = interned(_others_key(world)), self._keyed(world, which)

        def make(missing):
            return self._compute(world, *([column[one] for one in missing] for column in (which, keys, traced)))

        heard = remembered(self._known, [(key, law) for key in keys], make)
        whole, cables = np.empty((len(which), len(self.time_s), len(self.frequency_hz)), complex), self.all_cables(world)
        for row, index, h in zip(whole, which, heard, strict=True):
            np.multiply(h, cables[index], out=row)
        return whole

    def _keyed(self, world: World, which: Sequence[int]) -> tuple[list, list[Traced]]:
        """Keys of what the gains of links' paths depend on, their ends and the surfaces that they touch; and what was traced."""
        made_of, ends, law = world.surface.keys, self._ends_of(world).keys, world.law
        traced = self._traced_of(world, which)
        keys = [
            (one.key, world.mesh.seen_by(one.touched), ends[index], law, b"".join([made_of[number] for number in one.touched]))
            for index, one in zip(which, traced, strict=True)
        ]
        return keys, traced

    def _ends_of(self, world: World) -> Ends:
        key = id(world.radios)
        if key not in self._ends:
            self._ends[key] = Ends(
                radios=world.radios, links=self.links, time_s=self.time_s, frequency_hz=self.frequency_hz,
                tracked=self.tracked, known=self._places,
            )  # fmt: skip
            if len(self._ends) > _ENDS_KEPT:
                self._ends.popitem(last=False)
        return self._ends[key]

    def ends_key(self, world: World, index: int):
        """Of both ends of a link: where they are, and their antennas."""
        return self._ends_of(world).keys[index]

    def remembered(self, key, make):
        """What others compute of a link and want to keep."""
        return self.remembered_all([key], lambda _: [make()])[0]

    def remembered_all(self, keys: Sequence, make) -> list:
        """The same of many links: `make(numbers of the missing keys)`."""
        return remembered(self._known, keys, make)

    def traced(self, world: World, index: int) -> Traced:
        """The paths of a link, as they are in the world that this one is frozen at."""
        return self._traced_of(world, [index])[0]

    def _traced_of(self, world: World, which: Sequence[int]) -> list[Traced]:
        base = world.frozen or world
        tracks, trace = self._ends_of(base).track_keys, base.trace
        keys = [(tracks[index], trace) for index in which]

        def make(missing):
            return self._trace(base, *([column[one] for one in missing] for column in (which, keys)))

        return remembered(self._traced, keys, make)

    def all_ends_m(self, world: World, which: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
        """Both ends (n, 3) of links one after the other, at all instants of each."""
        return self._ends_of(world).at_all_instants_m(which)

    def ends_m(self, world: World, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Both ends (T, 3)."""
        return self._ends_of(world).at_each_m[index]

    def _trace(self, world: World, which: Sequence[int], keys: list) -> list[Traced]:
        faces, (tx_m, rx_m, counts) = world.faces, self._ends_of(world).joined_m(which)
        if not world.mesh.origin:
            paths = images.search(faces, tx_m, rx_m, world.max_depth)
            return _traced(faces, paths, counts, keys)
        mesh, number = world.mesh.origin  # one object changed: paths that have nothing to do with it are as they were
        before = self._traced_of(replace(world, mesh=mesh), which)
        known, changed = images.joined_paths([one.paths for one in before], counts), faces.owner == number
        paths = images.search_again(faces, known, tx_m, rx_m, world.max_depth, changed)
        found = _traced(faces, paths, counts, keys)
        return [old if number not in (*old.touched, *new.touched) else new for old, new in zip(before, found, strict=True)]

    def cables(self, world: World, index: int) -> np.ndarray:
        """(K,) what both ends' cables and the link's own loss do to a response."""
        return self.all_cables(world)[index]

    def all_cables(self, world: World) -> np.ndarray:
        """(L, K) the same of all links."""
        ends = self._ends_of(world)
        return world.amplitudes(self.links, ends.gains_db)[:, None] * ends.cables

    def path_table(self, world: World, index: int) -> Table:
        """Paths of a link that are there, with instant, gain, optics."""
        return self._tables_of(world, [index], *self._keyed(world, [index]))[0]

    def _tables_of(self, world: World, which: Sequence[int], keys: list, traced: list[Traced]) -> list[Table]:
        def make(missing):
            return self.tabled(world, [which[one] for one in missing], [traced[one].paths for one in missing])

        return remembered(self._tables, keys, make)

    def tabled(self, world: World, which: Sequence[int], known: Sequence[images.Paths]) -> list[Table]:
        """Of some paths of links those that nothing which they cross blocks, with instant, gain, optics."""
        paths, way, gain, counts = self._strengths(world, which, known)
        link_of = images.begins(counts)
        bounds = np.searchsorted(paths.pair, link_of).tolist()
        parts = zip(images.parted_paths(paths, counts), bounds, bounds[1:], counts, strict=False)
        return [
            Table(paths=part, instant=part.pair, gain=gain[a:b], way=fields.rows_of(way, slice(a, b)), many=many)
            for part, a, b, many in parts
        ]

    def _strengths(self, world: World, which: Sequence[int], known: Sequence[images.Paths]) -> tuple:
        """The same of all links together: paths, optics, gain, and how many instants each link has."""
        base = world.frozen or world
        faces = world.mesh.thick if base.is_clear else world.mesh.thin
        tx_m, rx_m, counts = self._ends_of(world).joined_m(which)
        paths = fields.unblocked(faces, images.joined_paths(known, counts), world.surface)
        from_m, to_m = tx_m[paths.pair], rx_m[paths.pair]
        way = fields.optics(faces, paths.faces, from_m, to_m)
        start, end = (
            self.fields(world, which, side, (tx_m, rx_m)[side], counts, paths.pair, direction)
            for side, direction in ((0, way.direction[:, 0]), (1, -way.direction[:, -1]))
        )
        gain = fields.gains(faces, paths, way, world.surface, start, end, world.carrier_hz)
        return paths, way, gain * _by_distance(world, way.length_m, from_m - to_m), counts

    def _compute(self, world: World, which: Sequence[int], keys: list, traced: list[Traced]) -> list[np.ndarray]:
        """Responses (T or 1, K) between the antennas of links."""
        if world.person is None and not world.diffraction:  # no other world has these gains: no table is kept
            paths, way, gain, counts = self._strengths(world, which, [one.paths for one in traced])
            return self._sums(world, paths.pair, gain, way.length_m, counts)
        tables = self._tables_of(world, which, keys, traced)
        if world.person is not None:
            rows = passer.with_person(world, self, which, tables)
        else:
            rows = [(table.instant, table.gain, table.way.length_m, table.many) for table in tables]
        found = self._summed(world, rows)
        if world.diffraction:
            bent = [(one.instant, one.gain, one.length_m, one.many) for one in self._bent_of(world, which)]
            found = [a + b for a, b in zip(found, self._summed(world, bent), strict=True)]
        return found

    def _summed(self, world: World, rows: list[tuple]) -> list[np.ndarray]:
        """Responses (instants, K) of rows (instant, gain, length_m, how many instants)."""
        counts = [many for *_, many in rows]
        instant = np.concatenate([one + begin for (one, *_), begin in zip(rows, images.begins(counts), strict=False)])
        gain, length_m = (np.concatenate([row[part] for row in rows]) for part in (1, 2))
        return self._sums(world, instant, gain, length_m, counts)

    def _sums(self, world: World, instant: np.ndarray, gain, length_m, counts: list[int]) -> list[np.ndarray]:
        """The same of paths of all links, whose instants go on from link to link."""
        first = images.begins(counts)
        sums = summed(instant, gain, length_m, first[-1], world.carrier_hz, self.frequency_hz)
        return [sums[a:b] for a, b in zip(first, first[1:], strict=False)]

    def bent(self, world: World, index: int) -> Bent:
        """The diffracted paths of a link."""
        return self._bent_of(world, [index])[0]

    def all_bent(self, world: World) -> list[Bent]:
        """The same of all links."""
        return self._bent_of(world, range(len(self.links)))

    def _bent_of(self, world: World, which: Sequence[int]) -> list[Bent]:
        ends = self._ends_of(world).keys
        keys = [(ends[index], world.law, world.mesh.key, world.surface.key) for index in which]
        return remembered(self._bent, keys, lambda missing: self._diffracted(world, [which[one] for one in missing]))

    def _diffracted(self, world: World, which: Sequence[int]) -> list[Bent]:
        tx_m, rx_m, counts = self._ends_of(world).joined_m(which)
        send, take = (
            lambda at, direction, s=s: self.fields(world, which, s, (tx_m, rx_m)[s], counts, at, direction) for s in (0, 1)
        )
        found = wedges.paths(world.mesh.edges, world.faces, world.surface, world.carrier_hz, tx_m, rx_m, send, take)
        at, gain, length_m, edge = found
        found = at, gain * _by_distance(world, length_m, (tx_m - rx_m)[at]), length_m, edge
        first = np.concatenate([[0], np.cumsum(counts)])
        bounds = np.searchsorted(at, first)
        return [
            Bent(instant=at - begin, gain=gain, length_m=length_m, edge=edge, many=many)
            for begin, many, (at, gain, length_m, edge) in zip(
                first, counts, ([part[a:b] for part in found] for a, b in zip(bounds, bounds[1:], strict=False)), strict=False
            )
        ]

    def fields(self, world, which, side: int, at_m, counts, pair, direction: np.ndarray) -> np.ndarray:
        """Fields (n, 3) of one end's antennas along directions (n, 3), number i of the pair of ends `pair[i]`; `at_m` (P, 3):
        where that end is, `counts` of links `which` after each other."""
        radios = [world.radios[self.links[index][side]] for index in which]
        link = np.repeat(np.arange(len(which)), counts)[pair]
        out = fields.far_fields([radio.antenna for radio in radios], link, direction)
        first = images.begins(counts)
        for number, radio in enumerate(radios):
            if radio.body is not None:
                heading = carrying.headings(at_m[first[number] : first[number + 1]])
                own = np.flatnonzero(link == number)
                taken_db = carrying.loss_db(radio.body, heading[pair[own] - first[number]], direction[own])
                out[own] *= amplitude_from_db(-taken_db)[:, None]
        return out


def _by_distance(world: World, length_m: np.ndarray, apart_m: np.ndarray) -> np.ndarray:
    """What the law of distance takes of paths' amplitudes (n,) beyond their spreading; `apart_m` (n, 3): from end to end."""
    far_m = length_m if world.exponent_of == "path" else np.linalg.norm(apart_m, axis=1)
    return far_m ** ((2.0 - world.exponent) / 2) * amplitude_from_db(-world.loss_db_per_m * length_m)


def _traced(faces: images.Faces, paths: images.Paths, counts: Sequence[int], keys: list) -> list[Traced]:
    """Of paths of links one after the other."""
    parts = zip(images.parted_paths(paths, counts), keys, strict=True)
    return [Traced(paths=part, touched=_touched(faces, part), key=key) for part, key in parts]


def _touched(faces: images.Faces, paths: images.Paths) -> list[int]:
    found = np.zeros(len(faces.level_m) + 1, bool)
    found[paths.faces.ravel()] = True
    found[paths.crossing_face] = True
    return sorted(set(faces.owner[found[:-1]].tolist()))  # the last face is none: unused places


def summed(instant, gain, length_m, many: int, carrier_hz: float, frequency_hz: np.ndarray) -> np.ndarray:
    """Sum of paths per instant, (many, K). Frequencies in equal steps go on from one to the next."""
    if images.tracing:
        step_hz = frequency_hz[1] - frequency_hz[0] if len(frequency_hz) > 1 else 0.0
        return images.tracing.summed(instant, gain, length_m, many, carrier_hz + frequency_hz[0], step_hz, len(frequency_hz))
    out = np.zeros((many, len(frequency_hz)), complex)
    rows = np.flatnonzero(gain)
    rows = rows[np.argsort(instant[rows], kind="stable")]
    where, first = np.unique(instant[rows], return_index=True)
    first = np.append(first, len(rows))
    begin = 0
    while begin < len(where):
        most = first[begin] + max(1, _AT_ONCE // len(frequency_hz))
        end = max(begin + 1, int(np.searchsorted(first, most, side="right")) - 1)
        part = rows[first[begin] : first[end]]
        turned = phasors(gain[part], length_m[part], carrier_hz, frequency_hz)
        out[where[begin:end]] = np.add.reduceat(turned, first[begin:end] - first[begin], axis=1).T
        begin = end
    return out


def phasors(gain: np.ndarray, length_m: np.ndarray, carrier_hz: float, frequency_hz: np.ndarray) -> np.ndarray:
    """gain·exp(−j2π(f_c + f)τ) of paths, (K, n), at frequencies in equal steps."""
    delay_s = length_m / SPEED_OF_LIGHT_M_PER_S
    out = np.empty((len(frequency_hz), len(gain)), complex)
    out[0] = gain * np.exp(-2j * np.pi * np.fmod((carrier_hz + frequency_hz[0]) * delay_s, 1.0))
    if len(frequency_hz) > 1:
        step = np.exp(-2j * np.pi * (frequency_hz[1] - frequency_hz[0]) * delay_s)
        for k in range(1, len(frequency_hz)):
            np.multiply(out[k - 1], step, out=out[k])
    return out


def _others_key(world: World) -> tuple:
    """Of what responses depend on beside specular paths and what these touch: edges see what all objects are made of, echoes
    whether any stands in the way."""
    if not (world.diffraction or world.person):
        return ()
    return world.diffraction, world.person, world.mesh.key, world.surface.key if world.diffraction else world.surface.standing
