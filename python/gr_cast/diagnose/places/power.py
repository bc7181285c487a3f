# SPDX-License-Identifier: GPL-3.0-or-later
"""Powers in dB as the engine hears them: Gaussian errors of the meter, fading as correlated errors more, and a scale that ends.

All rows are scaled so that an energy is their sum of squares: nats, as with responses.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.special import log_ndtr

from ...core.units import db_from_power
from ...twin.places.meters import DB_PER_NEPER, Fading, Meter
from ...twin.places.predict import Predictor
from ...twin.places.world import World
from .likelihood import Fitted, incidence

_FAINT = 1e-30
_SAME_DB = 1e-6  # readings that are one number
_BLOCK = 96  # instants whose fading is correlated; more are taken block by block
_ROUNDS = 6  # of gains where the meter's scale ends
_REPEAT_NATS = 3.0  # that a reading on the scale's own number is worth: chance would spread it over 1/20 of the error


@dataclass(frozen=True, eq=False, kw_only=True)
class Expected:
    """What a world gives: mean power (L, T), and per link its meter, and its fading with where both ends are (T, 6)."""

    mean_db: np.ndarray
    meters: tuple[Meter | None, ...]
    fading: tuple[tuple[Fading, np.ndarray] | None, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class Spread:
    """Fading on a link: (instants, inverse root of their covariance) per block, and nats of all determinants."""

    fading: Fading
    blocks: tuple[tuple[np.ndarray, np.ndarray], ...]
    nats: float


@dataclass(frozen=True, eq=False, kw_only=True)
class PowerFit(Fitted):
    """`rows` (L, T) and their `slope` after what the meter reads in the mean; fading links have their `spread` instead.
    `shift` (L,): the unknown gains. `share` (L, T): by how much that mean follows the power that comes."""

    rows: np.ndarray
    slope: np.ndarray
    spread: tuple[Spread | None, ...]
    shift: np.ndarray
    share: np.ndarray


@dataclass(frozen=True, eq=False)
class PowerEar:
    """Powers in dB with Gaussian errors; energy Σ(residual²)/(2·std²), so that it counts in nats like the other."""

    predictor: Predictor
    power_db: np.ndarray  # (L, T, 1)
    weight: np.ndarray
    limits_db: tuple[float, float] | None
    gain: str

    has_responses = False

    @property
    def count(self) -> float:
        return float((self.weight > 0).sum()) / 2

    @property
    def root(self) -> np.ndarray:
        return np.sqrt(self.weight)

    def predicted(self, world: World) -> Expected:
        power = (np.abs(self.predictor.response(world)) ** 2).mean(axis=2)
        links = self.predictor.links
        fading = tuple(
            (world.fading[link], np.concatenate(self.predictor.ends_m(world, index), axis=1)) if link in world.fading else None
            for index, link in enumerate(links)
        )
        mean_db = db_from_power(np.maximum(power, _FAINT))
        mean_db = mean_db + np.array([one[0].moments_db()[0] if one else 0.0 for one in fading])[:, None]
        return Expected(mean_db=mean_db, meters=tuple(world.meters.get(rx) for _, rx in links), fading=fading)

    def profiled(self, expected: Expected) -> PowerFit:
        design = self._design
        spread = tuple(self._spread(link, *one) if one else None for link, one in enumerate(expected.fading))
        shift = np.zeros(design.shape[1])
        model, rows, slope, extra, share = self._rows(expected, spread, design @ shift)
        is_curved = self.limits_db is not None or any(expected.meters)
        for _ in range((_ROUNDS if is_curved else 1) if design.shape[1] else 0):
            j = np.stack([self._turned(slope, spread, d[:, None] * share).ravel() for d in design.T], 1)
            step = np.linalg.lstsq(j, -rows.ravel(), rcond=1e-9)[0]
            shift = shift + step
            model, rows, slope, extra, share = self._rows(expected, spread, design @ shift)
        residual = np.where(self.weight[:, :, 0] > 0, self.power_db[:, :, 0] - model, 0.0)
        offset = extra + sum(one.nats for one in spread if one)  # what is no residual's
        return PowerFit(
            model=model[:, :, None], residual=residual[:, :, None], energy=float((rows**2).sum()) + offset, offset=offset,
            factor=np.ones_like(self.power_db), rows=rows, slope=slope, spread=spread,
            shift=design @ shift, share=share,
        )  # fmt: skip

    @property
    def _design(self) -> np.ndarray:
        """(L, numbers): the unknown gains of links."""
        if self.gain == "node":
            return incidence(self.predictor.links)
        return np.ones((len(self.power_db), 1 if self.gain == "common" else 0))

    def _spread(self, link: int, fading: Fading, at_m: np.ndarray) -> Spread:
        weight = self.weight[link, :, 0]
        known = np.flatnonzero(weight > 0)
        blocks, nats = [], 0.0
        for part in np.array_split(known, int(np.ceil(len(known) / _BLOCK))) if len(known) else ():
            gap_m = np.linalg.norm(at_m[part][:, None] - at_m[part][None], axis=2)
            noise = 0.5 / weight[part]
            root = np.linalg.cholesky(fading.covariance_db2(gap_m) + np.diag(noise))
            blocks.append((part, solve_triangular(root, np.eye(len(part)), lower=True)))
            nats += float(np.log(np.diag(root)).sum() - 0.5 * np.log(noise).sum())
        return Spread(fading=fading, blocks=tuple(blocks), nats=nats)

    def _rows(self, expected: Expected, spread, shift: np.ndarray):
        """Model as it is read, rows, slopes after the mean, nats that exact readings of the scale are worth (less than 0), and by
        how much the mean follows what comes."""
        y, root = self.power_db[:, :, 0], self.root[:, :, 0]
        mean, share = _with_noise(expected, shift)
        top, floor, step = self._scales(expected)
        model = np.clip(mean, floor, top)
        model = np.where(step > 0, np.round(model / np.where(step > 0, step, 1)) * step, model)
        known = root > 0
        rows, slope = np.where(known, (y - mean) * root, 0.0), -root
        z = np.sqrt(2) * root
        for where, below, above in (
            (known & (y >= top - _SAME_DB), top, np.inf),
            (known & (y <= floor + _SAME_DB), -np.inf, floor),
            (known & (step > 0), y - step / 2, y + step / 2),
        ):
            if where.any():
                low, high = ((np.broadcast_to(edge, y.shape)[where] - mean[where]) * z[where] for edge in (below, above))
                rows[where], slope[where] = _massed(low, high, z[where], (y - mean)[where])
        own = np.array([meter is not None and not np.isfinite(meter.noise_db) for meter in expected.meters])[:, None]
        exact = known & own & ((y >= top - _SAME_DB) | (y <= floor + _SAME_DB) | (step > 0))
        for link, one in enumerate(spread):
            if one:
                rows[link] = self._turned_link(one, np.where(known[link], model[link] - y[link], 0.0))
                exact[link] = False
        return model, rows, slope, -_REPEAT_NATS * float(exact.sum()), share

    def _scales(self, expected: Expected):
        low, high = self.limits_db or (-np.inf, np.inf)
        meters = [meter or Meter() for meter in expected.meters]
        top = np.array([min(high, meter.top_db) for meter in meters])[:, None]
        floor = np.array([max(low, meter.floor_db) for meter in meters])[:, None]
        return top, floor, np.array([meter.step_db for meter in meters])[:, None]

    @staticmethod
    def _turned_link(spread: Spread, change: np.ndarray) -> np.ndarray:
        out = np.zeros_like(change)
        for part, inverse in spread.blocks:
            out[part] = -inverse @ change[part] / np.sqrt(2)
        return out

    def _turned(self, slope: np.ndarray, spread, change: np.ndarray) -> np.ndarray:
        """Change of the rows when the mean changes."""
        out = slope * change
        for link, one in enumerate(spread):
            if one:
                out[link] = self._turned_link(one, change[link])
        return out

    def nats(self, fit: PowerFit) -> np.ndarray:
        """(L,) energy of each link, with what its fading costs."""
        return self.left(fit) + np.array([one.nats if one else 0.0 for one in fit.spread])

    def tempered_nats(self, fit: PowerFit) -> float:
        """None: a reading is one number, whose noise says nothing of the next."""
        return 0.0

    def left(self, fit: PowerFit) -> np.ndarray:
        """(L,) energy of each link that is a residual's."""
        return (fit.rows**2).sum(axis=1)

    def rows(self, fit: PowerFit) -> np.ndarray:
        """What the fit leaves, and how far each fading's residual is from its covariance."""
        more = []
        for link, one in enumerate(fit.spread):
            for part, _ in one.blocks if one else ():
                white = np.sqrt(2) * fit.rows[link, part]
                more.append(0.5 * (np.outer(white, white) - np.eye(len(part))).ravel())
        return np.concatenate([fit.rows.ravel(), *more])

    def columns(self, fit: PowerFit, here: Expected, moved: Expected, step: float) -> np.ndarray:
        """Derivative of what is explained; a change of fading changes the covariance beside the mean."""
        change = (_with_noise(moved, fit.shift)[0] - _with_noise(here, fit.shift)[0]) / step
        mean = -self._turned(fit.slope, fit.spread, change)
        more = []
        for link, one in enumerate(fit.spread):
            if one is None:
                continue
            other = self._spread(link, *moved.fading[link]) if moved.fading[link][0] != one.fading else one
            for (part, inverse), (_, changed) in zip(one.blocks, other.blocks, strict=True):
                if other is one:
                    more.append(np.zeros(len(part) ** 2))
                else:
                    root = inverse @ np.linalg.inv(changed)
                    more.append(0.5 * (root @ root.T - np.eye(len(part))).ravel() / step)
        return np.concatenate([mean.ravel(), *more])

    def nuisance(self, fit: PowerFit) -> list[np.ndarray]:
        zeros = np.zeros(sum(len(part) ** 2 for one in fit.spread if one for part, _ in one.blocks))
        return [
            np.concatenate([-self._turned(fit.slope, fit.spread, d[:, None] * fit.share).ravel(), zeros]) for d in self._design.T
        ]


def _with_noise(expected: Expected, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(L, T) mean of what is read in dB, the meter's own noise with it, and its slope after what comes."""
    coming = (expected.mean_db + shift[:, None]) / DB_PER_NEPER
    noise = np.array([-np.inf if meter is None else meter.noise_db for meter in expected.meters])[:, None] / DB_PER_NEPER
    both = np.logaddexp(coming, noise)
    return both * DB_PER_NEPER, np.exp(coming - both)


def _massed(low: np.ndarray, high: np.ndarray, scale: np.ndarray, side: np.ndarray):
    """Row and slope after the mean of readings known to lie between `low` and `high` deviations of the mean."""
    flip = low > 0  # the tail that keeps its digits
    a, b = np.where(flip, -high, low), np.where(flip, -low, high)
    upper, lower = log_ndtr(b), log_ndtr(a)
    mass = upper + np.log1p(-np.exp(np.minimum(lower - upper, -1e-12)))
    size = np.sqrt(np.maximum(-mass, 1e-12))
    rise = (_hazard(high, mass) - _hazard(low, mass)) * scale  # of the energy with the mean
    sign = np.where(side >= 0, 1.0, -1.0)
    return sign * size, sign * rise / (2 * size)


def _hazard(edge: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """The normal density at an edge over the probability whose logarithm is `mass`."""
    finite = np.isfinite(edge)
    return np.where(finite, np.exp(np.where(finite, -0.5 * np.where(finite, edge, 0.0) ** 2 - mass, 0.0)), 0.0) / np.sqrt(
        2 * np.pi
    )
