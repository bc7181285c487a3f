# SPDX-License-Identifier: GPL-3.0-or-later
"""What a world sounds like on the links of one sounding: H(f, t) = Σ a·exp(−j2π(f_c + f)τ) over its paths."""

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, amplitude_from_db
from ...scenario.create import fields, images, wedges
from . import passer
from .world import Radio, World

_KEPT = 4000  # links in memory


@dataclass(frozen=True, kw_only=True)
class Traced:
    """Paths of one link, blocked ones too: the pairs of points are its instants, or one where nothing moves."""

    paths: images.Paths
    touched: np.ndarray  # objects that its paths meet or cross


@dataclass(frozen=True, kw_only=True)
class Table:
    """Paths that are there: `instant` (n,) of `many`, `gain` without the phase of the delay, geometry."""

    paths: images.Paths
    instant: np.ndarray
    gain: np.ndarray
    way: fields.Optics
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

    def response(self, world: World) -> np.ndarray:
        return np.stack([self.link_response(world, index) for index in range(len(self.links))])

    def link_response(self, world: World, index: int) -> np.ndarray:
        """(T, K) of one link."""
        tx, rx = (world.radios[name] for name in self.links[index])
        cables = tx.gain_db + rx.gain_db, tx.delay_s + rx.delay_s, world.link_loss_db.get(self.links[index], 0.0)
        # Edges and echoes of a person see objects that no specular path touches.
        others = surface_key(world.surface) if world.diffraction or world.person else b""
        key = self._key(world, index), cables, world.diffraction, world.person, others
        return _remember(self._known, key, lambda: self._compute(world, index))

    def _key(self, world: World, index: int):
        """Of what the paths' gains depend on: its ends, and the surfaces that they touch."""
        ends = tuple(radio_key(world.radios[name]) for name in self.links[index])
        rows = surface_key(world.surface, self.traced(world, index).touched)
        law = world.carrier_hz, world.exponent, world.loss_db_per_m
        return self._geometry_key(world, index), ends, world.mesh.key, rows, law

    def remembered(self, key, make):
        """What others compute of a link and want to keep."""
        return _remember(self._known, key, make)

    def traced(self, world: World, index: int) -> Traced:
        """The paths of a link, as they are in the world that this one is frozen at."""
        base = world.frozen or world
        key = self._geometry_key(world, index)
        return _remember(self._traced, key, lambda: self._trace(base, index))

    def _geometry_key(self, world: World, index: int):
        base = world.frozen or world
        tx, rx = (base.radios[name] for name in self.links[index])
        return index, base.mesh.key, base.max_depth, base.is_clear, tx.track_key, rx.track_key

    def _ends_m(self, world: World, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Both ends (P, 3) at all instants, or at one where nothing moves."""
        tx_m, rx_m = (self._node_m(world.radios[name]) for name in self.links[index])
        many = max(len(tx_m), len(rx_m))
        return np.broadcast_to(tx_m, (many, 3)), np.broadcast_to(rx_m, (many, 3))

    def _node_m(self, radio: Radio) -> np.ndarray:
        if radio.node.name in self.tracked:
            return self.tracked[radio.node.name] + np.array(radio.offset_m)
        return radio.position_m(self.time_s)

    def ends_m(self, world: World, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Both ends (T, 3)."""
        return tuple(np.broadcast_to(end, (len(self.time_s), 3)) for end in self._ends_m(world, index))

    def _trace(self, world: World, index: int) -> Traced:
        tx_m, rx_m = self._ends_m(world, index)
        faces = world.faces
        paths = images.search(faces, tx_m, rx_m, world.max_depth)
        met = np.concatenate([paths.faces[paths.faces >= 0], paths.crossing_face])
        return Traced(paths=paths, touched=np.unique(faces.owner[met]))

    def cables(self, world: World, index: int) -> np.ndarray:
        """(K,) what both ends' cables and the link's own loss do to a response."""
        tx, rx = (world.radios[name] for name in self.links[index])
        return world.link_amplitude(self.links[index]) * np.exp(-2j * np.pi * self.frequency_hz * (tx.delay_s + rx.delay_s))

    def path_table(self, world: World, index: int):
        """Paths of a link that are there, with instant, gain, optics."""
        return _remember(self._tables, self._key(world, index), lambda: self._table(world, index))

    def _table(self, world: World, index: int) -> Table:
        tx, rx = (world.radios[name] for name in self.links[index])
        base = world.frozen or world
        faces = world.mesh.thick if base.is_clear else world.mesh.thin
        paths = fields.unblocked(faces, self.traced(world, index).paths, world.surface)
        tx_m, rx_m = self._ends_m(world, index)
        way = fields.optics(faces, paths.faces, tx_m[paths.pair], rx_m[paths.pair])
        start, end = fields.far_field(tx.antenna, way.direction[:, 0]), fields.far_field(rx.antenna, -way.direction[:, -1])
        gain = fields.gains(faces, paths, way, world.surface, start, end, world.carrier_hz)
        if world.exponent != 2.0:
            gain = gain * way.length_m ** ((2.0 - world.exponent) / 2)
        if world.loss_db_per_m:
            gain = gain * amplitude_from_db(-world.loss_db_per_m * way.length_m)
        return Table(paths=paths, instant=paths.pair, gain=gain, way=way, many=len(tx_m))

    def _compute(self, world: World, index: int) -> np.ndarray:
        tx, rx = (world.radios[name] for name in self.links[index])
        table = self.path_table(world, index)
        instant, gain, way, many = table.instant, table.gain, table.way, table.many
        length_m = way.length_m
        if world.person is not None:
            instant, gain, length_m, many = passer.with_person(world, self, index, instant, gain, way, many)
        if world.diffraction:
            ends = self.ends_m(world, index) if many > 1 else self._ends_m(world, index)
            more = wedges.paths(world.mesh.edges, world.faces, world.surface, world.carrier_hz, *ends, tx.antenna, rx.antenna)
            instant, gain, length_m = (np.concatenate([a, b]) for a, b in zip((instant, gain, length_m), more, strict=True))
        response = summed(instant, gain, length_m, many, world.carrier_hz, self.frequency_hz)
        return np.broadcast_to(response * self.cables(world, index), (len(self.time_s), len(self.frequency_hz)))


def summed(instant, gain, length_m, many: int, carrier_hz: float, frequency_hz: np.ndarray) -> np.ndarray:
    """Sum of paths per instant, (many, K). Frequencies in equal steps go on from one to the next."""
    out = np.zeros((many, len(frequency_hz)), complex)
    rows = np.flatnonzero(gain)
    if not len(rows):
        return out
    order = rows[np.argsort(instant[rows], kind="stable")]
    delay_s = length_m[order] / SPEED_OF_LIGHT_M_PER_S
    phasors = np.empty((len(order), len(frequency_hz)), complex)
    phasors[:, 0] = gain[order] * np.exp(-2j * np.pi * np.fmod((carrier_hz + frequency_hz[0]) * delay_s, 1.0))
    if len(frequency_hz) > 1:
        step = np.exp(-2j * np.pi * (frequency_hz[1] - frequency_hz[0]) * delay_s)
        for k in range(1, len(frequency_hz)):
            np.multiply(phasors[:, k - 1], step, out=phasors[:, k])
    where, first = np.unique(instant[order], return_index=True)
    out[where] = np.add.reduceat(phasors, first, axis=0)
    return out


def radio_key(radio: Radio):
    """Of what a node's end of a link depends on, its cable aside."""
    return radio.track_key, radio.node.orientation_rad, radio.node.antenna


def surface_key(surface: fields.Surface, which=slice(None)) -> bytes:
    """Of the numbers of objects `which`."""
    return b"".join(values[which].tobytes() for values in vars(surface).values())


def _remember(memory: OrderedDict, key, make):
    if key in memory:
        memory.move_to_end(key)
        return memory[key]
    memory[key] = value = make()
    if len(memory) > _KEPT:
        memory.popitem(last=False)
    return value
