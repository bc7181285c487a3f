# SPDX-License-Identifier: GPL-3.0-or-later
"""Roll-off, ripple and group delay of a front end: a short complex FIR on the received signal, its main tap
1.

Internal: real and imaginary parts of the taps from aux low to aux high, the main tap left out.
"""

from dataclasses import replace

import numpy as np

from ..columns import Lags
from .ac_coupling import AcCoupling
from .base import RX_FILTER, TX_FILTER, Effect, Family, Multiplicity, Role, of_sender, start
from .recursive_filter import RecursiveFilter

SIZES = (
    (0, 1),
    (-1, 0),
    (-1, 1),
    (0, 2),
    (-2, 2),
    (0, 4),
    (-4, 4),
    (0, 8),
    (-8, 8),
    (-4, 16),
    (-16, 16),
    (-10, 25),
)


FEW = 30_000  # samples, of all transmitters together, in which every length is tried again once the rest is known


def filtered(wave: np.ndarray, low: int, taps: np.ndarray) -> np.ndarray:
    """A transmitter's wave, which goes round, behind taps at the lags from `low` on."""
    return sum(tap * np.roll(wave, low + k) for k, tap in enumerate(taps) if tap)


class FrontEndFilter(Family):
    name = "front_end_filter"
    parameters = AcCoupling.parameters
    remembered = AcCoupling.remembered | RecursiveFilter.remembered
    role = Role.FILTER
    owners = ("rx", "tx")
    multiplicity = Multiplicity.ONE
    common = True
    two_sided = True
    stage = RX_FILTER
    linear = True
    row_of_taps = True
    telling = "ripple_db"

    def impulse_response(self, effect, p):
        low, high = effect.aux["low"], effect.aux["high"]
        taps = np.zeros(high - low + 1, complex)
        taps[np.arange(low, high + 1) != 0] = p[::2] + 1j * p[1::2]
        taps[-low] = 1.0
        return taps

    def at(self, effect):
        return TX_FILTER if effect.aux.get("side") == "tx" else RX_FILTER

    def apply(self, chain, effect):
        if effect.aux.get("side") == "tx":
            i = effect.aux["source"]
            chain.waves[i] = filtered(chain.waves[i], effect.aux["low"], self.impulse_response(effect, effect.p))
            return
        taps, low = self.impulse_response(effect, effect.p), effect.aux["low"]
        if effect.p.any():  # else as it is where a search begins
            chain.y = np.convolve(chain.y, taps)[-low : -low + chain.scene.count]
        chain.wanted = chain.y

    def nest(self, scene, effect):
        low, high = -16, min(25, max(scene.count // 24, scene.count // 12 - 17))
        lags = np.delete(np.arange(low, high + 1), -low)
        size = 2 * len(lags)
        whole = Effect(
            family=self.name,
            p=np.zeros(size),
            free=np.ones(size, bool),
            aux={**effect.aux, "low": low, "high": high},
        )
        mine = np.isin(lags, np.delete(np.arange(effect.aux["low"], effect.aux["high"] + 1), -effect.aux["low"]))
        return effect.aux.get("side"), whole, np.flatnonzero(np.repeat(mine, 2))

    def columns(self, scene, effect, chain, before, rest):
        lags = np.delete(np.arange(effect.aux["low"], effect.aux["high"] + 1), -effect.aux["low"])
        if effect.aux.get("side") == "tx":
            steady, turn = of_sender(effect, chain, before, rest), chain.turn_per_sample(effect.aux["source"])
        else:
            steady, turn = before.y if chain.facing == before.facing else np.conj(before.y), 0.0
        return Lags(signals=steady[None], entries=tuple((0, int(lag)) for lag in lags), paired=chain.facing, turn=turn)

    def starts(self, view):
        for low, high in SIZES:
            if (low < -10 or high > 26) and not all(s.known.all() for s in view.scene.sources):
                continue
            if low < -16 or max(-low, high) > view.scene.count // 24:
                continue
            lags = np.delete(np.arange(low, high + 1), -low)
            # Far taps are expected to be smaller; the strength is chosen by evidence.
            prior = np.repeat(1.0 / (1.0 + np.abs(lags)) ** 1.5, 2) if high - low > 4 else None
            sides = [{"side": "rx"}]
            if len(view.scene.sources) == 1:
                sides.append({"side": "tx", "source": 0})
            for side in sides:
                aux = {"low": low, "high": high, **side}
                yield start(self, np.zeros(2 * len(lags)), aux=aux, prior=prior, trials=len(SIZES))

    def apart(self, scene, effect):
        """The effects that may stand in its place where several transmitters are heard: a filter of each one's own."""
        if len(scene.sources) == 1 or effect.aux["side"] == "tx":
            return ()
        return tuple(replace(effect, aux={**effect.aux, "side": "tx", "source": i}) for i in range(len(scene.sources)))

    def forms(self, scene, effect):
        """Of other lengths, and on the other side of the channel where one transmitter alone is heard."""
        here = {k: v for k, v in effect.aux.items() if k not in ("low", "high")}
        there = {"side": "rx"} if effect.aux.get("side") == "tx" else {"side": "tx", "source": 0}
        mine = effect.aux["low"], effect.aux["high"]
        sides = (here, there) if len(scene.sources) == 1 else (here,)
        if there in sides:
            yield start(self, np.zeros(len(effect.p)), aux={**effect.aux, **there}, prior=effect.prior, trials=effect.trials)
        for low, high in SIZES if scene.count * len(scene.sources) < FEW else (mine,):
            for side in sides:
                if -10 <= low and high - low > 2 and ((low, high) != mine or effect.prior is not None or side is there):
                    p = np.zeros(2 * (high - low))
                    yield start(self, p, aux={**side, "low": low, "high": high}, trials=effect.trials)

    def values(self, scene, effect, p):
        response = np.abs(np.fft.fft(self.impulse_response(effect, p), 512))
        inside = response[scene.occupied]
        return {"ripple_db": 20 * np.log10(inside.max() / max(inside.min(), 1e-6))}

    def contradiction(self, parameters, model):
        if "feedback" in model:
            return RecursiveFilter().contradiction(parameters, model)
        low, taps = model.get("low", 0), model.get("taps", [])
        if len(taps) % 2 or not low <= 0 <= low + len(taps) // 2:
            return "model.taps: needs Re and Im of each sample from low on but the one at 0"
        return None

    def parse(self, scene, parameters, model):
        if "feedback" in model:
            return RecursiveFilter().parse(scene, parameters, model)
        if "corner_hz" in model:
            return AcCoupling().parse(scene, parameters, model)
        taps = model.get("taps", [])
        low = int(model.get("low", 0))
        aux = {"low": low, "high": low + len(taps) // 2, "side": model.get("side", "rx"), "source": model.get("source", 0)}
        return start(self, taps, aux=aux)

    def extrapolated(self, scene, effect):
        return None if len(effect.p) else f"{self.name}: its response is not told (model.taps): taken as flat"

    def model(self, scene, effect):
        return {
            "side": effect.aux.get("side", "rx"),
            "low": effect.aux["low"],
            "taps": [float(v) for v in effect.p],
        }

    def describe(self, number):
        return (
            f"The front end filters the signal: {number('ripple_db')} between the strongest and the weakest of the occupied band."
        )
