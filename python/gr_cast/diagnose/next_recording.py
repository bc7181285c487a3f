# SPDX-License-Identifier: GPL-3.0-or-later
"""What to record next: every experiment is simulated under the hypotheses that are open, and the easiest one that separates them
is named."""

import copy
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy import fft as sp_fft

from ..twin.effects import FAMILIES, Role, plays, with_role
from ..twin.effects.base import start
from ..twin.model import Model, predict
from ..twin.scene import Scene, Source
from .policy import ERRORS, NEXT_LEAST_NATS, NEXT_LONGER, OFFSET_HZ, SOFTER, TELLS_NATS


@dataclass(frozen=True, kw_only=True)
class Hypothesis:
    """A model of the recording that a scene describes, with the noise power per sample that it leaves and its ln L."""

    scene: Scene
    model: Model
    floor: float
    likelihood: float

    @staticmethod
    def of(fit, like=None) -> "Hypothesis":
        """The model of a fit; with the noise of the fit `like`, where it has no law of the noise of its own."""
        shaped = like is None or any(FAMILIES[e.family].noise_like for e in fit.model.effects)
        return Hypothesis(
            scene=fit.data.scene, model=fit.model, floor=(fit if shaped else like).sigma2, likelihood=fit.likelihood
        )


def record_next(hypotheses: list[Hypothesis]) -> str:
    """The easiest experiment under which every two of the hypotheses differ by more than TELLS_NATS in a recording of the same
    length, else the one under which the nearest two differ most."""
    best, most = "longer_recording", NEXT_LEAST_NATS
    for name in EXPERIMENTS:
        nats = min(gained(a, b, name) for a, b in combinations(hypotheses, 2))
        if nats > TELLS_NATS:
            return name
        if nats > most:
            best, most = name, nats
    return best


def gained(first: Hypothesis, second: Hypothesis, experiment: str) -> float:
    """Nats by which an experiment separates two hypotheses more than the errors of their numbers do, which show in this
    recording too."""
    if experiment == AS_IT_IS:
        return NEXT_LONGER * abs(first.likelihood - second.likelihood)
    return separation(first, second, experiment) - ERRORS * separation(first, second, AS_IT_IS)


def separation(first: Hypothesis, second: Hypothesis, experiment: str) -> float:
    """Nats between what two hypotheses foretell of an experiment: of the signals at the gain and phase that suit both, and of the
    laws of the noise (the mean of both divergences of Kullback and Leibler)."""
    if experiment == "absolute_calibration":  # the gain is one number, whichever hypothesis is right
        second = _with_gain_of(first, second)
    a, b = _foretold(first, experiment), _foretold(second, experiment)
    gain = _common_gain(a.y, b.y, "none" if _filtered(first, second) else KNOWN.get(experiment, "none"))
    noise = 0.5 * (a.variance + b.variance)
    nats = float(np.sum(np.abs(gain * a.y - b.y) ** 2 / noise))
    for one, other in ((a.variance, b.variance), (a.spectrum, b.spectrum)):
        nats += float(np.sum(one / other + other / one - 2)) / 2
    return nats


# What is known of the gain in a further recording: all of it where the receiver stays as it is and only the sender falls silent.
AS_IT_IS = "longer_recording"
KNOWN = {"mute_transmitter": "gain and phase", "absolute_calibration": "gain"}


def _with_gain_of(first: Hypothesis, second: Hypothesis) -> Hypothesis:
    base = second.model.base.copy()
    base[1:3] *= np.hypot(*first.model.base[1:3]) / max(np.hypot(*base[1:3]), 1e-300)
    return replace(second, model=replace(second.model, base=base))


def _filtered(*hypotheses: Hypothesis) -> bool:
    """Whether a filter is among them, whose own gain nobody knows."""
    return any(plays(e, Role.FILTER) for h in hypotheses for e in h.model.effects)


def _common_gain(a: np.ndarray, b: np.ndarray, known: str) -> complex:
    """The factor on `a` that brings it nearest to `b`, of what is not known."""
    if known == "gain and phase":
        return 1.0
    overlap, energy = np.vdot(a, b), max(np.vdot(a, a).real, 1e-300)
    return overlap / max(abs(overlap), 1e-300) if known == "gain" else overlap / energy


@dataclass(frozen=True, kw_only=True)
class Foretold:
    """(n,) each: the signal, the noise power of every sample, and the relative noise density of every bin."""

    y: np.ndarray
    variance: np.ndarray
    spectrum: np.ndarray


def _foretold(hypothesis: Hypothesis, experiment: str) -> Foretold:
    scene, model = copy.copy(hypothesis.scene), hypothesis.model
    scene.forget()
    before = predict(scene, model).wanted
    sent_rms = float(np.sqrt(np.mean(np.abs(before) ** 2)))
    scene.forget()
    scene, model = EXPERIMENTS[experiment](scene, model)
    chain = predict(scene, model)
    variance, spectrum = np.full(scene.count, hypothesis.floor), np.ones(scene.count)
    for e in model.effects:
        if FAMILIES[e.family].noise_like:
            held = replace(e, aux={"rms": sent_rms, **e.aux})  # its level was measured at this one
            shape, density = (FAMILIES[e.family].variance(scene, held, chain.wanted), FAMILIES[e.family].spectrum(scene, held))
            variance = variance if shape is None else variance * shape
            spectrum = spectrum if density is None else spectrum * density
    return Foretold(y=chain.y, variance=variance, spectrum=spectrum)


def _silent(scene, model):
    scene.sources = [replace(s, samples=np.zeros_like(s.samples), power=0.0, peak=0.0) for s in scene.sources]
    return scene, model


def _offset(scene, model):
    cycles = [OFFSET_HZ * scene.duration_s, 0.0]
    return scene, model.adding(replace(start(with_role(Role.CARRIER), cycles), fixed=True))


def _softer(scene, model):
    power = SOFTER**2
    scene.sources = [replace(s, samples=SOFTER * s.samples, power=power * s.power, peak=SOFTER * s.peak) for s in scene.sources]
    return scene, model


def _lower_gain(scene, model):
    base = model.base.copy()
    base[1:3] *= SOFTER
    return scene, replace(model, base=base)


def _complex(scene, model):
    scene.sources = [_with(s, s.samples + 1j * np.roll(s.samples, len(s.samples) // 3)) for s in scene.sources]
    return scene, model


def _shaped(scene, model):
    """A waveform of varying envelope in the same band."""
    rng = np.random.default_rng(7)

    def shaped(samples):
        draw = rng.normal(size=len(samples)) + 1j * rng.normal(size=len(samples))
        return sp_fft.ifft(sp_fft.fft(draw) * np.abs(sp_fft.fft(samples)))

    scene.sources = [_with(s, shaped(s.samples)) for s in scene.sources]
    return scene, model


def _other_length(scene, model):
    longer = [_with(s, np.resize(s.samples, len(s.samples) // 2 * 2 + 7)) for s in scene.sources if s.repeat]
    scene.sources = longer if len(longer) == len(scene.sources) else scene.sources
    return scene, model


def _other_channel(scene, model):
    """The channel is another one; what transmitter, receiver and surroundings do stays."""
    moved = [replace(t, delay=t.delay + 3.4 * (k + 1), gain=t.gain * np.exp(2j * (k + 1))) for k, t in enumerate(scene.taps)]
    scene.taps = [*moved, replace(scene.taps[0], delay=scene.taps[0].delay + 7.7, gain=0.6j * scene.taps[0].gain)]
    return scene, replace(model, effects=tuple(e for e in model.effects if FAMILIES[e.family].level != "link"))


def _as_it_is(scene, model):
    return scene, model


# In the order in which a user would rather do them: a switch, settings, another waveform, other places, other instruments; more
# of the same comes last, for what fits alike goes on to.
EXPERIMENTS = {
    "mute_transmitter": _silent,
    "offset_carrier": _offset,
    "second_power": _softer,
    "second_rx_gain": _lower_gain,
    "complex_waveform": _complex,
    "shaped_waveform": _shaped,
    "other_code_length": _other_length,
    "move_carrier": _other_channel,
    "second_link": _other_channel,
    "absolute_calibration": _as_it_is,
    "longer_recording": _as_it_is,
}


def _with(source: Source, samples: np.ndarray) -> Source:
    """A waveform of the same power with other samples."""
    samples = samples * np.sqrt(source.power / np.mean(np.abs(samples) ** 2))
    return replace(source, samples=samples, known=np.ones(len(samples), bool), peak=float(np.abs(samples).max()))
