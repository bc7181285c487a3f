# SPDX-License-Identifier: GPL-3.0-or-later
"""A diffuse tail behind the first tap, or behind a later one: many weak taps whose power falls by e in decay_s. Internal: Re and
Im of the taps.

Its law is that of scattering (Bello 1963): taps of independent circular Gaussian gains with the mean power
P·exp(−k/τ)/Σ. Power and decay are told by the likelihood of what was recorded under the law, all taps averaged out
(MacKay 1992), `Told`.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft
from scipy import linalg, optimize

from ..columns import Lags
from ..scene import Path
from .base import LINK, PROBE, Family, Multiplicity, start
from .extra_path import ExtraPath
from .front_end_filter import FrontEndFilter
from .values import NEEDED_POSITIVE, NUMBER, NUMBERS

SIZES = (8, 16, 32, 64, 128, 256)
LONG = 64  # taps from which a tail is looked for only where the residual holds its waveform that late
LATE_SIGMA = 3.0  # standard deviations by which it must
FALLS = 3.0  # decays that a row of taps holds when the search begins
WHOLE = 7.0  # decays after which less than a thousandth is left
ENDS = (3.0, 5.0, WHOLE, np.inf)  # decays after which a tail may end: one that ends before 3 has no decay to speak of
SKIRT = 3e-4  # power that taps between two samples leave far from them, over that of the first
ONSET_NATS = 10.0  # by which a tail must be likelier behind a later tap, of which a link has some, than behind the first
DECAYS = 6  # that are tried for each of them
ALIKE = 0.5  # decays in which taps come together, where they come in clusters
NEPER_STEP = 0.1  # of power and decay, for the curvature of their likelihood
LEAST_VARIANCE = 0.25  # of ln power and ln decay, times the taps of one decay: however well each is known, they are few
BY_CHANCE = 10.0  # taps of each decay, of which one is the strongest: exponential powers are ln n times their mean at most
STILL = 0.5  # cycles that an echo turns at most, to be one of the taps, which do not
ROUNDING = 1e-13  # of the largest information, that sums of it may be less than nothing by
UNRESOLVED = (
    1.2  # decays over what the band resolves, up to which nothing but its length, which a filter may have, tells of a tail
)
LEAST_DECAY = 0.5  # samples: a shorter one is a tap
DB = 10 / np.log(10)


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a recording says of taps: `information` (2k, 2k) about their Re and Im without any law, and `pull` (2k,),
    information times their likeliest values."""

    information: np.ndarray
    pull: np.ndarray

    @staticmethod
    def of(p: np.ndarray, covariance: np.ndarray, prior: np.ndarray) -> "Told":
        """From the posterior mean and covariance under a law of variances `prior`. Where the recording says next to nothing of
        some sum of taps, rounding may leave less than nothing of it: that is taken as nothing."""
        precision = linalg.inv(covariance)
        values, vectors = np.linalg.eigh(precision - np.diag(1 / np.maximum(prior, 1e-30)))
        seen = vectors[:, values > 0]
        return Told(information=(seen * values[values > 0]) @ seen.T, pull=seen @ (seen.T @ (precision @ p)))

    def likelihood(self, law: np.ndarray) -> float:
        """ln of the recording's probability under a law of variances (2k,), over that without any taps."""
        root = np.sqrt(law)
        known = self.information * np.outer(root, root)
        known[np.diag_indices(len(law))] += 1 + ROUNDING * np.diag(known).max()  # what is known so well has rounding of its own
        factor = linalg.cholesky(known, lower=True, check_finite=False)
        y = linalg.solve_triangular(factor, root * self.pull, lower=True, check_finite=False)
        return float(0.5 * y @ y - np.log(np.diag(factor)).sum())

    def taps(self, law: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and covariance of the taps, given the recording and the law."""
        root = np.sqrt(law)
        covariance = np.outer(root, root) * linalg.inv(np.eye(len(law)) + self.information * np.outer(root, root))
        return covariance @ self.pull, covariance

    def power(self, law: np.ndarray) -> float:
        """Mean power of all taps, given the recording and the law."""
        mean, covariance = self.taps(law)
        return float(np.sum(mean**2) + np.trace(covariance))


def profile(size: int, power: float, decay: float, end: float = np.inf, onset: int = 0) -> np.ndarray:
    """(2·size,) variances of Re and Im of taps that hold `power` in all, falling by e in `decay` samples from the tap `onset` on,
    none after `end` of them."""
    k = np.arange(size) - onset
    shape = np.exp(-np.maximum(k, 0) / decay) * ((k >= 0) & (k < max(end, 1.0))) + SKIRT
    return np.repeat(power / 2 * shape / shape.sum(), 2)


def likeliest(told: Told, begin: tuple[float, float], ends: float = np.inf, onset: int = 0) -> tuple[float, np.ndarray]:
    """(ln L, [ln power, ln decay]) of the law that makes a recording likeliest; it ends after so many decays."""
    size = len(told.pull) // 2
    low, high = np.log(LEAST_DECAY), np.log(size)

    def cost(q):
        beyond = max(q[1] - high, low - q[1], 0.0)
        power, decay = np.exp(np.clip(q[0], -60.0, 20.0)), np.exp(np.clip(q[1], low, high))
        return beyond * size - told.likelihood(profile(size, power, decay, ends * decay, onset))

    corners = np.log(begin) + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, -1.0]])
    options = {"initial_simplex": corners, "xatol": 0.02, "fatol": 0.1}
    found = optimize.minimize(cost, corners[0], method="Nelder-Mead", options=options)
    return -float(found.fun), np.array([found.x[0], np.clip(found.x[1], low, high)])


def onset_of(told: Told, power: float, onsets: tuple[int, ...]) -> int:
    """Of the taps behind which a tail of about that power may begin, the first (0) and later ones, that which makes a recording
    likeliest."""
    size = len(told.pull) // 2
    decays = np.geomspace(1.0, size / FALLS, DECAYS)
    laws = {onset: [profile(size, power, d, onset=onset) for d in decays] for onset in (0, *onsets) if onset < size - 1}
    nats = {onset: max(told.likelihood(law) for law in of_onset) for onset, of_onset in laws.items()}
    best = max(nats, key=nats.get)
    return best if nats[best] > nats[0] + ONSET_NATS else 0


def spread(told: Told, at: np.ndarray, onset: int = 0) -> np.ndarray:
    """(2,) variances of ln power and ln decay: from the curvature of their likelihood, or, where taps are sparse or come in
    clusters, from how unevenly they speak for the law (White 1982), whichever is larger."""
    size, axes = len(told.pull) // 2, np.eye(2) * NEPER_STEP

    def law(q):
        return profile(size, *np.exp(q), onset=onset)

    def cost(q):
        return -told.likelihood(law(q))

    both = [[cost(at + a + b) - cost(at + a - b) - cost(at - a + b) + cost(at - a - b) for b in axes] for a in axes]
    values, vectors = np.linalg.eigh(np.array(both) / (2 * NEPER_STEP) ** 2)
    curved = vectors @ np.diag(1 / np.maximum(values, 0.25)) @ vectors.T  # two nepers at most: nothing is known
    mean, covariance = told.taps(law(at))
    excess = ((mean**2 + np.diag(covariance)) / law(at) - 1).reshape(-1, 2).sum(1) / 2
    slopes = excess * np.array([np.log(law(at + a) / law(at - a))[::2] / (2 * NEPER_STEP) for a in axes])
    variances = [np.diag(curved)]
    for width in (1, int(np.ceil(ALIKE * np.exp(at[1])))):
        groups = np.add.reduceat(slopes, np.arange(0, size, width), axis=1)
        variances.append(np.diag(curved @ (groups @ groups.T) @ curved))
    return np.max(variances, axis=0)


class DiffuseTail(Family):
    name = "diffuse_tail"
    parameters = {"decay_s": NEEDED_POSITIVE, "power_db": NUMBER}
    remembered = {"first": NUMBER, "taps": NUMBERS}
    owners = ("link",)
    multiplicity = Multiplicity.ONE
    stage = LINK
    flexible = True
    linear = True
    row_of_taps = True
    entangled = True

    def apply(self, chain, effect):
        taps = effect.p[::2] + 1j * effect.p[1::2]
        first = effect.aux["first"]
        if taps.any():
            chain.paths.append(Path(source=effect.aux["source"], delay=first, gain=1.0, shape=taps))

    def nest(self, scene, effect):
        size = 2 * effect.aux["_longest"]
        return (
            (effect.aux["source"], effect.aux["first"]),
            replace(effect, p=np.zeros(size), free=np.ones(size, bool), prior=None),
            np.arange(len(effect.p)),
        )

    def columns(self, scene, effect, chain, before, rest):
        one = before.copy()
        one.paths.append(Path(source=effect.aux["source"], delay=effect.aux["first"], gain=PROBE))
        unit = (rest(one, effect).y - chain.y) / PROBE
        entries = tuple((0, k) for k in range(len(effect.p) // 2))
        return Lags(signals=unit[None], entries=entries, paired=chain.facing, turn=chain.turn_per_sample())

    def starts(self, view):
        unknown = not all(s.known.all() for s in view.scene.sources)
        for i in range(len(view.scene.sources)):
            first = min(t.delay for t in view.scene.taps if t.source == i) + 1.0
            most = min(view.scene.count // 12, 24 if unknown else SIZES[-1])
            if most > LONG and view.held_late(i, first + LONG, first + most) < LATE_SIGMA:
                most = LONG
            sizes = [s for s in SIZES if s <= most]
            onsets = {int(t.delay - first) for t in view.scene.taps if t.source == i and t.delay >= first + 1}
            for size in sizes:
                yield start(
                    self,
                    np.zeros(2 * size),
                    prior=np.exp(-FALLS * np.repeat(np.arange(size), 2) / size),
                    aux={"source": i, "first": first, "_longest": sizes[-1], "_onsets": tuple(sorted(onsets))},
                    trials=len(SIZES),
                )

    def likelier(self, effect, covariance):
        told = Told.of(effect.p, covariance, effect.prior)
        begin = self._begin(effect)
        onset = onset_of(told, begin[0], effect.aux.get("_onsets", ()))
        power, decay = np.exp(likeliest(told, begin, onset=onset)[1])
        size = min(len(effect.p) // 2, onset + int(np.ceil(WHOLE * decay)) + 1)
        return replace(
            effect,
            p=effect.p[: 2 * size],
            free=np.ones(2 * size, bool),
            prior=profile(size, float(power), float(decay), onset=onset),
            aux={**effect.aux, "_onset": onset},
        )

    def imitated(self, scene, effect):
        """A filter, of a tail that is over within what the band resolves: such a filter rings as long."""
        i, power = effect.aux["source"], effect.p[::2] ** 2 + effect.p[1::2] ** 2
        main = max((t for t in scene.taps if t.source == i), key=lambda t: abs(t.gain))
        heard = np.abs(sp_fft.fft(scene.sources[i].samples)) ** 2
        resolved = np.mean(heard**2) / np.mean(heard) ** 2  # samples
        is_short = np.arange(len(power)) @ power <= UNRESOLVED * resolved * power.sum()
        if is_short and effect.prior is not None and effect.aux["first"] == main.delay + 1:
            aux, prior = {"low": 0, "high": len(power), "side": "tx", "source": i}, effect.prior / abs(main.gain) ** 2
            yield start(FrontEndFilter(), np.zeros(len(effect.p)), aux=aux, prior=prior, trials=effect.trials)

    def settled_law(self, scene, effect, covariance):
        """With power and decay as the recording tells them, whether or not the tail ends; their errors are those of a law
        without an end, and what the ends make of it."""
        told, begin = Told.of(effect.p, covariance, effect.prior), self._begin(effect)
        onset = effect.aux.get("_onset", 0)
        found = [likeliest(told, begin, ends, onset) for ends in ENDS]
        weight = np.exp([nats - max(n for n, _ in found) for nats, _ in found])
        weight /= weight.sum()
        at = np.array([q for _, q in found])
        mean = weight @ at
        variance = spread(told, at[-1], onset) + weight @ (at - mean) ** 2 + LEAST_VARIANCE / np.exp(mean[1])
        best = int(np.argmax(weight))
        power, decay = np.exp(at[best])
        law = {
            "decay": float(np.exp(mean[1])),
            "power": told.power(profile(len(effect.p) // 2, power, decay, ENDS[best] * decay, onset)),
        }
        std = np.sqrt(variance)
        stds = {"power_db": DB * float(std[0]), "decay_s": float(std[1]) * law["decay"] / scene.sample_rate_hz}
        return replace(effect, aux={**effect.aux, "_law": law, "_stds": stds})

    def holds(self, scene, effect, other):
        """An echo behind its row of taps, no stronger than the strongest of some decays of them by chance."""
        law, late = effect.aux.get("_law"), len(effect.p) / 2 - 1
        if other.family != ExtraPath.name or not law or "power" not in law or other.aux["source"] != effect.aux["source"]:
            return False
        behind, onset = other.p[2] - effect.aux["first"], effect.aux.get("_onset", 0)
        shape = np.exp(-np.arange(late + 1 - onset) / law["decay"])
        mean = law["power"] / shape.sum() * np.exp(-(behind - onset) / law["decay"])
        is_still = abs(other.p[3]) < STILL
        return bool(is_still and behind > late and np.sum(other.p[:2] ** 2) < mean * np.log(BY_CHANCE * law["decay"]))

    @staticmethod
    def _begin(effect) -> tuple[float, float]:
        """Power and decay of the law that an effect has."""
        taps = effect.prior[2 * effect.aux.get("_onset", 0) :: 2]
        fall = np.log(taps[0] / taps[-1]) if taps[-1] > 0 else FALLS
        return float(2 * taps.sum()), (len(taps) - 1) / max(fall, 1e-3)

    def values(self, scene, effect, p):
        law = effect.aux.get("_law", {})
        power = law.get("power", np.sum(p**2))
        decay = law.get("decay", len(p) / 2 / FALLS)
        return {"decay_s": decay / scene.sample_rate_hz, "power_db": 10 * np.log10(power + 1e-30)}

    def contradiction(self, parameters, model):
        return None if len(model.get("taps", [])) % 2 == 0 else "model.taps: needs pairs, Re and Im"

    def parse(self, scene, parameters, model):
        law = {"decay": parameters["decay_s"] * scene.sample_rate_hz}
        return start(
            self,
            model.get("taps", [0.0, 0.0]),
            aux={"source": model.get("source", 0), "first": model.get("first", 1.0), "_law": law},
        )

    def extrapolated(self, scene, effect):
        return None if effect.p.any() else f"{self.name}: its taps are not told (model.taps): taken as none"

    def model(self, scene, effect):
        return {"first": float(effect.aux["first"]), "taps": [float(v) for v in effect.p]}

    def delays(self, scene, effect):
        return (effect.aux["first"] + len(effect.p) / 2,)

    def where(self, scene, effect, values):
        first = (effect.aux["first"] + effect.aux.get("_onset", 0)) / scene.sample_rate_hz
        return {"delay_s": [first, first + 3 * values["decay_s"]]}

    def describe(self, number):
        return f"A diffuse tail that the twin leaves out: {number('power_db')} in all, falling by e in {number('decay_s')}."
