# SPDX-License-Identifier: GPL-3.0-or-later
"""Power amplifier: a memory polynomial x·(1 + Σ a_k·|x|^2k) + Σ_m x(n−m)·Σ b_mk·|x(n−m)|^2k, |x| relative
to the largest amplitude that was sent when it was found; where only what is bent is remembered (aux `bent_alone`), without b_m0.
An oscillator's leakage at the modulator goes through it.

Morgan et al., "A generalized memory polynomial model", IEEE TSP 2006, eq. 4. Internal: real and imaginary
parts.
"""

import itertools

import numpy as np
from scipy import fft as sp_fft

from ..columns import Lags
from ..interpolate import oversampled
from .base import PROBE, TX_PA, Effect, Family, Multiplicity, Role, db, start
from .front_end_filter import FrontEndFilter, filtered
from .recursive_filter import RecursiveFilter, ratio_of
from .values import NUMBER, NUMBERS, POSITIVE, TRUTH, WHOLES

HIGHEST = 16  # order of |x|² in a gain that a twin may tell
ORDERS = ((1,), (1, 2), (1, 2, 3), (1, 2, 3, 4))


FINER = 4  # an amplifier bends the signal between the samples too
# Share of a wave's energy at its faintest, and at its strongest, that tells nothing of an amplifier, for a keyed signal's ramps
# are seldom those that were asked for; and the ratio between what is left of its levels from which an amplifier is told.
RAMPS, LEVELS = 0.05, 10 ** (0.3 / 20)


def bent(x: np.ndarray, peak: float, orders) -> dict[int, np.ndarray]:
    """x·|x/peak|^2k for each order k (0: x itself), taken on a finer grid and limited to the band again."""
    fine = oversampled(sp_fft.fft(x), FINER)
    power = np.abs(fine / peak) ** 2
    size, half = len(x), (len(x) + 1) // 2
    terms = {0: x}
    for order in orders:
        wide = sp_fft.fft(fine * power**order) / FINER
        terms[order] = sp_fft.ifft(np.concatenate([wide[:half], wide[len(wide) - (size - half) :]]))
    return terms


def of_one_level(x: np.ndarray) -> bool:
    """Whether a wave is of one level but for its ramps, between its samples too: an amplifier turns and scales it, no more."""
    level = np.sort(np.abs(oversampled(sp_fft.fft(x), FINER)))
    energy = np.cumsum(level**2)
    low, high = level[np.searchsorted(energy, energy[-1] * np.array([RAMPS, 1 - RAMPS]))]
    return high <= LEVELS * low


def kept(scene, i: int, x: np.ndarray, leak: complex, peak: float, orders) -> dict[int, np.ndarray]:
    """`bent` of a source's wave and what leaks into it, kept for the wave that was asked for last."""
    held = scene.notes.get(("bent", i))
    if held is None or held[0] is not x or held[1:3] != (leak, peak) or not set(orders) <= set(held[3]):
        held = (x, leak, peak, bent(x + leak if leak else x, peak, orders))
        scene.notes["bent", i] = held
    return held[3]


def _around(reach: int) -> tuple[int, ...]:
    """Lags up to some samples either way."""
    return tuple(lag for lag in range(-reach, reach + 1) if lag)


def _forgetful(aux: dict) -> dict:
    """What is said of an amplifier without its memory."""
    return {k: v for k, v in aux.items() if k not in ("lags", "bent_alone")}


class PaNonlinearity(Family):
    name = "pa_nonlinearity"
    parameters = {"compression_db": NUMBER, "memory": TRUTH}
    remembered = {"orders": WHOLES, "lags": WHOLES, "bent_alone": TRUTH, "peak": POSITIVE, "coefficients": NUMBERS}
    telling = "compression_db"
    role = Role.AMPLIFIER
    owners = ("tx",)
    multiplicity = Multiplicity.ONE
    common = True
    stage = TX_PA
    linear = True

    def apply(self, chain, effect):
        i = effect.aux["source"]
        x = chain.waves[i]
        terms = kept(chain.scene, i, x, chain.leaks.get(i, 0.0), effect.aux["peak"], effect.aux["orders"])
        out = x
        for c, (order, lag) in zip(effect.p[::2] + 1j * effect.p[1::2], self._units(effect.aux), strict=True):
            if c:
                out = out + c * (np.roll(terms[order], lag) if lag else terms[order])
        chain.waves[i] = out

    def nest(self, scene, effect):
        aux = {**effect.aux, "orders": (1, 2, 3, 4), "lags": (-3, -2, -1, 1, 2, 3), "bent_alone": False}
        size, every, mine = self._shape(aux), self._units(aux), self._units(effect.aux)
        whole = Effect(family=self.name, p=np.zeros(size), free=np.ones(size, bool), aux=aux)
        at = np.array([every.index(m) for m in mine])
        return effect.aux["source"], whole, np.stack([2 * at, 2 * at + 1], 1).ravel()

    def columns(self, scene, effect, chain, before, rest):
        i, orders = effect.aux["source"], effect.aux["orders"]
        x = before.waves[i]
        terms = kept(scene, i, x, before.leaks.get(i, 0.0), effect.aux["peak"], orders)
        bends = orders if effect.aux.get("bent_alone") or not effect.aux.get("lags") else (0, *orders)
        units = [(rest(before.copy(), effect, extra=(i, PROBE * terms[o])).y - chain.y) / PROBE for o in bends]
        entries = tuple((bends.index(order), lag) for order, lag in self._units(effect.aux))
        return Lags(signals=np.array(units), entries=entries, paired=chain.facing, turn=chain.turn_per_sample(i))

    @staticmethod
    def _filtered(model, i: int, x: np.ndarray) -> np.ndarray:
        """A source's wave behind every filter that stands in front of its amplifier, or may."""
        for e in model.effects:
            if e.family == FrontEndFilter.name and e.aux.get("source", i) == i:
                x = filtered(x, e.aux["low"], FrontEndFilter().impulse_response(e, e.p))
            if e.family == RecursiveFilter.name and e.aux.get("source", i) == i:
                x = ratio_of(e, e.p).around(x)
        return x

    @staticmethod
    def _units(aux):
        """(order, lag) of every coefficient."""
        orders, remembered = aux["orders"], (0, *aux["orders"])[bool(aux.get("bent_alone")) :]
        return [(order, 0) for order in orders] + [(order, lag) for lag in aux.get("lags", ()) for order in remembered]

    def _shape(self, aux):
        return 2 * len(self._units(aux))

    def starts(self, view):
        for i, source in enumerate(view.scene.sources):
            x = self._filtered(view.fit.model, i, source.samples)
            held = view.scene.notes.get(("one level", i))
            if held is None or held[0] is not x:
                held = view.scene.notes["one level", i] = (x, of_one_level(x))
            if held[1]:
                continue
            for orders in ORDERS:
                aux = {"source": i, "peak": source.peak, "orders": orders}
                yield start(self, np.zeros(self._shape(aux)), aux=aux)
            for orders, lags in itertools.product(ORDERS[:2], ((1,), (1, 2))):
                aux = {"source": i, "peak": source.peak, "orders": orders, "lags": lags, "bent_alone": True}
                yield start(self, np.zeros(self._shape(aux)), aux=aux)
            for orders, lags in (
                ((1,), (1,)),
                ((1, 2), (1,)),
                ((1, 2), (1, 2)),
                ((1, 2, 3), (-1, 1, 2)),
                ((1, 2, 3, 4), (-3, -2, -1, 1, 2, 3)),
            ):
                aux = {"source": i, "peak": source.peak, "orders": orders, "lags": lags}
                yield start(self, np.zeros(self._shape(aux)), aux=aux)

    def forms(self, scene, effect):
        """Without memory, of every order, and with memory of what it bends alone."""
        for orders in ORDERS:
            aux = {**_forgetful(effect.aux), "orders": orders}
            if effect.aux.get("lags") or orders != effect.aux["orders"]:
                yield start(self, np.zeros(self._shape(aux)), aux=aux)
        if not effect.aux.get("lags"):
            return
        bent_alone = {**effect.aux, "bent_alone": True}
        # What is remembered of between the samples is heard in many of them on either side.
        between = ({**bent_alone, "orders": orders, "lags": _around(reach)} for orders in ORDERS[:2] for reach in (4, 8))
        for aux in (bent_alone, *between):
            if aux != effect.aux:
                yield start(self, np.zeros(self._shape(aux)), aux=aux)

    def less(self, scene, effect, others):
        """The amplifier without memory, and, where no filter is there for it, the same memory of a linear front end."""
        i, lags, alone = effect.aux["source"], effect.aux.get("lags", ()), len(scene.sources) == 1
        if not lags:
            return
        plain = _forgetful(effect.aux)
        yield start(self, np.zeros(self._shape(plain)), aux=plain)
        filters = [e.aux for e in others if e.family in (FrontEndFilter.name, RecursiveFilter.name)]
        if not any(alone or aux["side"] == "tx" and aux["source"] == i for aux in filters):
            low, high = min(0, *lags), max(0, *lags)
            aux = {"low": low, "high": high, "side": "tx", "source": i}
            yield start(FrontEndFilter(), np.zeros(2 * (high - low)), aux=aux)

    @staticmethod
    def _driven(scene, effect):
        """The wave at the amplifier's input, and what leaks into it: those that the latest prediction sent through it."""
        held = scene.notes.get(("bent", effect.aux["source"]))
        return (scene.sources[effect.aux["source"]].samples, 0.0) if held is None else held[:2]

    @staticmethod
    def _curve(p):
        """Gain at the largest amplitude over the small-signal gain (complex), where nothing stands in front."""
        return 1.0 + (p[::2] + 1j * p[1::2]).sum()

    def _met(self, scene, effect, p):
        """Gain of the strongest thousandth of the samples sent over that of the same wave where it is faint (complex): what an
        amplifier remembers at a peak is the signal around that peak."""
        i, orders, units = effect.aux["source"], effect.aux["orders"], self._units(effect.aux)
        x, leak = self._driven(scene, effect)
        key = ("met", i, effect.aux["peak"], *units)
        if key not in scene.notes or scene.notes[key][0] is not x or scene.notes[key][1] != leak:
            terms = kept(scene, i, x, leak, effect.aux["peak"], orders)
            driven = terms[0]
            level = np.abs(driven)
            sent = np.flatnonzero(level > 0)
            strongest = sent[np.argsort(level[sent])][-max(8, len(sent) // 1000) :]

            def shares(part):
                rows = np.array([terms[order][(part - lag) % len(x)] for order, lag in units])
                return rows @ np.conj(driven[part]) / np.vdot(driven[part], driven[part]).real

            linear = np.array([order == 0 for order, _ in units])
            scene.notes[key] = x, leak, (shares(sent) * linear, shares(strongest))
        small, large = (1.0 + share @ (p[::2] + 1j * p[1::2]) for share in scene.notes[key][2])
        return large / small

    def values(self, scene, effect, p):
        plain = not effect.aux.get("lags") and self._driven(scene, effect)[0] is scene.sources[effect.aux["source"]].samples
        return {"compression_db": -db(self._curve(p) if plain else self._met(scene, effect, p))}

    def extrapolated(self, scene, effect):
        sent, measured = scene.sources[effect.aux["source"]].peak, effect.aux["peak"]
        if sent <= 1.01 * measured:
            return None
        name = scene.transmitters[effect.aux["source"]]
        return f"{name}: amplifier driven to {sent:.3g}, measured up to {measured:.3g}: extrapolated"

    def constants(self, scene, effect):
        return {"memory": bool(effect.aux.get("lags"))}

    def contradiction(self, parameters, model):
        orders, lags = model.get("orders", (1,)), model.get("lags", ())
        shape = {"orders": orders, "lags": lags, "bent_alone": model.get("bent_alone", False)}
        if "coefficients" not in model:
            bends = "compression_db" in parameters and "orders" not in model and not lags
            return None if bends else "needs compression_db alone, or model.coefficients"
        needs, got = self._shape(shape), len(model["coefficients"])
        if not 1 <= min(orders, default=0) <= max(orders, default=0) <= HIGHEST or got != needs:
            return (
                f"model.coefficients: got {got}, needs {needs} for its {len(orders)} orders, 1 to {HIGHEST}, and {len(lags)} lags"
            )
        return None

    def parse(self, scene, parameters, model):
        aux = {
            "source": model.get("source", 0),
            "peak": model.get("peak", scene.sources[model.get("source", 0)].peak),
            "orders": tuple(model.get("orders", (1,))),
            "lags": tuple(model.get("lags", ())),
            "bent_alone": bool(model.get("bent_alone", False)),
        }
        if "coefficients" in model:
            return start(self, model["coefficients"], aux=aux)
        bend = 10 ** (-parameters.get("compression_db", 0.0) / 20) - 1
        return start(self, [bend, 0.0], aux=aux)

    def model(self, scene, effect):
        return {
            "orders": list(effect.aux["orders"]),
            "lags": list(effect.aux.get("lags", ())),
            "bent_alone": bool(effect.aux.get("bent_alone", False)),
            "peak": effect.aux["peak"],
            "coefficients": [float(v) for v in effect.p],
        }

    def describe(self, number):
        memory = " and it remembers earlier samples" if number.constants.get("memory") else ""
        levels = number("compression_db").split(" to ")  # one, or the least and the most of several recordings
        expands = all(level.startswith("-") for level in levels)
        told = " to ".join(level.removeprefix("-") if expands else level for level in levels)
        return (
            "The power amplifier is not linear: its gain at the largest amplitude is "
            f"{told} {'above' if expands else 'below'} small signal{memory}."
        )
