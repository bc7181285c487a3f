# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase noise: y·exp(jφ(t)), φ on a cosine basis (offset and mean frequency left to others). Internal:
coefficients in rad.

A twin holds its law. Free wandering, Var φ(t) = 2π·linewidth·t, has coefficients of variance 2π·linewidth·T/(πk)² on T
seconds (Karhunen-Loève expansion of a Wiener process), flicker of the frequency of density 1/f³ ones that fall as 1/k³; a held
oscillator wanders evenly up to a highest frequency, or with the density 1/(1 + (f/corner)²) of a loop of first order.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.optimize import minimize_scalar

from ..basis import SAMPLES_EACH, course_length, course_on, course_orders, grid_of, spread
from ..columns import Courses
from ..interpolate import phasor
from .base import RX_LO, TX_LO, Family, Multiplicity, Role, of_sender, side_of, start
from .values import POSITIVE, SIDE, Value, one_of

MOST = 480  # cosines: the fastest wander that a search follows
FINEST = 3 * MOST  # cosines: the fastest that is followed
FEWEST_SAMPLES = 12  # of a recording for each of them
FEW = 96  # cosines that a shorter recording has room for: what it cannot follow is too little to be told from noise
NEARLY_ALL = 0.05  # of a recording, that its ends may lack: the course of the rest is that of the whole
STEEP = {"free": 2, "flicker": 3}  # laws of density 1/f^s: white frequency noise, flicker of the frequency (Leeson 1966)
LEAST_LAW = 24  # cosines that a law is told by
KNOWN_BY_LAW = 0.99  # share of its variance that a cosine of which nothing is heard keeps
LEAST_HEARD = 1e-6  # share of a law's variance: a moment is known no better, and has as much weight where nothing is known
ONE_WALK = 0.3  # by which the rms of a walk without its mean and slope differs from that of all walks, a share


def orders(scene) -> tuple[int, ...]:
    """Numbers of cosines worth trying; in a recording too short for the most of them, as many as it holds."""
    sizes, longest = course_orders(scene, MOST), min(MOST, scene.count // SAMPLES_EACH)
    return (*sizes, longest) if sizes[-1] == FEW and longest >= 2 * FEW else sizes


def shape_of(law: dict, size: int) -> np.ndarray:
    """(size,) relative variance of each cosine under a law."""
    k = np.arange(1, size + 1)
    if law["law"] == "held":
        return 1.0 / (1.0 + (k / law["corner"]) ** 2)
    return 1.0 / k ** STEEP[law["law"]] if law["law"] in STEEP else np.ones(size)


def _missing(scene) -> float:
    """Share of the recording that a scene does not hold; 0 where that is next to nothing."""
    share = 1 - scene.span / scene.whole
    return share if share > NEARLY_ALL else 0.0


def _sided(effect) -> dict:
    """What an effect knows of the side that it is on."""
    return {key: effect.aux[key] for key in ("side", "source") if key in effect.aux}


def mean_square(scene, p, heard=None) -> float:
    """Of the course without its mean and slope, on a grid finer than its fastest cosine; `heard` (grid,): weights."""
    grid, length = grid_of(p), course_length(scene.span)
    u = np.arange(len(grid)) / (len(grid) - 1) * length / scene.span
    weights = np.ones(len(grid)) if heard is None else heard
    u, phase, weights = u[u <= 1], grid[u <= 1], weights[u <= 1]
    left = phase - np.polyval(np.polyfit(u, phase, 1, w=np.sqrt(weights)), u)
    return float(np.average(left**2, weights=weights))


class PhaseNoise(Family):
    name = "phase_noise"
    parameters = {"rms_rad": Value(low=0.0), "linewidth_hz": Value(low=0.0)}
    remembered = {
        "law": one_of("free", "flicker", "held", "flat"),
        "highest_hz": Value(low=0.0),
        "corner_hz": POSITIVE,
        "linewidth_hz": Value(low=0.0),
        "at": SIDE,
    }
    role = Role.WANDER
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE
    lasting = False
    stage = RX_LO
    flexible = True
    linear = True
    random = True
    wanders = ("phase",)
    least_error = {"rms_rad": 0.1}
    either_side = True
    follows_carrier = {"linewidth_hz": 2, "rms_rad": 1}

    def at(self, effect):
        return TX_LO if effect.aux.get("side") == "tx" else RX_LO

    def mirrored(self, effect):
        return effect.moved(-effect.p)

    def course(self, scene, effect, p):
        return scene.course(p)

    def apply(self, chain, effect):
        if effect.aux.get("side") == "tx":
            scene = chain.scene
            chain.modulate(effect.aux["source"], lru_cache(lambda late: phasor(scene.course(effect.p, late))))
        else:
            chain.y = chain.y * phasor(self.course(chain.scene, effect, effect.p))
            chain.wanted = chain.y

    def nest(self, scene, effect):
        size = orders(scene)[-1]
        return (
            "course",
            replace(effect, p=np.zeros(size), free=np.ones(size, bool), prior=None),
            np.arange(len(effect.p)),
        )

    def columns(self, scene, effect, chain, before, rest):
        turned = of_sender(effect, chain, before, rest) if effect.aux.get("side") == "tx" else chain.wanted
        return Courses(signals=1j * chain.facing * turned[None], orders=len(effect.p), scene=scene)

    def starts(self, view):
        for size in orders(view.scene):
            laws = [{"law": "flat"}, {"law": "held", "corner": size / 8}]
            for law in [{"law": "free"}, *laws] if size < 200 else laws:
                yield start(self, np.zeros(size), prior=shape_of(law, size), trials=12, aux=law)

    def _wider(self, effect, size: int, law: dict):
        """The effect followed to `size` cosines under another law, with the power that it has."""
        prior, have = shape_of(law, size), len(effect.p)
        prior *= effect.prior.sum() / prior[:have].sum()
        p = np.concatenate([effect.p, np.zeros(size - have)])
        return replace(effect, p=p, prior=prior, free=np.ones(size, bool), aux=law | _sided(effect))

    def finer(self, scene, effect):
        """To faster wander, which on the wrong side could not be followed."""
        sizes = [size for size in orders(scene) if size > len(effect.p)]
        return [self._wider(effect, size, {"law": "held", "corner": size / 8}) for size in sizes]

    def finest(self, scene, effect):
        """As fast as the search follows, faster still under laws that reach so far."""
        most = min(FINEST, scene.count // FEWEST_SAMPLES)
        if len(effect.p) > FEW and len(effect.p) == orders(scene)[-1] and most > 1.5 * len(effect.p):
            for law in ({"law": "flat"}, {"law": "held", "corner": most / 8}):
                yield self._wider(effect, most, law)

    def other_laws(self, scene, effect, covariance):
        """The same course under the law that its cosines make likeliest, where that is another: a search takes the first that
        follows it. A cosine is as large as the law's variance and the noise in its estimate, without the law, let it be."""
        size, prior = len(effect.p), effect.prior
        if prior is None or size < LEAST_LAW:
            return
        doubt = 1 / (1 / np.minimum(np.diag(covariance), KNOWN_BY_LAW * prior) - 1 / prior)
        power = (effect.p * (1 + doubt / prior)) ** 2

        def priced(law):
            shape = shape_of(law, size)

            def cost(nepers):
                variance = np.exp(nepers) * shape + doubt
                return float(np.sum(np.log(variance) + power / variance)) / 2

            about = np.log(prior.sum() / shape.sum())
            best = minimize_scalar(cost, bounds=(about - 5, about + 5), method="bounded")
            return best.fun, np.exp(best.x) * shape, law

        laws = [*({"law": name} for name in STEEP), {"law": "flat"}]
        laws += [{"law": "held", "corner": size / octaves} for octaves in (8, 16, 32, 64)]
        own = {key: effect.aux[key] for key in ("law", "corner") if key in effect.aux}
        fewest, prior, law = min(map(priced, laws), key=lambda one: one[0])
        if fewest < priced(own)[0] - 1.0:
            yield replace(effect, prior=prior, aux=law | _sided(effect))

    def settled_law(self, scene, effect, covariance):
        """With what is known of the course where a signal tells it: between pulses it is as large as its law has it."""
        effect = super().settled_law(scene, effect, covariance)
        if "_variance" not in effect.aux:
            return effect
        constant, course = spread(covariance)
        at = np.linspace(0.0, 1.0, len(grid_of(effect.p)))
        law = effect.prior.sum()
        doubt = np.clip(constant + course_on(grid_of(course), at), LEAST_HEARD * law, law)
        heard = law / doubt - 1 + LEAST_HEARD
        return replace(effect, aux={**effect.aux, "_heard": heard, "_doubt": float(np.average(doubt, weights=heard))})

    def values(self, scene, effect, p):
        unseen = float(effect.aux.get("_doubt", np.sum(effect.aux.get("_variance", [0.0]))))  # of the course around its estimate
        if "_jitter" in effect.aux:
            unseen += effect.aux["_jitter"]
        elif effect.aux.get("law") == "held" and effect.prior is not None:
            unseen += self.unfollowed(effect)
        rms_rad = float(np.sqrt(mean_square(scene, p, effect.aux.get("_heard")) + unseen))
        if effect.aux.get("law", "free") != "free" or effect.prior is None:
            return {"rms_rad": rms_rad}
        linewidth_hz = np.pi / 2 / scene.duration_s * float(effect.prior[0])
        if _missing(scene):  # of a part of a recording: what is expected of a walk without its mean and slope
            rms_rad = float(np.sqrt(2 * np.pi * linewidth_hz * scene.whole / scene.sample_rate_hz / 15))
        return {"rms_rad": rms_rad, "linewidth_hz": linewidth_hz}

    def spread(self, scene, effect, sigma2, power):
        """A law is known as well as a variance is by as many numbers as stand out of noise (χ²), the power of the whole by its
        part as one walk is, or, of another law, hardly."""
        told = self.values(scene, effect, effect.p)
        if "linewidth_hz" not in told:
            return {"rms_rad": told["rms_rad"] * float(np.sqrt(_missing(scene)))}
        left_open = np.asarray(effect.aux.get("_variance", 0.0)) / np.maximum(effect.prior, 1e-300)  # all of what is noise
        clear = np.sum(np.clip(1 - left_open, 0.0, 1.0) ** 2 * np.ones(len(effect.prior)))
        share = float(np.sqrt(2 / max(clear, 1.0)))
        walked = np.hypot(share / 2, ONE_WALK) if _missing(scene) else 0.0
        return {"linewidth_hz": told["linewidth_hz"] * share, "rms_rad": told["rms_rad"] * float(walked)}

    def contradiction(self, parameters, model):
        law = model.get("law", "free")
        if law == "held" and "corner_hz" not in model:
            return "the law held needs model.corner_hz"
        if "rms_rad" not in parameters and (law != "free" or "linewidth_hz" not in {**model, **parameters}):
            return "needs rms_rad, or linewidth_hz where it wanders freely"
        return None

    def parse(self, scene, parameters, model):
        highest = model.get("highest_hz", course_orders(scene)[-1] / 2 / scene.duration_s)
        k = np.arange(1, 1 + max(1, round(2 * highest * scene.duration_s)))
        law = {"law": model.get("law", "free")}
        if law["law"] == "held":
            law["corner"] = 2 * model["corner_hz"] * scene.duration_s
        if law["law"] != "free":
            shape = shape_of(law, len(k))
            prior = parameters["rms_rad"] ** 2 * shape / shape.sum()
        elif "linewidth_hz" in (told := {**model, **parameters}):
            prior = 2 * told["linewidth_hz"] * scene.duration_s / np.pi / k**2
        else:
            prior = parameters.get("rms_rad", 0.0) ** 2 / k**2 / np.sum(1.0 / k**2)
        return start(self, np.zeros(len(k)), prior=prior, aux=law | side_of(model))

    def model(self, scene, effect):
        law = {"law": effect.aux.get("law", "free"), "highest_hz": len(effect.p) / 2 / scene.duration_s}
        law["at"] = effect.aux.get("side", "rx")
        if law["law"] == "held":
            return law | {"corner_hz": effect.aux["corner"] / 2 / scene.duration_s}
        return law

    def unfollowed(self, effect):
        most, first = len(effect.prior), effect.prior[0]
        if effect.aux["law"] == "held":
            corner = effect.aux["corner"]
            return first * (1 + corner**-2) * corner * (np.pi / 2 - np.arctan(most / corner))
        steep = STEEP.get(effect.aux["law"])
        return first * (most + 0.5) ** (1 - steep) / (steep - 1) if steep else 0.0  # Σ 1/k^s beyond the last cosine

    def played(self, scene, effect, rng):
        return effect.moved(rng.normal(size=len(effect.p)) * np.sqrt(effect.prior))

    def describe(self, number):
        return f"The oscillator's phase wanders: {number('rms_rad')} rms after offset and mean are taken out."
