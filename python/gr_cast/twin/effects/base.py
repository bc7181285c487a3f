# SPDX-License-Identifier: GPL-3.0-or-later
"""What every family of physics has in common, and the effect: one family with its numbers.

Inside, parameters are scaled so that one step size serves all (samples, cycles over the recording, relative
amplitudes);
`values` turns them into the contract's names and units, and `parse` back.
"""

import itertools
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from ..chain import Chain
from ..columns import Courses, Dense, Lags
from ..interpolate import within_turn
from ..scene import Scene
from .values import Value

# The true order of the signal; the channel is run between LINK and ENVIRONMENT. What is in the air stands behind an inversion,
# for its frequencies are told as recorded.
(
    TX_IQ,
    TX_LEAK,
    TX_FILTER,
    TX_PA,
    TX_LO,
    LINK,
    CLOCK,
    ENVIRONMENT,
    RX_LO,
    RX_FILTER,
    RX_GAIN,
    RX_IQ,
    RX_DC,
    INVERSION,
    AIR,
    SAMPLER,
    RAILS,
    QUANTISER,
    NOISE,
) = range(19)
CHANNEL_AFTER = CLOCK


class Role(Enum):
    """A part of a radio that one family alone plays and for which the engine has physics of its own; with the numbers `p` of an
    effect that it may read."""

    CARRIER = "offset of the oscillators: cycles over the recording amid it, cycles of drift"
    CLOCK = "offset of the sample clocks: samples gained over the recording"
    WANDER = "an oscillator's random phase"
    SLIP = "samples lost or inserted: first sample behind the joint, samples lost"
    STEP = "gain that changes at one moment: nepers, moment as a share of the recording"
    DRIFT = "gain that changes slowly"
    ORIENTATION = "which way round the spectrum is"
    RAILS = "largest value of a converter: level, rms in I and in Q of the noise in front of it"
    QUANTISER = "grid of a converter: step, level of one point in steps, rms in steps of the noise in front of it"
    AMPLIFIER = "a transmitter's amplifier"
    FILTER = "a front end's filter"
    FLOOR = "level of the noise: dB over the twin's"
    FOLLOWING = "noise in step with the signal: ln of its power at mean wanted power over the floor"


class Multiplicity(Enum):
    """How many effects of a family a recording may have."""

    ONE = "one"
    EACH_PLACE = "one at each place: a tap, a side, a transmitter"
    MANY = "any number"


PROBE = 1e-5  # size of the wave, path or tap that is added to measure a derivative
SEARCHED = 0.05  # of a number, that a search leaves open
LEAST_TOLD = 0.1  # numbers, that a recording must tell of a course to say how large it is
NYQUIST = 0.01  # of the sample rate on either side of its half: what interpolation between samples cannot know


_KEYS = itertools.count()

# What an effect is beside its numbers, as far as the engine may ask; all other entries of `aux` are its family's own.
AUX = {
    "source": "number of the transmitter whose signal it is in",
    "tap": "number of the twin's tap that it changes",
    "side": "of what either side may have: tx, rx, or not said",
    "code": "waveform of a transmitter that is not on the air in the twin",
    "held": "a number that the twin tells stands still: another claim than with it free",
    "read": "read off the samples themselves before anything was searched: nats by which that is no chance, whatever a fit says",
    "lone": "rails at one end alone",
    "later": "of a slip: the twin's delay is the one behind its joint",
    "gap": "samples between which it happened, where none of them was fitted",
    "before": "nepers that a twin's gain has changed by before a part of a recording",
    "whole": "told by all parts of a recording together",
    "nats": "evidence that was measured otherwise than by fits with and without it",
    "entry": "number of the twin's entry that it plays",
    "_told": "standard deviations of the numbers that the twin tells of them",
    "_std": "standard deviations of the numbers, found by a search",
    "_stds": "standard deviations of the contract's parameters, found otherwise than by a fit",
    "_variance": "variances of the numbers of a course around its estimate",
    "_doubt": "the same variance of the course itself, in the mean of the moments that tell it",
    "_jitter": "rad² of a phase that is too fast to be followed",
    "_blur": "power by which a fit's errors move the wanted signal where it is faint, and its standard deviation",
    "_passing": "whether a random course moves in one stretch alone, and is no cause",
    "_floor": "noise power that the numbers are relative to",
}


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A family with its parameters `p` (internal scaling), `free` ones fitted, and what is not a number in `aux` (AUX)."""

    family: str
    p: np.ndarray
    free: np.ndarray
    aux: dict = field(default_factory=dict)
    prior: np.ndarray | None = None  # variance of each parameter; None: nothing known before
    trials: float = 1.0  # places that were looked at to find it
    fixed: bool = False  # physics that the twin already has
    key: int = field(default_factory=_KEYS.__next__, compare=False)  # which one it is, whatever moves or refits it

    def moved(self, p: np.ndarray) -> "Effect":
        return replace(self, p=p)

    def another(self) -> "Effect":
        """A second one that is like it."""
        return replace(self, key=next(_KEYS))


def start(family: "Family", p, *, free=None, aux=None, prior=None, trials=1.0) -> Effect:
    p = np.asarray(p, float)
    free = np.ones(len(p), bool) if free is None else np.asarray(free, bool)
    prior = None if prior is None else np.asarray(prior, float)
    return Effect(family=family.name, p=p, free=free, aux=aux or {}, prior=prior, trials=trials)


class Family:
    """One family: its place in the signal order, forward model, first guesses, numbers, sentence. All that the engine may ask
    of a family is declared here; a family has no other public name (tests/test_effect_interface.py)."""

    name = ""
    parameters: dict[str, Value] = {}  # the contract's, by name, that an entry may tell
    remembered: dict[str, Value] = {}  # of the model, which `model` writes and `parse` reads back
    role: Role | None = None
    owners: tuple[str, ...] = ("rx",)  # of tx, rx, link and environment, the likelier one of one link alone first
    stage = RX_GAIN
    multiplicity = Multiplicity.EACH_PLACE
    telling = ""  # the parameter that is 0 where there is no such effect, where no number of its own is
    told_as = ""  # the family under whose name a diagnosis tells it, where that is another
    sizes: tuple[int, ...] = ()  # numbers that are all 0 where there is no such effect
    place: int | None = None  # the number that is searched for and tells several of a kind apart
    place_step = 1.0  # of that number, by which two differ in a search
    lasting = True  # holds throughout a recording; else of one moment, or judged anew in every part of a long one
    relative = False  # its numbers are relative to the wanted signal's rms in its scene
    common = False  # its numbers are the same wherever its owner is seen
    two_sided = False  # has a form in front of the channel and one behind it, and says which (aux side)
    noise_like = False  # changes the noise, not the prediction
    reach = 0.5  # largest step of a number in one iteration of a fit
    scattered = False  # noise of single samples, each of which has it or has not: `shares` and `likelihood` tell
    flexible = False  # fits much: tried after the simple ones
    entangled = False  # what its numbers do resembles one another, however many they are
    linear = False  # the prediction is linear in its numbers: no step is too long
    either_side = False  # the same of a transmitter or the receiver but for small traces: all recordings together tell
    leaps = False  # no small step leads to it: all else must move with it before its worth is seen
    of_gain = False  # changes the gain over time, by a law
    wanders: tuple[str, ...] = ()  # of gain and phase: what its `course` moves at random, so that no other course of it shows
    row_of_taps = False  # taps behind the strongest: two such families imitate each other, whatever their lengths
    least_error: dict[str, float] = {}  # what one realisation of a random course leaves open: share of a number, or dB
    random = False  # its numbers are a law: what a twin has of it runs another course in every recording
    beyond = False  # physics that a diagnosis has no name for: what is left, and no cause
    same_as: dict[str, str] = {}  # families that are counted as the same answer, and when
    follows_carrier: dict[str, int] = {}  # numbers (of parameters or model) that grow with that power of the carrier

    @property
    def told(self) -> str:
        """The name under which a diagnosis tells it."""
        return self.told_as or self.name

    @property
    def level(self) -> str:
        """The likelier owner of one link alone."""
        return self.owners[0]

    def at(self, effect: Effect) -> int:
        """Where in the signal order an effect stands."""
        return self.stage

    def coarse(self, effect: Effect) -> bool:
        """Whether it is a quantiser whose error is bound to the signal, and no noise of its own."""
        return False

    def gate(self, scene: Scene, effect: Effect) -> np.ndarray | None:
        """(n,) bool when it is on, of what comes and goes and may have any colour meanwhile."""
        return None

    def band(self, effect: Effect) -> tuple[float, float] | None:
        """(middle, width) of the band that noise fills, shares of the sample rate; None where it is no matter of frequency."""
        return None

    @property
    def fills_bands(self) -> bool:
        """Whether it is of those that have a `band`."""
        return type(self).band is not Family.band

    def apply(self, chain: Chain, effect: Effect) -> None:
        """Put the effect on the chain (replace its attributes)."""
        raise NotImplementedError

    def columns(self, scene: Scene, effect: Effect, chain: Chain, before: Chain, rest: Callable) -> Dense | Lags | Courses | None:
        """Derivatives of the prediction `chain` by the free numbers where they are cheaper than differences, else None; `before`
        is the chain in front of the effect, `rest(chain, effect, extra=None)` runs it on from there, `extra` (source, wave) is
        then sent too."""
        return None

    def starts(self, view) -> Iterable[Effect]:
        """Effects at zero strength at the places worth trying; the search turns them into fits."""
        return []

    def elsewhere(self, scene: Scene) -> Iterable[tuple[float, Effect]]:
        """[(samples by which the delay that was found is too late, effect)] under which another path stands where the twin's
        strongest one was looked for."""
        return ()

    def at_once(self, view) -> tuple[float, list[Effect]]:
        """(samples by which the twin's signal is later then, all effects of this family that the recording shows together)."""
        return 0.0, []

    def another(self, effect: Effect) -> list[Effect]:
        """The effect with the numbers next to those that a search counted."""
        return []

    def apart(self, scene: Scene, effect: Effect) -> tuple[Effect, ...]:
        """Effects that may stand in the place of one together: of several owners, or what often comes with it."""
        return ()

    def forms(self, scene: Scene, effect: Effect) -> Iterable[Effect]:
        """The same part of a radio in other forms: other lengths and orders, the other side of the channel."""
        return ()

    def imitated(self, scene: Scene, effect: Effect) -> Iterable[Effect]:
        """What does the same as an effect that is found, of other families, where nothing but a habit of such families tells them
        apart: under the prior that this one has."""
        return ()

    def less(self, scene: Scene, effect: Effect, others: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """Effects that claim less and may explain the same beside `others`: each stands in where it does."""
        return ()

    def excludes(self, effect: Effect, other: Effect) -> bool:
        """Whether both explain the same, so that a model has one of them."""
        return False

    def moment(self, scene: Scene, effect: Effect) -> float | None:
        """The first sample behind the moment at which an effect happens; None: at no moment."""
        return None

    def happening(self, scene: Scene, effect: Effect, first: float) -> Effect:
        """The effect at another moment, with its first sample behind that."""
        raise NotImplementedError

    def joined(self, effect: Effect, other: Effect) -> Effect | None:
        """The one effect that two of this family are at one place; None: they are apart."""
        return None

    def stepped(self, p: np.ndarray, step: np.ndarray) -> np.ndarray:
        """Internal numbers after a step along the derivatives at `p`, which may be a long one."""
        return p + step

    def unsteady(self, effect: Effect, other: Effect) -> bool:
        """Whether two of this family are one whose numbers change."""
        return False

    def values(self, scene: Scene, effect: Effect, p: np.ndarray) -> dict[str, float]:
        """The contract's parameters of internal `p`."""
        raise NotImplementedError

    def constants(self, scene: Scene, effect: Effect) -> dict:
        """Parameters that are not fitted numbers (names, true or false)."""
        return {}

    def contradiction(self, parameters: dict, model: dict) -> str | None:
        """What is wrong with values of an entry each of which may be; None where nothing is."""
        return None

    def parse(self, scene: Scene, parameters: dict, model: dict) -> Effect:
        """The effect of a twin's entry, parameters as {name: value}."""
        raise NotImplementedError

    def nest(self, scene: Scene, effect: Effect) -> tuple[object, Effect, np.ndarray] | None:
        """(key, largest effect of this kind, indices of this effect's parameters in it), where starts are
        parts of one."""
        return None

    def limits(self, effect: Effect) -> np.ndarray:
        """Largest step of each parameter in one iteration of a fit."""
        return np.full(len(effect.p), self.reach)

    def settled(self, scene: Scene, effect: Effect) -> np.ndarray:
        """(parameters,) bool: what moves once the effect is found; a drift or a Doppler of 0 has an error too."""
        return effect.free

    def likelier(self, effect: Effect, covariance: np.ndarray) -> Effect:
        """The effect under the prior that its numbers make likeliest, from their covariance under the present one: its scale,
        from as many of them as the recording tells (MacKay 1992); by EM, those of which nothing is heard would hold it."""
        if effect.prior is None:
            return effect
        told = max(float(np.sum(1 - np.diag(covariance) / effect.prior)), LEAST_TOLD)
        factor = float(np.clip(np.sum(effect.p**2 / effect.prior) / told, 0.1, 10.0))
        return effect if 0.8 < factor < 1.25 else replace(effect, prior=effect.prior * factor)

    def settled_law(self, scene: Scene, effect: Effect, covariance: np.ndarray) -> Effect:
        """The effect with what its numbers, of this covariance, tell of the law behind them, once all else is known."""
        return replace(effect, aux={**effect.aux, "_variance": np.diag(covariance).tolist()}) if effect.free.any() else effect

    def other_laws(self, scene: Scene, effect: Effect, covariance: np.ndarray) -> Iterable[Effect]:
        """The effect under another law than the one that it was found with, where its numbers, of this covariance, tell so."""
        return ()

    def instead_of(self, scene: Scene, effect: Effect, covariance: np.ndarray) -> Iterable[tuple[Effect, np.ndarray]]:
        """Those of this family that a random course of another, of such a covariance, may be, each with what the carrier's offset
        and drift then are besides, in cycles."""
        return ()

    def plausible(self, effect: Effect) -> bool:
        """Whether the numbers can be those of real equipment."""
        return True

    def finer(self, scene: Scene, effect: Effect) -> Iterable[Effect]:
        """The effect with more freedom, for where what stood in its way is gone."""
        return ()

    def finest(self, scene: Scene, effect: Effect) -> Iterable[Effect]:
        """The effect with more freedom than a search tries, for when all else is found."""
        return ()

    def mirrored(self, effect: Effect) -> Effect:
        """The effect of a spectrum that faces the other way, where no small step of a fit leads there: what turns turns back."""
        return effect

    def in_time(self, scene: Scene, effect: Effect, later: float, longer: float) -> Effect:
        """The same physics told of a stretch of time that begins `later` lengths of the scene's after it and is `longer` times as
        long: the one rule by which an effect moves."""
        return effect

    def moved_to(self, effect: Effect, here: Scene, there: Scene) -> Effect | None:
        """The same physics in another scene: of another part of the recording, or of another recording, each from its own first
        sample on. What a twin's entry says of it there is the same. None where what it acts on is not there, and of random
        courses, of which another one runs there."""
        aux = acts_on(effect, here, there)
        if aux is None or self.random:
            return None
        moved = self._between(here, effect, (there.begins - here.begins) / here.span, there.span / here.span)
        if self.relative and here.rms != there.rms:
            aux = {**aux, "rms": rms_of(here, effect)}
        return replace(moved, aux={**moved.aux, **aux})

    def in_its_part(self, scene: Scene, effect: Effect) -> Effect:
        """An effect that is told of a recording's first sample in the part of the recording that a scene is."""
        return self._between(scene, effect, scene.begins / scene.span, 1.0)

    def since_the_beginning(self, scene: Scene, effect: Effect) -> Effect:
        """The effect of a part of a recording in one of its length at the recording's first sample."""
        return self._between(scene, effect, -scene.begins / scene.span, 1.0)

    def _between(self, scene: Scene, effect: Effect, later: float, longer: float) -> Effect:
        return self.in_time(scene, effect, later, longer) if later or longer != 1.0 else effect

    def variance(self, scene: Scene, effect: Effect, wanted: np.ndarray) -> np.ndarray | None:
        """(n,) power of the noise of each sample beside the prediction's `wanted`, relative to the floor; None: even."""
        return None

    def spectrum(self, scene: Scene, effect: Effect) -> np.ndarray | None:
        """(n,) power of the noise in each bin of an FFT relative to the floor; None: white."""
        return None

    def find(self, view, near: Effect | None = None) -> tuple[float, Effect | None]:
        """(gain in nats over an even floor, effect) of a law of the noise, or (0, None); `near`: this effect as it was found
        before."""
        return 0.0, None

    def added(self, scene: Scene, effect: Effect, wanted: np.ndarray, draw: Callable[[], np.ndarray]) -> np.ndarray:
        """(n,) complex noise that the effect puts over the floor; draw() is circular white noise of power 1, (n,)."""
        raise NotImplementedError

    def shares(self, effect: Effect, power: np.ndarray) -> np.ndarray:
        """(n,) probability that a sample of which so much power is left has what is `scattered`."""
        raise NotImplementedError

    def weight(self, effect: Effect, power: np.ndarray) -> np.ndarray:
        """(n,) what a sample of which so much power is left then tells, of 1 for one that has nothing of it."""
        raise NotImplementedError

    def likelihood(self, effect: Effect, energy: np.ndarray) -> np.ndarray:
        """(n,) ln of the density of the energies of samples with and without what is `scattered` together."""
        raise NotImplementedError

    def spared_nats(self, effect: Effect, count: float) -> float:
        """Nats that `count` samples may lose by it by chance, as those which happen to have none of what is `scattered`."""
        return 0.0

    def noise_gain_db(self, effect: Effect) -> float:
        """By how much it may change the power of the noise, where nobody knows yet whose it is."""
        return 0.0

    def rounding(self, effect: Effect) -> float:
        """Power of the noise that a converter's grid adds."""
        return 0.0

    def impulse_response(self, effect: Effect, p: np.ndarray) -> np.ndarray:
        """(taps,) of a filter with the numbers `p`."""
        return np.ones(1)

    def spectrum_of(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """((orders,) coefficients, (orders,) their variance as they were estimated) of the course of what `wanders`."""
        return effect.p, np.asarray(effect.aux.get("_variance", np.zeros(len(effect.p))))

    def course(self, scene: Scene, effect: Effect, p: np.ndarray) -> np.ndarray:
        """(n,) the course with the numbers `p` of what `wanders`: a phase in rad, or a complex gain."""
        raise NotImplementedError

    def factor(self, effect: Effect, u: np.ndarray) -> np.ndarray:
        """(n,) what it makes of the gain at the times `u` (n,), shares of the recording."""
        return np.ones(len(u))

    def placed(self, scene: Scene, told: dict[str, dict]) -> tuple[float, float]:
        """Where an effect with these parameters {name: {value, std}} is, the same in every recording that shows it, and the
        standard deviation of that where it may be large: within 0.7 two are at one place."""
        return 0.0, 0.0

    def holds(self, scene: Scene, effect: Effect, other: Effect) -> bool:
        """Whether another effect is a part of this one, and no cause of its own."""
        return False

    def delays(self, scene: Scene, effect: Effect) -> tuple[float, ...]:
        """Delays, in samples on the scale of the taps, at which it puts what is sent."""
        return ()

    def extrapolated(self, scene: Scene, effect: Effect) -> str | None:
        """What of the scene goes beyond that in which the effect was measured, as a sentence."""
        return None

    def retuned(self, parameters: dict, model: dict, ratio: float, moved_hz: float) -> tuple[dict, dict]:
        """Parameters and model of an entry on a carrier `ratio` times as high, or `moved_hz` higher."""
        out = []
        for numbers in (parameters, model):
            told = {k: numbers[k] * ratio**power for k, power in self.follows_carrier.items() if numbers.get(k) is not None}
            out.append(numbers | told)
        return out[0], out[1]

    def hidden(self, effect: Effect) -> int:
        """Numbers that were chosen by search and not fitted."""
        return 0

    def model(self, scene: Scene, effect: Effect) -> dict:
        """What the forward model needs beside the contract's parameters; `parse` reads it back."""
        return {}

    def unfollowed(self, effect: Effect) -> float:
        """Power, relative to the wanted signal, of a random course that is too fast for its coefficients."""
        return 0.0

    def played(self, scene: Scene, effect: Effect, rng) -> Effect:
        """The effect as a twin plays it: what is random is drawn anew from its law, with the generator `rng`."""
        return effect

    def spread(self, scene: Scene, effect: Effect, sigma2: float, power: float) -> dict[str, float]:
        """Standard deviations of numbers besides what a fit leaves open, at a noise and a wanted power: of those that a search
        found, or that laws tell differently which explain the same."""
        return {}

    def resolution(self, scene: Scene, name: str, value: float) -> float:
        """Standard deviation of a number of which nothing else tells it: that of its search."""
        return SEARCHED * abs(value)

    def where(self, scene: Scene, effect: Effect, values: dict) -> dict:
        """The smallest interval that holds it, by axis of the contract, where it is not everywhere."""
        return {}

    def describe(self, number: Callable[[str], str]) -> str:
        """One sentence; `number(name)` gives a parameter with its interval and unit as text."""
        raise NotImplementedError


def around_circle(f, middle: float):
    """How far frequencies, as shares of the sample rate, lie from one of them."""
    return np.abs(within_turn(f - middle + 0.5) - 0.5)


def db(ratio: float) -> float:
    return 20 * np.log10(max(abs(ratio), 1e-12))


def complex_pair(p) -> complex:
    return complex(p[0], p[1])


def turned(p: np.ndarray, cycles: float) -> np.ndarray:
    """Numbers whose first two are Re and Im of a gain, after so many cycles."""
    gain = complex_pair(p) * np.exp(2j * np.pi * cycles)
    return np.concatenate([[gain.real, gain.imag], p[2:]])


def amid(later: float, longer: float) -> float:
    """Lengths of a scene from its middle to that of a stretch that begins `later` lengths after it and is `longer` as long."""
    return later + (longer - 1.0) / 2


def acts_on(effect: Effect, here, there) -> dict | None:
    """What an effect acts on in another scene (aux `source`, `tap`); None where that is not there."""
    aux = {}
    if "source" in effect.aux:
        name = here.transmitters[effect.aux["source"]]
        if name not in there.transmitters:
            return None
        aux["source"] = there.transmitters.index(name)
    if "tap" in effect.aux:
        tap = here.taps[effect.aux["tap"]]
        name = here.transmitters[tap.source]
        if name not in there.transmitters or here.receiver != there.receiver:
            return None
        rank = sum(t.source == tap.source for t in here.taps[: effect.aux["tap"]])
        aux["tap"] = [k for k, t in enumerate(there.taps) if there.transmitters[t.source] == name][rank]
    return aux


def of_sender(effect, chain, before, rest) -> np.ndarray:
    """(n,) what the transmitter of an effect adds to the prediction `chain`; `before` and `rest` as `columns` has them."""
    if len(chain.scene.sources) == 1:
        return chain.wanted
    i = effect.aux["source"]
    return (rest(before.copy(), effect, extra=(i, PROBE * before.waves[i])).y - chain.y) / PROBE


def side_of(model: dict) -> dict:
    """The side of an effect that either may have, as `aux` holds it: a transmitter's, where that owns it and a diagnosis did
    not see it at the receiver ("at")."""
    of_sender = model.get("side") == "tx" and model.get("at", "tx") == "tx"
    return {"side": "tx", "source": model.get("source", 0)} if of_sender else {}


def rms_of(scene, effect: Effect) -> float:
    """The wanted signal's rms that levels of `effect` are relative to: now, or where a twin's effect was measured."""
    return float(effect.aux.get("rms", scene.rms))


def said_rms(model: dict) -> dict:
    return {"rms": float(model["wanted_rms"])} if "wanted_rms" in model else {}


def at_half_the_rate(f):
    """Whether frequencies, as shares of the sample rate from -1/2 to 1, lie where interpolation leaves some of the signal."""
    return np.abs(np.abs(f) - 0.5) < NYQUIST


def peaks(spectrum: np.ndarray, count: int, apart: int) -> list[int]:
    """Indices of the strongest values, each more than `apart` from the others."""
    spectrum, found = spectrum.copy(), []
    for _ in range(count):
        i = int(np.argmax(spectrum))
        if spectrum[i] <= 0:
            break
        found.append(i)
        spectrum[max(0, i - apart) : i + apart + 1] = 0.0
    return found
