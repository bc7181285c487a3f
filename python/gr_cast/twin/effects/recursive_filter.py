# SPDX-License-Identifier: GPL-3.0-or-later
"""A front end's filter that rings (Butterworth, elliptic, a notch): B(z)/A(z), of which a row of taps would have to be as long as
its memory. Told as a filter.

Internal: Re and Im of the taps of B from aux low on, the main one, which stands still beside the gain, left
out; of the coefficients of A behind its leading 1; and of what rings on from before the first sample, over the wanted rms.
"""

from dataclasses import replace

import numpy as np
from scipy import signal as sp_signal

from ..columns import Lags
from ..rational import FIRST, ORDERS, Ratio, monic, read_off, stable
from .ac_coupling import AcCoupling
from .base import PROBE, RX_FILTER, TX_FILTER, Family, Multiplicity, rms_of, start
from .values import NUMBERS, SIDE, Value

BINS = 512  # of the band, in whose middles its response is told
UNHEARD = 0.03  # that is left, of what rings, where the recording begins to count
HIDDEN = 24  # samples before that
NO_DC = 0.1  # of its strongest tap, that a filter's gain at DC is less than which takes DC away: a receiver does


class RecursiveFilter(Family):
    name = "recursive_filter"
    told_as = "front_end_filter"
    parameters = AcCoupling.parameters
    remembered = {
        "side": SIDE,
        "low": Value(whole=True, low=-4096, high=4096),
        "main": Value(whole=True, low=-4096, high=4096),
        "taps": NUMBERS,
        "feedback": NUMBERS,
    }
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE
    common = True
    two_sided = True
    relative = True
    stage = RX_FILTER
    row_of_taps = True
    telling = "ripple_db"

    def at(self, effect):
        return TX_FILTER if effect.aux.get("side") == "tx" else RX_FILTER

    def excludes(self, effect, other):
        return other.family != self.name and other.family in (AcCoupling.name, self.told_as)

    def impulse_response(self, effect, p):
        ratio = ratio_of(effect, p)
        return sp_signal.lfilter(ratio.taps, ratio.feedback, np.eye(1, BINS)[0])

    def apply(self, chain, effect):
        ratio = ratio_of(effect, effect.p)
        if effect.aux.get("side") == "tx":
            i = effect.aux["source"]
            chain.waves[i] = ratio.around(chain.waves[i])
            return
        chain.y = ratio.behind(chain.y) + _ringing(ratio, chain.scene, effect)
        chain.wanted = chain.y

    def columns(self, scene, effect, chain, before, rest):
        ratio = ratio_of(effect, effect.p)
        plain = replace(ratio, low=0, taps=np.ones(1))
        turn = 0.0
        if effect.aux.get("side") == "tx":
            i, sent = effect.aux["source"], before.waves[effect.aux["source"]]
            turn = chain.turn_per_sample(i)
            waves = plain.around(sent), plain.around(ratio.around(sent))
            units = [(rest(before.copy(), effect, extra=(i, PROBE * wave)).y - chain.y) / PROBE for wave in waves]
        else:
            units = [plain.behind(before.y), plain.behind(ratio.behind(before.y) + _ringing(ratio, scene, effect))]
        left = ratio.ringing(np.array([rms_of(scene, effect)]), scene.count)
        units = np.array([units[0], -units[1], left])
        order = effect.aux["order"]
        entries = [
            *((0, int(lag)) for lag in _lags(effect)),
            *((1, k + 1) for k in range(order)),
            *((2, k) for k in range(order)),
        ]
        return Lags(
            signals=units if chain.facing == before.facing else np.conj(units),
            entries=tuple(entry for entry, free in zip(entries, effect.free[::2], strict=True) if free),
            paired=chain.facing,
            turn=turn,
        )

    def starts(self, view):
        scene = view.scene
        if scene.at is not None or not all(s.known.all() for s in scene.sources):
            return
        for ratio in read_off(view.wanted, view.residual, view.weight > 0):
            order, main = len(ratio.feedback) - 1, int(np.argmax(np.abs(ratio.taps)))
            of_sender = len(scene.sources) == 1 and abs(ratio.response(np.zeros(1))[0]) > NO_DC * abs(ratio.taps[main])
            for side in ({"side": "rx"}, {"side": "tx", "source": 0})[: 1 + of_sender]:
                aux = {
                    "low": ratio.low,
                    "high": ratio.low + len(ratio.taps) - 1,
                    "main": ratio.low + main,
                    "order": order,
                    "_main": complex(ratio.taps[main]),
                    **side,
                }
                numbers = np.concatenate([np.delete(ratio.taps, main), ratio.feedback[1:], np.zeros(order)])
                free = np.ones(len(numbers), bool)
                free[-order:] = side["side"] == "rx" and ratio.slowest**HIDDEN > UNHEARD
                yield start(self, numbers.view(float), free=np.repeat(free, 2), aux=aux, trials=len(ORDERS) * (1 - FIRST))

    def apart(self, scene, effect):
        """The effects that may stand in its place where several transmitters are heard: a filter of each one's own."""
        if len(scene.sources) == 1 or effect.aux["side"] == "tx":
            return ()
        free = effect.free & (np.arange(len(effect.p)) < len(effect.p) - 2 * effect.aux["order"])
        return tuple(
            replace(effect, p=effect.p * free, free=free, aux={**effect.aux, "side": "tx", "source": i})
            for i in range(len(scene.sources))
        )

    def in_time(self, scene, effect, later, longer):
        """What rings on from before the first sample is there alone."""
        return effect.moved(np.concatenate([effect.p[: -2 * effect.aux["order"]], np.zeros(2 * effect.aux["order"])]))

    def values(self, scene, effect, p):
        ratio = ratio_of(effect, p)
        inside = np.abs(ratio.response((np.arange(BINS) + 0.5) / BINS))[scene.occupied]
        return {"ripple_db": 20 * np.log10(inside.max() / max(inside.min(), 1e-6))}

    def contradiction(self, parameters, model):
        low, main, taps, feedback = (model.get(name) for name in ("low", "main", "taps", "feedback"))
        missing = low is None or main is None or taps is None
        if missing or len(taps) % 2 or not low <= min(main, 0) <= main < low + len(taps) // 2:
            return "model.taps: needs low, main, and Re and Im of each sample from low on, that at main included"
        if len(feedback) % 2 or not len(feedback) or np.abs(np.roots(monic(feedback))).max() >= 1:
            return "model.feedback: needs Re and Im of each coefficient behind the first, of a filter that is stable"
        return None

    def parse(self, scene, parameters, model):
        order, low, main = len(model["feedback"]) // 2, int(model["low"]), int(model["main"])
        taps = np.asarray(model["taps"], float).view(complex)
        aux = {"low": low, "high": low + len(taps) - 1, "main": main, "order": order, "_main": complex(taps[main - low])}
        aux |= {"side": model.get("side", "rx"), "source": model.get("source", 0)}
        numbers = np.concatenate(
            [np.delete(taps, main - low), np.asarray(model["feedback"], float).view(complex), np.zeros(order)]
        )
        return start(self, numbers.view(float), aux=aux)

    def model(self, scene, effect):
        ratio = ratio_of(effect, effect.p)
        return {
            "side": effect.aux.get("side", "rx"),
            "low": ratio.low,
            "main": effect.aux["main"],
            "taps": ratio.taps.view(float).tolist(),
            "feedback": ratio.feedback[1:].view(float).tolist(),
        }

    def describe(self, number):
        between = f"{number('ripple_db')} between the strongest and the weakest of the occupied band"
        return f"The front end filters the signal, and rings: {between}."


def ratio_of(effect, p) -> Ratio:
    """That of an effect with the numbers `p`."""
    order, low = effect.aux["order"], effect.aux["low"]
    taps = np.insert(np.asarray(p[: -4 * order], float).view(complex), effect.aux["main"] - low, effect.aux["_main"])
    return Ratio(low=low, taps=taps, feedback=stable(monic(p[-4 * order : -2 * order])))


def _lags(effect) -> np.ndarray:
    lags = np.arange(effect.aux["low"], effect.aux["high"] + 1)
    return lags[lags != effect.aux["main"]]


def _ringing(ratio: Ratio, scene, effect) -> np.ndarray:
    """(n,) what rings on from before the first sample."""
    left = effect.p[-2 * effect.aux["order"] :].view(complex)
    return ratio.ringing(left * rms_of(scene, effect), scene.count) if left.any() else np.zeros(scene.count)
