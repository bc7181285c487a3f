# SPDX-License-Identifier: GPL-3.0-or-later
"""What every family of physics has in common, and the effect: one family with its numbers.

Inside, parameters are scaled so that one step size serves all (samples, cycles over the recording, relative
amplitudes);
`values` turns them into the contract's names and units, and `parse` back.
"""

from dataclasses import dataclass, field, replace

import numpy as np

# The true order of the signal; the channel is run between LINK and ENVIRONMENT.
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
    AIR,
    SAMPLER,
    INVERSION,
    RAILS,
    LATTICE,
    NOISE,
) = range(19)
CHANNEL_AFTER = CLOCK

PROBE = 1e-5  # size of the wave, path or tap that is added to measure a derivative
NYQUIST = 0.01  # of the sample rate on either side of its half: what interpolation between samples cannot know


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A family with its parameters `p` (internal scaling), `free` ones fitted, and what is not a number in
    `aux`."""

    family: str
    p: np.ndarray
    free: np.ndarray
    aux: dict = field(default_factory=dict)
    prior: np.ndarray | None = None  # variance of each parameter; None: nothing known before
    trials: float = 1.0  # places that were looked at to find it
    fixed: bool = False  # physics that the twin already has

    def moved(self, p: np.ndarray) -> "Effect":
        return replace(self, p=p)


def start(family: "Family", p, *, free=None, aux=None, prior=None, trials=1.0) -> Effect:
    p = np.asarray(p, float)
    free = np.ones(len(p), bool) if free is None else np.asarray(free, bool)
    prior = None if prior is None else np.asarray(prior, float)
    return Effect(family=family.name, p=p, free=free, aux=aux or {}, prior=prior, trials=trials)


class Family:
    """One family: its place in the signal order, forward model, first guesses, numbers, sentence."""

    name = ""
    level = "rx"  # tx, rx, link or environment: the likelier owner of one link alone
    stage = RX_GAIN
    noise_like = False  # changes the noise, not the prediction
    reach = 0.5
    flexible = False  # fits much: tried after the simple ones
    linear = False  # the prediction is linear in its numbers: no step is too long
    either_side = False  # the same of a transmitter or the receiver but for small traces: all recordings together tell
    leaps = False  # no small step leads to it: all else must move with it before its worth is seen
    random = False  # its numbers are a law: what a twin has of it runs another course in every recording
    beyond = False  # physics that a diagnosis has no name for: what is left, and no cause
    same_as: dict[str, str] = {}  # families that are counted as the same answer, and when
    follows_carrier: dict[str, int] = {}  # numbers (of parameters or model) that grow with that power of the carrier

    def apply(self, chain, effect: Effect) -> None:
        """Put the effect on the chain (replace its attributes)."""
        raise NotImplementedError

    def starts(self, view) -> list[Effect]:
        """Effects at zero strength at the places worth trying; the search turns them into fits."""
        return []

    def apart(self, scene, effect: Effect) -> tuple[Effect, ...]:
        """Effects of several owners that may stand in the place of one."""
        return ()

    def less(self, scene, effect: Effect, others: tuple[Effect, ...]) -> tuple[Effect, ...]:
        """Effects that claim less and may explain the same beside `others`: each stands in where it does."""
        return ()

    def values(self, scene, effect: Effect, p: np.ndarray) -> dict[str, float]:
        """The contract's parameters of internal `p`."""
        raise NotImplementedError

    def constants(self, scene, effect: Effect) -> dict:
        """Parameters that are not fitted numbers (names, true or false)."""
        return {}

    def parse(self, scene, parameters: dict, model: dict) -> Effect:
        """The effect of a twin's entry, parameters as {name: value}."""
        raise NotImplementedError

    def nest(self, scene, effect: Effect):
        """(key, largest effect of this kind, indices of this effect's parameters in it), where starts are
        parts of one."""
        return None

    def limits(self, effect: Effect) -> np.ndarray:
        """Largest step of each parameter in one iteration of a fit."""
        return np.full(len(effect.p), self.reach)

    def settled(self, scene, effect: Effect) -> np.ndarray:
        """(parameters,) bool: what moves once the effect is found; a drift or a Doppler of 0 has an error too."""
        return effect.free

    def plausible(self, effect: Effect) -> bool:
        """Whether the numbers can be those of real equipment."""
        return True

    def finer(self, scene, effect: Effect) -> list[Effect]:
        """The effect with more freedom, for where what stood in its way is gone."""
        return []

    def later(self, scene, effect: Effect, lengths: float) -> Effect:
        """The effect of a scene in a stretch of its length that begins so many lengths later."""
        return effect

    def in_its_part(self, scene, effect: Effect) -> Effect:
        """An effect that is told of a recording's first sample in the part of the recording that a scene is."""
        return self.later(scene, effect, scene.begins / scene.span) if scene.begins else effect

    def since_the_beginning(self, scene, effect: Effect) -> Effect:
        """The effect of a part of a recording in one of its length at the recording's first sample."""
        return self.later(scene, effect, -scene.begins / scene.span) if scene.begins else effect

    def hidden(self, effect: Effect) -> int:
        """Numbers that were chosen by search and not fitted."""
        return 0

    def model(self, scene, effect: Effect) -> dict:
        """What the forward model needs beside the contract's parameters; `parse` reads it back."""
        return {}

    def unfollowed(self, effect: Effect) -> float:
        """Power, relative to the wanted signal, of a random course that is too fast for its coefficients."""
        return 0.0

    def played(self, scene, effect: Effect, rng) -> Effect:
        """The effect as a twin plays it: what is random is drawn anew from its law, with the generator `rng`."""
        return effect

    def where(self, scene, effect: Effect, values: dict) -> dict:
        return {}

    def describe(self, number) -> str:
        """One sentence; `number(name)` gives a parameter with its interval and unit as text."""
        raise NotImplementedError


def db(ratio: float) -> float:
    return 20 * np.log10(max(abs(ratio), 1e-12))


def complex_pair(p) -> complex:
    return complex(p[0], p[1])


def turned(p: np.ndarray, cycles: float) -> np.ndarray:
    """Numbers whose first two are Re and Im of a gain, after so many cycles."""
    gain = complex_pair(p) * np.exp(2j * np.pi * cycles)
    return np.concatenate([[gain.real, gain.imag], p[2:]])


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
