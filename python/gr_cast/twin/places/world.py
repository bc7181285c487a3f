# SPDX-License-Identifier: GPL-3.0-or-later
"""A place as the forward model needs it. Effects only ever replace parts of a world; what did not change is not computed anew."""

import itertools
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, amplitude_from_db
from ...scenario.create.fields import Antenna, Surface, surface_of
from ...scenario.create.geometry import Solid
from ...scenario.create.images import Faces, faces_of, joined, shifted
from ...scenario.create.media import Medium
from ...scenario.create.nodes import Node, position_m, velocity_m_per_s
from ...scenario.create.patches import patches_of
from ...scenario.create.spec import Spec
from ...scenario.create.wedges import Edges, edges_of
from .carrying import Body
from .document import Place
from .meters import Fading, Meter
from .remembered import remembered

_COARSE_M = 0.25
_JOINED_KEPT = 16  # meshes with one object more, each with a table of what faces see
SLAB_M = 0.1  # of an object of whose surface nothing is said
_numbers = itertools.count()
_MOST_KNOWN = 100_000  # of interned keys, before they are forgotten
_known: dict = {}


def interned(key) -> int:
    """A number for a key, the same for keys that are equal: what is long is hashed once and not wherever it is looked up."""
    number = _known.get(key)
    if number is None:
        if len(_known) >= _MOST_KNOWN:
            _known.clear()  # a key that comes again then gets a new number: computed anew, and never wrong
        number = _known[key] = next(_numbers)
    return number


@dataclass(frozen=True, kw_only=True)
class Radio:
    """A node with what a world may hold against its SPEC: `offset_m`, timing of its track, gain and delay of its cable, the
    body that carries it."""

    node: Node
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed_factor: float = 1.0
    time_offset_s: float = 0.0
    gain_db: float = 0.0
    delay_s: float = 0.0
    body: Body | None = None

    @cached_property
    def antenna(self) -> Antenna:
        return Antenna(pattern=self.node.antenna, orientation_rad=self.node.orientation_rad)

    def position_m(self, time_s: np.ndarray) -> np.ndarray:
        """(T, 3), static nodes (1, 3)."""
        if not self.node.is_moving:
            return self.node.waypoints_m[:1] + np.array(self.offset_m)
        return position_m(self.node, (time_s + self.time_offset_s) * self.speed_factor) + np.array(self.offset_m)

    def velocity_m_per_s(self, time_s: np.ndarray) -> np.ndarray:
        """(T, 3) along its way, over its own timing."""
        return velocity_m_per_s(self.node, (time_s + self.time_offset_s) * self.speed_factor, "right")

    @cached_property
    def end_key(self) -> int:
        """Of what a link's end depends on, the cable aside."""
        return interned((self.track_key, self.node.orientation_rad, self.node.antenna, self.body))

    @cached_property
    def track_key(self) -> int:
        """Of where the node is over time."""
        where = self.node.waypoints_m.tobytes(), self.node.speed_m_per_s
        return interned((*where, self.offset_m, self.speed_factor, self.time_offset_s))


class Mesh:
    """Objects of a place, with their faces: `thin`, hollow objects from outside alone, and `thick`, for legs that go through.

    `coarse` is a mesh that is the same to a quarter of a metre, without added sheets: many fine changes have it in common.
    `origin`: the mesh that this one was made from, and the number of the one object that is new or elsewhere in this one.
    """

    def __init__(
        self,
        solids: tuple[Solid, ...],
        thin: Faces,
        thick: Faces,
        coarse: "Mesh | None" = None,
        origin: "tuple[Mesh, int] | None" = None,
    ):
        self.solids, self.thin, self.thick, self.origin = solids, thin, thick, origin
        self.coarse, self._moves = coarse or self, {}
        self._joined: OrderedDict = OrderedDict()  # by what stands where
        self.names = tuple(solid.name for solid in solids)
        self.key = next(_numbers)

    @classmethod
    def of(cls, solids: tuple[Solid, ...], points_m: np.ndarray) -> "Mesh":
        """`points_m` (n, 3): where nodes are, which may be inside closed objects."""
        return cls(solids, faces_of(solids, points_m), faces_of(solids, thick=True))

    @cached_property
    def edges(self) -> Edges:
        return edges_of(self.solids, self.thin)

    @cached_property
    def patches(self):
        return patches_of(self.thin)

    def index(self, name: str) -> int:
        return self.names.index(name)

    def seen_by(self, touched: Sequence[int]) -> int:
        """The key of the first mesh, of those that this one was made from, where these objects are as they are here: paths that
        touch no others tell none of them apart."""
        mesh = self
        while mesh.origin and mesh.origin[1] not in touched:
            mesh = mesh.origin[0]
        return mesh.key

    def moved(self, name: str, offset_m) -> "Mesh":
        offset_m = np.asarray(offset_m, float)
        return self._shifted(name, offset_m, self.coarse._moved_coarsely(name, np.round(offset_m / _COARSE_M)))

    def _moved_coarsely(self, name: str, steps: np.ndarray) -> "Mesh":
        if not steps.any():
            return self
        key = name, *steps.tolist()
        if key not in self._moves:
            self._moves[key] = self._shifted(name, steps * _COARSE_M, None)
        return self._moves[key]

    def _shifted(self, name: str, offset_m: np.ndarray, coarse: "Mesh | None") -> "Mesh":
        number = self.index(name)
        solids = tuple(replace(s, vertices_m=s.vertices_m + offset_m) if s.name == name else s for s in self.solids)
        thin, thick = (shifted(faces, number, offset_m) for faces in (self.thin, self.thick))
        return Mesh(solids, thin, thick, coarse, (self, number))

    def joined(self, solid: Solid) -> "Mesh":
        """One more object: a sheet. The same mesh again where it stands as it did, whatever it is made of: what was traced there
        is known by its mesh."""
        key = solid.name, solid.vertices_m.tobytes(), solid.faces.tobytes()
        return remembered(self._joined, [key], lambda missing: [self._with(solid)], kept=_JOINED_KEPT)[0]

    def _with(self, solid: Solid) -> "Mesh":
        faces, count = faces_of((solid,)), len(self.solids)
        thin, thick = (joined(own, faces, count) for own in (self.thin, self.thick))
        return Mesh((*self.solids, solid), thin, thick, self.coarse, (self, count))


@dataclass(frozen=True, kw_only=True)
class Person:
    """Something upright that moves: its axis at time 0, its velocity, how strongly it scatters (radar cross-section), and whether
    the echo has the polarisation of what came, or whichever is received."""

    position_m: tuple[float, float, float]
    velocity_m_per_s: tuple[float, float, float]
    cross_section_m2: float
    radius_m: float
    height_m: float
    keeps_polarisation: bool = False


@dataclass(frozen=True, kw_only=True)
class World:
    """Everything that the prediction depends on."""

    mesh: Mesh
    media: Mapping[str, Medium]
    surface: Surface
    radios: Mapping[str, Radio]
    carrier_hz: float
    max_depth: int
    diffraction: bool = False
    exponent: float = 2.0
    exponent_of: str = "link"  # the distance that it is of: from end to end, or along each path
    loss_db_per_m: float = 0.0
    link_loss_db: Mapping[tuple[str, str], float] = field(default_factory=dict)
    person: Person | None = None
    meters: Mapping[str, Meter] = field(default_factory=dict)
    fading: Mapping[tuple[str, str], Fading] = field(default_factory=dict)
    frozen: "World | None" = None

    @property
    def faces(self) -> Faces:
        return self.mesh.thick if self.is_clear else self.mesh.thin

    @cached_property
    def trace(self) -> int:
        """A key of what paths depend on beyond their ends."""
        return interned((self.mesh.key, self.max_depth, self.is_clear))

    @cached_property
    def law(self) -> int:
        """A key of what paths' gains depend on beyond their ends and the objects that they touch."""
        return interned((self.carrier_hz, self.exponent, self.exponent_of, self.loss_db_per_m))

    @property
    def is_clear(self) -> bool:
        return self.surface.is_clear

    @property
    def wavelength_m(self) -> float:
        return SPEED_OF_LIGHT_M_PER_S / self.carrier_hz

    def link_amplitude(self, link: tuple[str, str]) -> float:
        """Of both ends' gains and the link's own loss."""
        tx, rx = (self.radios[name] for name in link)
        return float(amplitude_from_db(tx.gain_db + rx.gain_db - self.link_loss_db.get(link, 0.0)))

    def amplitudes(self, links: Sequence[tuple[str, str]], gains_db: np.ndarray) -> np.ndarray:
        """(L,) of links, of both of whose ends the gains are known."""
        if not self.link_loss_db:
            return amplitude_from_db(gains_db)
        return amplitude_from_db(gains_db - np.array([self.link_loss_db.get(link, 0.0) for link in links]))

    def axes(self, index: int) -> list[np.ndarray]:
        """Directions of an object's faces, one of each two that face apart."""
        axes: list[np.ndarray] = []
        for normal in self.faces.normal[self.faces.owner == index]:
            if not any(abs(normal @ other) > 0.999 for other in axes):
                axes.append(normal)
        return axes

    def level_of(self, owner: str) -> str:
        """The contract's word for what `made_of` takes."""
        return "object" if owner in self.mesh.names else "place" if owner == "place" else "material"

    def made_of(self, owner: str) -> list[int]:
        """Indices of the object of that name, of all objects of that material, or of all in the place."""
        if owner in self.mesh.names:
            return [self.mesh.index(owner)]
        if owner == "place":
            return list(range(len(self.mesh.names)))
        return [i for i, name in enumerate(self.mesh.names) if name in self.media and self.media[name].material == owner]

    def with_radio(self, name: str, **changes) -> "World":
        return replace(self, radios={**self.radios, name: replace(self.radios[name], **changes)})

    def with_surface(self, index, **changes) -> "World":
        arrays = {key: self.surface.numbers[key].copy() for key in changes}
        for key, value in changes.items():
            arrays[key][index] = value
        return replace(self, surface=replace(self.surface, **arrays))

    def with_object(self, solid: Solid, **surface) -> "World":
        """One more object; what is not said of its surface is a smooth slab of 0.1 m."""
        values = {
            "thickness_m": SLAB_M,
            "height_rms_m": 0.0,
            "scattering": 0.0,
            "present": True,
            "clear": self.is_clear,
        } | surface
        arrays = {key: np.concatenate([own, [values[key]]]) for key, own in self.surface.numbers.items()}
        return replace(self, mesh=self.mesh.joined(solid), surface=Surface(**arrays))


def of_place(place: Place) -> World:
    """The world that the twin of a place case believes in."""
    return of_spec(place.spec, place.solids)


def of_spec(spec: Spec, solids: Sequence[Solid]) -> World:
    """The world of a SPEC and its objects, each with its medium."""
    radios = {node.name: Radio(node=node) for node in spec.nodes}
    mesh = Mesh.of(tuple(solids), np.concatenate([node.waypoints_m for node in spec.nodes]))
    media = {solid.name: solid.medium for solid in solids}
    surface = surface_of([*media.values()], spec.carrier_hz, clear=spec.refraction, scatters=spec.scattering)
    return World(
        mesh=mesh, media=media, surface=surface, radios=radios,
        carrier_hz=spec.carrier_hz, max_depth=spec.max_depth, diffraction=spec.diffraction,
    )  # fmt: skip


def frozen(world: World, at: World) -> World:
    """`world` over the paths of `at`: lengths, angles and fields follow, what is met and what blocks does not."""
    return replace(world, frozen=at if at.frozen is None else at.frozen)
