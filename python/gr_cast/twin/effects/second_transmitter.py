# SPDX-License-Identifier: GPL-3.0-or-later
"""Another transmitter with a known code. Internal: Re a, Im a over the taps' scale, delay in samples, carrier in cycles;
where it has echoes of its own, Re and Im of taps at whole samples (aux lags) from that delay."""

import numpy as np

from ..columns import Dense
from ..interpolate import TAU, frequencies, phasor, turning
from ..scene import BINS
from .base import ENVIRONMENT, PROBE, Family, Multiplicity, amid, complex_pair, db, start, turned
from .values import NEEDED, NUMBER, NUMBERS, WHOLES, Value

ECHOES = tuple(lag for lag in range(-4, 13) if lag)


class SecondTransmitter(Family):
    name = "second_transmitter"
    sizes = (0, 1)
    parameters = {"code": Value(kind=str, needed=True), "gain_db": NEEDED, "delay_s": NEEDED}
    remembered = {"phase_rad": NUMBER, "offset_hz": NUMBER, "main": Value(low=0.0), "lags": WHOLES, "echoes": NUMBERS}
    owners = ("environment",)
    multiplicity = Multiplicity.MANY
    place = 2
    follows_carrier = {"offset_hz": 1}
    stage = ENVIRONMENT

    def apply(self, chain, effect):
        source = chain.scene.extra[effect.aux["code"]]
        re, im, delay, doppler = effect.p[:4]
        if chain.slips(chain.clock):
            signal = chain.copy_of(source, source.samples, delay + chain.delay, chain.clock)
        else:
            spectrum = chain.scene.spectrum_of(effect.aux["code"])
            shifted = spectrum * phasor(-TAU * frequencies(len(spectrum)) * (delay + chain.delay))
            signal = chain.sample(source, shifted, chain.clock)
        if lags := effect.aux.get("lags"):
            signal = np.convolve(signal, self._taps(effect))[-min(lags) :][: chain.scene.count]
        else:
            signal = complex(re, im) * signal
        if doppler:
            signal = signal * turning(doppler, chain.u) * np.exp(-1j * np.pi * doppler)
        chain.y = chain.y + signal

    @staticmethod
    def _taps(effect):
        lags = effect.aux["lags"]
        taps = np.zeros(max(lags) - min(lags) + 1, complex)
        taps[-min(lags)] = complex_pair(effect.p)
        taps[np.array(lags) - min(lags)] = effect.p[4::2] + 1j * effect.p[5::2]
        return taps

    def columns(self, scene, effect, chain, before, rest):
        def moved(k):
            p = effect.p.copy()
            p[k] += PROBE
            return (rest(before.copy(), effect.moved(p)).y - chain.y) / PROBE

        rows = [moved(k) for k in np.flatnonzero(effect.free[:4])]
        for lag in effect.aux.get("lags", ()):
            for unit in rows[:2]:
                row = np.zeros_like(unit)
                row[max(lag, 0) : len(row) + min(lag, 0)] = unit[max(-lag, 0) : len(row) - max(lag, 0)]
                rows.append(row)
        return Dense(signals=np.array(rows))

    def starts(self, view):
        for code in view.scene.extra:
            for delay, doppler, places, trials in view.echoes(code, count=1):
                yield start(self, [0, 0, delay, 0.0], free=[1, 1, 1, 0], aux={"code": code}, trials=places)
                if abs(doppler) > 0.3:
                    yield start(self, [0, 0, delay, doppler], aux={"code": code}, trials=trials)
                if not view.scene.extra[code].repeat:  # of a repeated code, echoes could be those of any other
                    many = 2 * len(ECHOES)
                    for turn in {0.0, doppler if abs(doppler) > 0.3 else 0.0}:
                        yield start(
                            self,
                            [0, 0, delay, turn, *[0.0] * many],
                            free=[1, 1, 0, 1, *[1] * many],
                            aux={"code": code, "lags": ECHOES},
                            prior=[1.0, 1.0, 1.0, 100.0, *np.repeat(1.0 / (1.0 + np.abs(ECHOES)) ** 1.5, 2)],
                            trials=trials if turn else places,
                        )

    def settled(self, scene, effect):
        return effect.free if "lags" in effect.aux else np.ones(len(effect.p), bool)

    def mirrored(self, effect):
        return effect.moved(effect.p * [1.0, -1.0, 1.0, -1.0, *[1.0, -1.0] * (len(effect.p) // 2 - 2)])

    def in_time(self, scene, effect, later, longer):
        moved = _all_turned(effect.p, effect.p[3] * amid(later, longer))
        moved[3] *= longer
        return effect.moved(moved)

    def values(self, scene, effect, p):
        gain_db = db(complex_pair(p))
        if "lags" in effect.aux:  # of all its echoes, as they are heard beside the wanted signal
            response = np.abs(np.fft.fft(self._taps(effect.moved(p)), BINS)) ** 2
            heard = np.abs(np.fft.fft(scene.front_end, BINS)) ** 2
            own, wanted = scene.density(effect.aux["code"]), scene.density(0)
            gain_db = 10 * np.log10(max((own * response * heard).sum() / (wanted * heard).sum(), 1e-24))
        return {"gain_db": gain_db, "delay_s": p[2] / scene.sample_rate_hz}

    def delays(self, scene, effect):
        return (effect.p[2],)

    def resolution(self, scene, name, value):
        return 0.0 if name == "delay_s" else super().resolution(scene, name, value)

    def constants(self, scene, effect):
        return {"code": effect.aux["code"]}

    def contradiction(self, parameters, model):
        lags, echoes = model.get("lags", ()), model.get("echoes", ())
        if lags and not min(lags) < 0 < max(lags):
            return "model.lags: needs samples before and after 0"
        return None if len(echoes) == 2 * len(lags) else "model.echoes: needs Re and Im for each of model.lags"

    def parse(self, scene, parameters, model):
        echoes, lags = model.get("echoes", []), tuple(model.get("lags", ()))
        size = model.get("main", 10 ** (parameters["gain_db"] / 20))
        a = size * np.exp(1j * model.get("phase_rad", 0.0))
        place = [parameters["delay_s"] * scene.sample_rate_hz, model.get("offset_hz", 0.0) * scene.duration_s]
        return start(
            self,
            _all_turned(np.array([a.real, a.imag, *place, *echoes]), place[1] / 2),
            free=[True, True, not lags, True, *[True] * len(echoes)],
            aux={"code": parameters["code"], **({"lags": lags} if lags else {})},
        )

    def model(self, scene, effect):
        p = _all_turned(effect.p, -effect.p[3] / 2)  # at t = 0
        found = {"phase_rad": float(np.angle(complex_pair(p))), "offset_hz": float(p[3]) / scene.duration_s}
        lags = effect.aux.get("lags", ())
        if lags:
            found |= {"main": abs(complex_pair(p)), "lags": list(lags), "echoes": [float(v) for v in p[4:]]}
        return found

    def describe(self, number):
        return (
            f"Another transmitter is on the air with the waveform {number.constants['code']}, "
            f"{number('gain_db')} on the taps' scale."
        )


def _all_turned(p, cycles: float):
    """Its numbers with every gain so many cycles on."""
    return np.concatenate([turned(p[:4], cycles), *(turned(pair, cycles) for pair in p[4:].reshape(-1, 2))])
