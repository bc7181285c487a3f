# SPDX-License-Identifier: GPL-3.0-or-later
"""Echoes over planes, summed with their phases: what one reflection gives many soundings at once, whatever its strength is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create import fields
from ...scenario.create.media import with_losses
from . import imaging
from .ears import evenly

_FINER = 16  # of the grid of delays over the resolution of the band: phases turn by a tenth of a radian between
_AT_ONCE = 200_000  # echoes
_LOOK_M = 0.1  # of a plane's level, within which antennas look at its images alike
_TINY, _LEAST = 1e-300, 1e-9
_RIDGE = 1e-6  # of both strengths' power: links that show but one of them


@dataclass(frozen=True, kw_only=True)
class Phased:
    """Residual rows (n): both ends, profile (n, bins) of what is left against a unit echo at each delay from 0 on, the power (n,)
    of a unit echo, and the link of each. A link that stands still is one row."""

    tx_m: np.ndarray
    rx_m: np.ndarray
    profile: np.ndarray
    power: np.ndarray
    link: np.ndarray
    antennas: tuple
    bins_per_s: float
    first_hz: float
    carrier_hz: float

    @classmethod
    def of(cls, ear, fit, world) -> "Phased":
        heard, predictor = ear.heard, ear.predictor
        size = 1 << int(np.ceil(np.log2(_FINER * len(heard.frequency_hz))))
        tx_m, rx_m, rows, power, number = [], [], [], [], []
        for index, link in enumerate(heard.links):
            ends = [np.broadcast_to(end, (len(predictor.time_s), 3)) for end in predictor.ends_m(world, index)]
            sent = world.link_amplitude(link)
            row = fit.residual[index] * fit.factor[index].conj() * heard.weight[index] * sent
            loud = (np.abs(fit.factor[index]) ** 2 * heard.weight[index]).sum(axis=1) * sent**2
            if not any(np.ptp(end, axis=0).any() for end in ends):
                ends = [end[:1] for end in ends]
                row, loud = row.sum(axis=0, keepdims=True), loud.sum(keepdims=True)
            tx_m.append(ends[0])
            rx_m.append(ends[1])
            rows.append(row)
            power.append(loud)
            number.append(np.full(len(row), index))
        return cls(
            tx_m=np.concatenate(tx_m), rx_m=np.concatenate(rx_m), power=np.concatenate(power), link=np.concatenate(number),
            profile=np.fft.ifft(np.concatenate(rows), size, axis=1) * size,
            antennas=tuple(tuple(world.radios[name].antenna for name in link) for link in heard.links),
            bins_per_s=size * heard.spacing_hz, first_hz=float(heard.frequency_hz[0]), carrier_hz=world.carrier_hz,
        )  # fmt: skip

    def taken(self, which: np.ndarray) -> "Phased":
        rows = {name: getattr(self, name)[which] for name in ("tx_m", "rx_m", "profile", "power", "link")}
        return replace(self, **rows)

    def thinned(self, rows: int) -> "Phased":
        """At most so many rows, as many of each link as of any other."""
        each = max(1, rows // len(self.antennas))
        own = [np.flatnonzero(self.link == link) for link in range(len(self.antennas))]
        return self.taken(np.concatenate([one[evenly(len(one), each)] for one in own if len(one)]))

    def nats(self, normal: np.ndarray, level_m: np.ndarray) -> np.ndarray:
        """Nats (P,) that the best two strengths, across and along the plane of incidence, of planes normal·x = level explain:
        normals (P, 3). Rows with an end on either side see none."""
        return np.concatenate([self._solved(self._sides(*part), *self._echoes(*part))[1] for part in self.parts(normal, level_m)])

    def nats_along(self, normal: np.ndarray, level_m: np.ndarray) -> np.ndarray:
        """The same of planes of one normal (3,) at evenly rising levels: antennas look hardly elsewhere from one to the next."""
        every = max(1, int(_LOOK_M / (level_m[1] - level_m[0])))
        out = []
        for normals, levels in self.parts(np.broadcast_to(normal, (len(level_m), 3)), level_m):
            knots = levels[0] + (levels[1] - levels[0]) * every * np.arange(-(-len(levels) // every) + 1)
            sides = self._sides(normals[:1].repeat(len(knots), axis=0), knots)
            low, share = np.divmod(np.arange(len(levels)) / every, 1)
            low = low.astype(int)
            sides = sides[..., low] * (1 - share) + sides[..., low + 1] * share
            out.append(self._solved(sides, *self._echoes(normals, levels))[1])
        return np.concatenate(out)

    def parts(self, normal: np.ndarray, level_m: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Planes, some at once."""
        parts = np.array_split(np.arange(len(level_m)), 1 + len(level_m) * len(self.power) // _AT_ONCE)
        return [(normal[part], level_m[part]) for part in parts]

    @property
    def length_m(self) -> np.ndarray:
        """(bins,) that an echo has at each delay of the profile."""
        return np.arange(self.profile.shape[1]) * SPEED_OF_LIGHT_M_PER_S / self.bins_per_s

    def every_nats(self) -> np.ndarray:
        """Nats (n, bins) of an echo at each delay in each row."""
        return _nats(self.profile, self.power[:, None])

    def alone_nats(self, length_m: np.ndarray) -> np.ndarray:
        """Nats (n,) of an echo of some length (n,) in each row, noise taken off."""
        return _nats(self.profile[np.arange(len(length_m)), self._place(length_m)], self.power) - imaging.CHANCE

    def _place(self, length_m: np.ndarray) -> np.ndarray:
        return np.mod(np.round(length_m / SPEED_OF_LIGHT_M_PER_S * self.bins_per_s).astype(np.int64), self.profile.shape[1])

    @property
    def wavelength_m(self) -> float:
        return SPEED_OF_LIGHT_M_PER_S / self.carrier_hz

    def met_m(self, normal: np.ndarray, level_m: np.ndarray) -> np.ndarray:
        """Where (n, P, 3) echoes over planes meet them, if both ends are on one side."""
        before, after = self.tx_m @ normal.T - level_m, self.rx_m @ normal.T - level_m
        return imaging.met_m(self.tx_m[:, None], self.rx_m[:, None], before, after, normal)

    def made_nats(
        self, normal: np.ndarray, level_m: np.ndarray, made: Sequence[tuple[float, float]], thickness_m: float
    ) -> np.ndarray:
        """Nats (M, n, P) by which planes, slabs of each permittivity and conductivity (S/m), explain each row."""
        eta = with_losses(*np.array(made).T, self.carrier_hz)
        parts = [self._made(*part, eta[:, None, None], thickness_m) for part in self.parts(normal, level_m)]
        return np.concatenate(parts, axis=2)

    def _made(self, normal: np.ndarray, level_m: np.ndarray, permittivity: np.ndarray, thickness_m: float) -> np.ndarray:
        (length_m, after, _), before = self._ways(normal, level_m), self.tx_m @ normal.T - level_m
        cos_in = np.clip(np.abs(before + after) / length_m, _LEAST, 1)
        te, tm, _, _ = fields.slab(permittivity, np.float64(thickness_m), cos_in, self.wavelength_m)
        (heard, power), (across, along) = self._echoes(normal, level_m), self._sides(normal, level_m)
        echo = te * across + tm * along
        return 2 * (echo.conj() * heard).real - np.abs(echo) ** 2 * power

    def row_nats(self, normal: np.ndarray, level_m: float, which: np.ndarray) -> np.ndarray:
        """Nats (n,) by which the best strengths of rows `which` over one plane explain each row."""
        plane = normal[None], np.array([level_m])
        sides, (heard, power) = self._sides(*plane), self._echoes(*plane)
        strength = self._solved(sides[:, which], heard[which], power[which])[0]
        echo = np.einsum("brp,pb->rp", sides, strength)
        return (2 * (echo.conj() * heard).real - np.abs(echo) ** 2 * power)[:, 0]

    def _ways(self, normal: np.ndarray, level_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lengths (n, P) over planes, heights (n, P) of the other end over them, and who has both ends on one side."""
        before, after = self.tx_m @ normal.T - level_m, self.rx_m @ normal.T - level_m
        on_side = before * after > 0
        apart = ((self.tx_m - self.rx_m) ** 2).sum(axis=1)[:, None]
        return np.sqrt(apart + 4 * np.where(on_side, before * after, 0)) + _LEAST, after, on_side

    def _echoes(self, normal: np.ndarray, level_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is heard (n, P) of an echo between isotropic antennas, and its power."""
        length_m, _, on_side = self._ways(normal, level_m)
        weaker = np.where(on_side, SPEED_OF_LIGHT_M_PER_S / self.carrier_hz / (4 * np.pi * length_m), 0.0)
        heard = np.take_along_axis(self.profile, self._place(length_m), axis=1) * weaker
        heard *= np.exp(2j * np.pi * (self.carrier_hz + self.first_hz) / SPEED_OF_LIGHT_M_PER_S * length_m)
        return heard, self.power[:, None] * weaker**2

    def _sides(self, normal: np.ndarray, level_m: np.ndarray) -> np.ndarray:
        """What antennas send and take (2, n, P) of both polarisations by mirrors."""
        length_m, after, _ = self._ways(normal, level_m)
        towards = (self.rx_m[:, None] - 2 * after[..., None] * normal - self.tx_m[:, None]) / length_m[..., None]
        sides = np.empty((2, *length_m.shape))
        for link in np.unique(self.link):
            own = self.link == link
            way = towards[own].reshape(-1, 3)
            mirror = np.broadcast_to(normal, towards[own].shape).reshape(-1, 3)
            sides[:, own] = np.reshape(_polarised(*self.antennas[link], way, mirror), (2, own.sum(), -1))
        return sides

    @staticmethod
    def _solved(sides, heard, power) -> tuple[np.ndarray, np.ndarray]:
        """Strengths (P, 2) of least squares, and the nats (P,) that they explain."""
        seen = (sides * heard).sum(axis=1).T
        loud = sides * power
        both = np.array([[(one * other).sum(axis=0) for other in loud] for one in sides]).transpose(2, 0, 1)
        both += (_RIDGE * np.trace(both, axis1=1, axis2=2)[:, None, None] + _TINY) * np.eye(2)
        strength = np.linalg.solve(both, seen[..., None])[..., 0]
        return strength, (seen.conj() * strength).real.sum(axis=1)


def _nats(heard: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Nats of echoes of any strength, each by itself, of which `heard` is left against a unit echo of some power."""
    return np.abs(heard) ** 2 / np.maximum(power, _TINY)


def _polarised(tx, rx, out: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What two antennas send and take by mirrors, for legs that go out along `out` (n, 3): across and along the incidence."""
    back = out - 2 * (out * normal).sum(axis=1, keepdims=True) * normal
    across = fields.cross(out, normal)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), _LEAST)
    sent, taken = fields.far_field(tx, out), fields.far_field(rx, -back)
    along = (sent * fields.cross(out, across)).sum(axis=1) * (taken * fields.cross(back, across)).sum(axis=1)
    return (sent * across).sum(axis=1) * (taken * across).sum(axis=1), along
