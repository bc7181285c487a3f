# SPDX-License-Identifier: GPL-3.0-or-later
"""Field of a path: antenna patterns, slabs of ITU-R P.2040-3, dyads of reflection and transmission, polarisation vertical."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S, amplitude_from_db
from .geometry import cross
from .images import Faces, Paths, chosen, tracing, unfold
from .media import Medium, with_losses

_TINY = 1e-12
_MET = "faces", "crossing_path", "crossing_leg", "crossing_face"
PATTERNS = "iso", "dipole", "hw_dipole", "tr38901"


@dataclass(frozen=True, kw_only=True)
class Surface:
    """What objects (O,) are made of at the carrier: relative permittivity, conductivity (S/m), thickness and roughness (m).

    `present`: it is there at all; `clear`: legs go through it with its transmission, else it blocks them.
    `scattering`: share of the reflected amplitude that is scattered (P.2040 and Degli-Esposti 2007).
    """

    permittivity: np.ndarray
    conductivity: np.ndarray
    thickness_m: np.ndarray
    height_rms_m: np.ndarray
    scattering: np.ndarray
    present: np.ndarray
    clear: np.ndarray

    @property
    def numbers(self) -> dict[str, np.ndarray]:
        return {name: getattr(self, name) for name in self.__dataclass_fields__}

    @property
    def standing(self) -> bytes:
        """Of what is there, and what blocks."""
        return self.present.tobytes() + self.clear.tobytes()

    @cached_property
    def is_clear(self) -> bool:
        """Whether legs go through anything at all."""
        return bool(self.clear.any())

    @cached_property
    def scatters(self) -> bool:
        return bool((self.scattering > 0).any())

    @cached_property
    def keys(self) -> list[bytes]:
        """One of each object: of its numbers."""
        return [row.tobytes() for row in np.column_stack([values.astype(float) for values in self.numbers.values()])]

    @cached_property
    def key(self) -> bytes:
        return b"".join(self.keys)


def surface_of(media: Sequence[Medium], carrier_hz: float, *, clear: bool = False, scatters: bool = True) -> Surface:
    """Objects made of `media` at the carrier, all there: legs go through all or none, all scatter as their media or none does."""
    return Surface(
        permittivity=np.array([medium.permittivity(carrier_hz) for medium in media]),
        conductivity=np.array([medium.conductivity(carrier_hz) for medium in media]),
        thickness_m=np.array([medium.thickness_m for medium in media]),
        height_rms_m=np.array([medium.height_rms_m for medium in media]),
        scattering=np.array([medium.scattering_coefficient * scatters for medium in media]),
        present=np.ones(len(media), bool),
        clear=np.full(len(media), clear),
    )


def rough_loss(height_rms_m: np.ndarray, cos_in: np.ndarray, wavelength_m: float) -> np.ndarray:
    """What roughness leaves of the amplitude of a reflection: exp(-8 (π σ cosθ / λ)²) (Ament 1953)."""
    return np.exp(-8 * (np.pi * height_rms_m * cos_in / wavelength_m) ** 2)


@dataclass(frozen=True, kw_only=True)
class Antenna:
    pattern: str
    orientation_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class Optics:
    """Geometry of paths that fields need: points, unit directions of legs (n, D + 1, 3), lengths (n,)."""

    points_m: np.ndarray
    direction: np.ndarray
    length_m: np.ndarray


def optics(faces: Faces, met: np.ndarray, tx_m: np.ndarray, rx_m: np.ndarray) -> Optics:
    """From `unfold`; an unused leg points along the one before."""
    if tracing:
        points, direction, length_m = faces.compiled.optics(met, tx_m, rx_m)
        return Optics(points_m=points, direction=direction, length_m=length_m)
    points = unfold(faces, met, tx_m, rx_m)
    legs = np.diff(points, axis=1)
    lengths = np.linalg.norm(legs, axis=2)
    direction = legs / np.maximum(lengths, _TINY)[:, :, None]
    for bounce in range(met.shape[1]):
        direction[:, bounce + 1] = np.where((met[:, bounce] >= 0)[:, None], direction[:, bounce + 1], direction[:, bounce])
    return Optics(points_m=points, direction=direction, length_m=lengths.sum(axis=1))


def rows_of(way: Optics, rows) -> Optics:
    return Optics(points_m=way.points_m[rows], direction=way.direction[rows], length_m=way.length_m[rows])


@lru_cache(maxsize=4096)
def turned(orientation_rad: tuple[float, float, float]) -> np.ndarray:
    """Rotation (3, 3): yaw about z, then pitch about y, then roll about x of the antenna's own axes."""
    (cy, cp, cr), (sy, sp, sr) = np.cos(orientation_rad), np.sin(orientation_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def far_field(antenna: Antenna, direction: np.ndarray) -> np.ndarray:
    """Field (n, 3) that an antenna sends along `direction` (n, 3), or takes from it: along its own theta, gain as amplitude."""
    return far_fields([antenna], np.zeros(len(direction), np.int64), direction)


def far_fields(antennas: Sequence[Antenna], which: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The same of several antennas: number `which` (n,) of them along direction i."""
    if tracing:
        shapes = [PATTERNS.index(one.pattern) for one in antennas]
        return tracing.far_fields(shapes, [turned(one.orientation_rad) for one in antennas], which, direction)
    out = np.empty(direction.shape)
    for number, antenna in enumerate(antennas):
        out[which == number] = _far_field(antenna, direction[which == number])
    return out


def _far_field(antenna: Antenna, direction: np.ndarray) -> np.ndarray:
    rotation = turned(antenna.orientation_rad)
    own = direction @ rotation
    across = np.hypot(own[:, 0], own[:, 1])
    cos_theta, sin_theta = np.clip(own[:, 2], -1, 1), across
    safe = np.maximum(across, _TINY)
    cos_phi, sin_phi = np.where(across > _TINY, own[:, 0] / safe, 1.0), np.where(across > _TINY, own[:, 1] / safe, 0.0)
    theta = np.stack([cos_theta * cos_phi, cos_theta * sin_phi, -sin_theta], axis=1)
    return (amplitude(antenna.pattern, cos_theta, sin_theta, np.arctan2(sin_phi, cos_phi))[:, None] * theta) @ rotation.T


def amplitude(pattern: str, cos_theta: np.ndarray, sin_theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """Amplitude over isotropic: `iso`, `dipole` (short, 1.76 dB), `hw_dipole` (2.15 dB), `tr38901` (TR 38.901, table 7.3-1)."""
    if pattern == "iso":
        return np.ones_like(cos_theta)
    if pattern == "dipole":
        return np.sqrt(1.5) * sin_theta
    if pattern == "hw_dipole":
        safe = np.maximum(sin_theta, _TINY)
        return np.where(sin_theta > 1e-6, np.sqrt(1.643) * np.cos(np.pi / 2 * cos_theta) / safe, 0.0)
    theta_deg, phi_deg = np.degrees(np.arctan2(sin_theta, cos_theta)), np.degrees(phi)
    down_db = np.minimum(12 * ((theta_deg - 90) / 65) ** 2, 30)
    aside_db = np.minimum(12 * (phi_deg / 65) ** 2, 30)
    return amplitude_from_db(8 - np.minimum(down_db + aside_db, 30))


def free_space(way: Optics, rows: np.ndarray, tx: Antenna, rx: Antenna, carrier_hz: float) -> np.ndarray:
    """Amplitude of paths `rows` if nothing that they meet took any of it: λ/(4π·length) and both antennas (Friis)."""
    sent = np.linalg.norm(far_field(tx, way.direction[rows, 0]), axis=1)
    taken = np.linalg.norm(far_field(rx, -way.direction[rows, -1]), axis=1)
    return SPEED_OF_LIGHT_M_PER_S / carrier_hz / (4 * np.pi * way.length_m[rows]) * sent * taken


def slab(permittivity: np.ndarray, thickness_m: np.ndarray, cos_in: np.ndarray, wavelength_m: float) -> tuple[np.ndarray, ...]:
    """Reflection TE, TM and transmission TE, TM of a slab in air, complex `permittivity` (P.2040-3, equations 37 to 44)."""
    root = np.sqrt(permittivity - (1 - cos_in**2))
    te = (cos_in - root) / (cos_in + root)
    tm = (permittivity * cos_in - root) / (permittivity * cos_in + root)
    endless = np.isinf(thickness_m)  # ground: nothing comes back from its far side
    once = np.where(endless, 0, np.exp(-2j * np.pi * np.where(endless, 0, thickness_m) / wavelength_m * root))
    twice = once**2
    out = []
    for r in (te, tm):
        out.append(r * (1 - twice) / (1 - r**2 * twice))
    for r in (te, tm):
        out.append((1 - r**2) * once / (1 - r**2 * twice))
    return tuple(out)


def unblocked(faces: Faces, paths: Paths, surface: Surface) -> Paths:
    """Paths whose objects are all there and whose legs go through clear ones at most."""
    return chosen(paths, are_unblocked(faces, paths, surface))


def are_unblocked(faces: Faces, paths: Paths, surface: Surface) -> np.ndarray:
    """(n,) whether a path is one of these."""
    object_of = faces.owner
    keep = ~((paths.faces >= 0) & ~surface.present[object_of[paths.faces]]).any(axis=1)
    shut = (surface.present & ~surface.clear)[object_of[paths.crossing_face]]
    keep[paths.crossing_path[shut]] = False
    return keep


def gains(
    faces: Faces, paths: Paths, way: Optics, surface: Surface, start: np.ndarray, end: np.ndarray, carrier_hz: float
) -> np.ndarray:
    """Gain of every path (n,) of `unblocked`, without the phase of its delay: λ/(4π·length) times antennas' fields and dyads.

    `start` (n, 3): the field sent along the first leg; `end` (n, 3): the field that the receiver takes from the last.
    """
    wavelength_m = SPEED_OF_LIGHT_M_PER_S / carrier_hz
    eta = with_losses(surface.permittivity, surface.conductivity, carrier_hz)
    if tracing:
        return tracing.gains(
            faces.normal, faces.owner, *(vars(paths)[name] for name in _MET), way.direction, way.length_m,
            eta, surface.thickness_m, surface.height_rms_m, surface.scattering, surface.present, start, end, wavelength_m,
        )  # fmt: skip
    field = start.astype(complex)
    through = np.flatnonzero(surface.present[faces.owner[paths.crossing_face]])
    for leg in range(paths.faces.shape[1] + 1):
        _pass(faces, paths, way, surface, eta, wavelength_m, field, through[paths.crossing_leg[through] == leg], leg)
        if leg < paths.faces.shape[1]:
            rows = np.flatnonzero(paths.faces[:, leg] >= 0)
            _reflect(faces, paths.faces[rows, leg], way, surface, eta, wavelength_m, field, rows, leg)
    return wavelength_m / (4 * np.pi * way.length_m) * np.einsum("ij,ij->i", field, end)


def _across(incoming: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Unit vector across the plane of incidence; any one where a ray falls straight."""
    across = cross(incoming, normal)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    other = cross(incoming, np.where(np.abs(incoming[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
    return np.where(size > 1e-9, across / np.maximum(size, _TINY), other / np.linalg.norm(other, axis=1, keepdims=True))


def _reflect(faces, face, way, surface, eta, wavelength_m, field, rows, leg) -> None:
    if not len(rows):
        return
    incoming, outgoing, normal, owner = (
        way.direction[rows, leg],
        way.direction[rows, leg + 1],
        faces.normal[face],
        faces.owner[face],
    )
    cos_in = np.clip(np.abs(np.einsum("ij,ij->i", incoming, normal)), 1e-9, 1)
    te, tm, _, _ = slab(eta[owner], surface.thickness_m[owner], cos_in, wavelength_m)
    rough = rough_loss(surface.height_rms_m[owner], cos_in, wavelength_m) * np.sqrt(1 - surface.scattering[owner] ** 2)
    across = _across(incoming, normal)
    before, after = cross(across, incoming), cross(across, outgoing)
    old = field[rows]
    field[rows] = (
        (rough * te * np.einsum("ij,ij->i", old, across))[:, None] * across
        + (rough * tm * np.einsum("ij,ij->i", old, before))[:, None] * after
    )  # fmt: skip


def _pass(faces, paths, way, surface, eta, wavelength_m, field, crossing, leg) -> None:
    """Transmission through the slabs that a leg crosses, one after the other."""
    while len(crossing):
        rows, first = np.unique(paths.crossing_path[crossing], return_index=True)
        face = paths.crossing_face[crossing[first]]
        direction, normal, owner = way.direction[rows, leg], faces.normal[face], faces.owner[face]
        cos_in = np.clip(np.abs(np.einsum("ij,ij->i", direction, normal)), 1e-9, 1)
        _, _, te, tm = slab(eta[owner], surface.thickness_m[owner], cos_in, wavelength_m)
        across = _across(direction, normal)
        along = cross(across, direction)
        old = field[rows]
        field[rows] = (te * np.einsum("ij,ij->i", old, across))[:, None] * across + (tm * np.einsum("ij,ij->i", old, along))[
            :, None
        ] * along
        crossing = np.delete(crossing, first)
