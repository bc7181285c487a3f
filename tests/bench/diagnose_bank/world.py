# SPDX-License-Identifier: GPL-3.0-or-later
"""The radio world of one recording: transmitter → channel → environment → receiver, all through GNU Radio."""

from dataclasses import dataclass, replace

import numpy as np

from . import channel, flow
from .impairments import FAMILIES, Context


@dataclass(frozen=True, kw_only=True)
class Cause:
    """One impairment: a family, whose it is, how strong, and what else was drawn."""

    key: str
    owner: dict
    strength: float
    draw: dict

    @property
    def family(self):
        return FAMILIES[self.key]

    @property
    def name(self):
        return self.family.name


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One recording before any cause: what the twin knows, and what only the world does."""

    name: str
    transmitter: str
    receiver: str
    context: Context
    amplitude: float
    seed: int
    second: object = None  # a waveform that the twin knows and believes silent
    after: object = None  # extra physics (x, context) → x at a named place, outside the list
    place: str = ""

    @property
    def link(self):
        return f"{self.transmitter}>{self.receiver}"


def touches(cause, scene):
    """The owner acts in this recording."""
    return cause.owner["level"] == "environment" or cause.owner["name"] in (
        scene.transmitter,
        scene.receiver,
        scene.link,
    )


def _apply(x, causes, scene, stage, side):
    for c in causes:
        family = c.family
        where = family.stage if family.stage in ("clock", "air", "late") else c.owner["level"]
        if family.stage in ("tx", "rx", "clock", "air", "late") and family.stage in stage and (side is None or where == side):
            x = family.act(x, c.strength, c.draw, scene.context)
    return x


def stream_of(waveform, scene, count, amplitude):
    """The transmitted samples whose index `first` is t = 0 less the whole samples of bulk delay."""
    n = np.arange(count) - scene.context.first - int(np.floor(scene.context.bulk))
    x = waveform.samples
    if waveform.repeat:
        return amplitude * x[n % len(x)]
    return amplitude * np.where((n >= 0) & (n < len(x)), x[np.clip(n, 0, len(x) - 1)], 0)


def twin_taps(scene, causes):
    """Taps as the twin writes them: a missing path's strength is written there."""
    taps = list(scene.context.taps)
    for c in causes:
        if c.family.stage == "twin" and touches(c, scene):
            taps = c.family.act(taps, c.strength, c.draw, scene.context)
    return taps


def play(scene, causes=(), *, noise=True, absent=()):
    """A recording. causes: all that exist; absent: those taken away again (for λ). Complex samples."""
    c = scene.context
    present = [k for k in causes if touches(k, scene) and k not in absent]
    total = c.first + c.count + 4096
    offset = c.bulk - np.floor(c.bulk)
    taps = twin_taps(scene, causes)
    for k in present:
        if k.family.stage == "link":
            taps = k.family.act(taps, k.strength, k.draw, c)
    fades = {k.draw["tap"]: k.family.act(k.strength, k.draw, c, total) for k in present if k.family.stage == "fade"}
    gone = {k.draw["tap"] for k in present if k.family.stage == "twin"}
    fades = {i - sum(g < i for g in gone): f for i, f in fades.items() if i not in gone}
    taps = [t for i, t in enumerate(taps) if i not in gone]
    period = len(c.waveform.samples) if c.waveform.repeat else 0
    x = stream_of(c.waveform, scene, total, scene.amplitude)
    x = _outside(x, scene, "tx_before")
    x = _apply(x, present, scene, ("tx", "rx"), "tx")
    x = _outside(x, scene, "tx")
    setup = {"rate": c.rate, "first": c.first, "offset": offset}
    y = channel.play(x, taps, period=period, fading=fades, **setup)
    for k in present:
        if k.family.stage == "second":
            other = stream_of(scene.second, scene, total, 1.0)
            tap = {
                "delay_s": k.draw["delay_s"],
                "gain_db": 20 * np.log10(k.strength),
                "phase_rad": k.draw["phase"],
                "doppler_hz": 0.0,
            }
            y = flow.add(y, channel.play(other, [tap], period=len(scene.second.samples), **setup))
    y = y * c.gain
    # before the noise: white noise stays white when resampled, an interpolator's band edge would show
    y = _apply(y, present, scene, ("clock",), None)
    y = _outside(y, scene, "channel")
    if noise:
        quiet = [k for k in present if k.family.stage == "air"]
    else:
        quiet = [k for k in present if k.family.stage == "air" and not k.family.stochastic]
    y = _apply(y, quiet, scene, ("air",), None)
    if noise:
        y = flow.add(y, flow.gaussian(total, c.noise, scene.seed))
    if c.offset_known_hz:
        y = flow.multiply(y, flow.oscillator(c.offset_known_hz / c.rate, len(y), c.first))
    y = _apply(y, present, scene, ("tx", "rx"), "rx")
    y = _outside(y, scene, "rx")
    y = _apply(y, present, scene, ("late",), None)
    return y[c.first : c.first + c.count]


def wanted_power(scene, causes):
    """Mean power in the recording of what the twin's transmitter sends, as its hardware and the channel leave it."""
    y = play(scene, [k for k in causes if k.owner["level"] in ("tx", "link")], noise=False)
    return float(np.mean(np.abs(y) ** 2))


def _outside(x, scene, place):
    return scene.after(x, scene.context) if scene.place == place else x


def measured(scene, snr_db):
    """The scene with its wanted power and noise filled in."""
    y = play(replace(scene, after=None, place=""), noise=False)
    power = float(np.mean(np.abs(y) ** 2))
    top = float(max(np.max(np.abs(y.real)), np.max(np.abs(y.imag))))
    return replace(scene, context=replace(scene.context, power=power, rms_peak=top, noise=power / 10 ** (snr_db / 10)))


# ---------------------------------------------------------------- λ
def residual(y, model):
    """What is left of y after a complex gain and a small delay of the model."""
    f = np.fft.fftfreq(len(model))
    slope = np.fft.ifft(2j * np.pi * f * np.fft.fft(model))
    a = np.stack([model, slope], 1)
    weights = np.linalg.lstsq(a, y, rcond=None)[0]
    return y - a @ weights


def _divergence(excess, dimension=1.0):
    """Σ (ρ − ln(1 + ρ)): nats by which extra noise of ratio ρ betrays itself."""
    return float(np.sum(dimension * (excess - np.log1p(excess))))


def _impulse_evidence(path, scene):
    """ln of the likelihood of impulses at unknown places (a two-part Gaussian mixture) over plain noise."""
    noise = flow.gaussian(scene.context.first + scene.context.count, scene.context.noise, scene.seed)
    power = np.abs(path + noise[scene.context.first :]) ** 2 / scene.context.noise
    hits = np.abs(path[np.abs(path) > 0]) ** 2 / scene.context.noise
    share, ratio = max(len(hits), 1) / len(path), np.mean(hits) if len(hits) else 0.0
    inside = np.log(share / (1 + ratio)) + power * ratio / (1 + ratio)
    return float(max(np.sum(np.logaddexp(np.log1p(-share), inside)), 0.0))


def _smooth_spectrum(e, width=15):
    p = np.abs(np.fft.fft(e)) ** 2 / len(e)
    return np.convolve(np.r_[p[-width:], p, p[:width]], np.ones(2 * width + 1) / (2 * width + 1), "valid")


def strength_lambda(scene, causes, cause):
    """λ of one cause in one recording: residual energy over noise variance; random ones in nats."""
    c = scene.context
    if not touches(cause, scene):
        return 0.0
    name, s, d = cause.name, cause.strength, cause.draw
    total = c.first + c.count
    if name in ("narrowband_interference", "pulsed_interference", "impulsive_noise", "noise_floor"):
        path = cause.family.act(np.zeros(total), s, d, c)[c.first :]
        if name == "narrowband_interference":
            return _divergence(_smooth_spectrum(path) / c.noise)
        if name == "pulsed_interference":
            on = np.abs(path) > 0
            return _divergence(np.full(on.sum(), s**2 * c.power / c.noise))
        if name == "impulsive_noise":
            return _impulse_evidence(path, scene)
        return _divergence(np.full(c.count, s))
    if name != "quantization":
        causes = [k for k in causes if k.name != "quantization"]  # a lattice without noise is no fair background
    if name in ("front_end_filter", "sample_clock_offset"):
        idle = [replace(k, strength=0.0) if k is cause else k for k in causes]  # their blocks' own delay is not λ
        base = play(scene, idle, noise=False)
    else:
        base = play(scene, causes, noise=False, absent=(cause,))
    if name == "signal_dependent_noise":
        power = 1 + s * np.abs(base) ** 2 / c.power
        return _divergence(power / power.mean() - 1)  # against the best flat rise of the floor
    full = play(scene, causes, noise=False)
    e = residual(full, base)
    energy = float(np.sum(np.abs(e) ** 2) / c.noise)
    if name == "phase_noise":
        quadrature = (e * np.conj(base) / np.sqrt(np.mean(np.abs(base) ** 2))).imag
        return min(energy, _divergence(2 * _smooth_spectrum(quadrature) / c.noise, 0.5))
    if name == "tap_fading":
        path = cause.family.act(s, d, c, total)[c.first :]
        power = (
            abs(c.gain * channel.amplitude(c.taps[d["tap"]])) ** 2 * np.mean(np.abs(c.waveform.samples) ** 2) * scene.amplitude**2
        )
        return min(energy, _divergence(_smooth_spectrum((path - path.mean()) * np.sqrt(power)) / c.noise))
    return energy


def fit_of_twin(scene, causes, recorded, clean):
    """Truth's `fit` entry: NMSE of the twin and of the noise, dB, with the scene's own gain and delay."""
    c = scene.context
    power = np.mean(np.abs(recorded) ** 2)
    taps = twin_taps(scene, causes)
    model = channel.predict(c.waveform, taps, rate=c.rate, delay=c.bulk, count=c.count)
    model = model * np.exp(2j * np.pi * c.offset_known_hz / c.rate * np.arange(c.count))
    model = _aligned(model, recorded)
    wanted = np.mean(np.abs(clean) ** 2)
    floor = np.mean(np.abs(recorded - clean) ** 2)
    return {
        "recording": scene.name,
        "twin_nmse_db": _db(np.mean(np.abs(residual(recorded, model)) ** 2) / power),
        "noise_floor_db": _db(floor / power),
        "snr_db": _db(wanted / floor),
        "delay_samples": float(c.bulk),
        "gain": float(abs(c.gain) * scene.amplitude),
        "phase_rad": float(np.angle(c.gain)),
    }


def _aligned(model, y):
    """The model rolled by the whole samples of delay that filters added."""
    lags = np.arange(-40, 41)
    return np.roll(model, lags[np.argmax([abs(np.vdot(np.roll(model, k), y)) for k in lags])])


def _db(x):
    return float(10 * np.log10(max(x, 1e-30)))
