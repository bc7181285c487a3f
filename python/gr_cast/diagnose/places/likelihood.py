# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a predicted response explains a sounding, after what the sounding does not claim to know is fitted.

The residual is circular noise of known power, so that −ln p is the energy E = Σ|Y − g·H|²/noise up to a constant: nats.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import ifft
from scipy.special import ive

from ...scenario.create.images import tracing

_AGREEING = 6  # rounds in which a link of another delay than its nodes' loses its say
_ROUNDS = 4  # of gains and delays, which are Gauss-Newton steps near the optimum
_FAR = 1e6  # of a Bessel function's argument, beyond which its asymptote stands
_FINER = 8  # of the grid of delays over the resolution of the band
_FAINT = 1e-200  # of a product of model and sounding: less has no phase and no delay, and quotients of it may be infinite


@dataclass(frozen=True, kw_only=True)
class Heard:
    """One sounding as the fit needs it: responses `y` (L, T, K) with 0 where one is missing, `weight` (L, T, K) 1/noise or 0."""

    links: tuple[tuple[str, str], ...]
    y: np.ndarray
    weight: np.ndarray
    frequency_hz: np.ndarray
    phase: str
    delay: str
    gain: str

    @cached_property
    def known(self) -> np.ndarray:
        """(L, T, K) whether there is a number."""
        return self.weight > 0

    @cached_property
    def count(self) -> int:
        return int(self.known.sum())

    @cached_property
    def counts(self) -> np.ndarray:
        """(L, T) numbers of each response."""
        return self.known.sum(axis=2)

    @cached_property
    def share(self) -> np.ndarray:
        """(L,) of the numbers of a link that are there."""
        return self.known.mean(axis=(1, 2))

    @cached_property
    def noise(self) -> np.ndarray:
        """(L,) over all of them."""
        return self.known.sum(axis=(1, 2)) / np.maximum(self.weight.sum(axis=(1, 2)), 1e-300)

    @cached_property
    def root(self) -> np.ndarray:
        """(L, T, K): one over the noise's deviation, or 0."""
        return np.sqrt(self.weight)

    @cached_property
    def weighted(self) -> np.ndarray:
        """(L, T, K): what was heard, over its noise."""
        return self.y * self.weight

    @cached_property
    def omega(self) -> np.ndarray:
        return 2 * np.pi * self.frequency_hz

    @cached_property
    def powers_of_omega(self) -> np.ndarray:
        """(K, 3): 1, ω, ω²."""
        return np.stack([np.ones_like(self.omega), self.omega, self.omega**2], axis=1)

    @cached_property
    def design(self) -> np.ndarray:
        return incidence(self.links)

    @cached_property
    def ends(self) -> np.ndarray:
        """(L, 2) numbers of the nodes."""
        return numbered(self.links)

    @property
    def spacing_hz(self) -> float:
        """Of neighbouring frequencies; 1 where there is but one."""
        return self.frequency_hz[1] - self.frequency_hz[0] if len(self.frequency_hz) > 1 else 1.0


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """What was fitted of the unknown: `model` = g·H, `residual` (both L, T, K), energy in nats, of which `offset` is no
    residual's: determinants of random effects, and what unknown phases took."""

    model: np.ndarray
    residual: np.ndarray
    energy: float
    factor: np.ndarray
    offset: float = 0.0


def profiled(heard: Heard, h: np.ndarray) -> Fitted:
    """The least energy over unknown phases, delays and gains."""
    cross, moments = _crossed(heard, h)
    if heard.delay == "none":
        return _fitted(heard, h, cross, moments, np.zeros(len(h)))
    begun = _agreed(_delays(heard, cross), heard, moments[:, :, 0].sum(axis=1))
    return min((_fitted(heard, h, cross, moments, delay_s) for delay_s in begun), key=lambda fit: fit.energy)


def _crossed(heard: Heard, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(L, T, K) of model and sounding, and moments (L, T, 3) of the model's power over frequency; T = 1 where instants are as
    one."""
    together = heard.phase != "snapshot"
    if tracing:
        return tracing.crossed(h, heard.y, heard.weight, heard.omega, together)
    cross = h.conj() * heard.weighted
    moments = ((h.real**2 + h.imag**2) * heard.weight) @ heard.powers_of_omega
    return tuple(one.sum(axis=1, keepdims=True) for one in (cross, moments)) if together else (cross, moments)


def _fitted(heard: Heard, h: np.ndarray, cross: np.ndarray, moments: np.ndarray, delay_s: np.ndarray) -> Fitted:
    """The least energy near some delays (L,); `cross` and `moments` of each instant, or of all where these have one phase."""
    delay_s, log_gain, sums, phase = _settled(heard, cross, moments, delay_s)
    factor = (phase * np.exp(log_gain)[:, None])[:, :, None]
    if heard.delay != "none":
        factor = factor * np.exp(-1j * delay_s[:, None] * heard.omega)[:, None]
    model, residual, energy = _left_by(heard, h, factor)
    turns = _turns_nats(heard, sums * np.exp(log_gain)[:, None])
    factor = np.broadcast_to(factor, h.shape)
    return Fitted(model=model, residual=residual, energy=energy + turns, factor=factor, offset=turns)


def _left_by(heard: Heard, h: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Model, residual and its energy, of a factor (L, 1 or T, 1 or K)."""
    if tracing:
        return tracing.left_by(h, factor, heard.y, heard.weight, heard.omega)
    model = h * factor
    residual = np.where(heard.known, heard.y - model, 0)
    return model, residual, float(((residual.real**2 + residual.imag**2) * heard.weight).sum())


def _settled(heard: Heard, cross: np.ndarray, moments: np.ndarray, delay_s: np.ndarray) -> tuple[np.ndarray, ...]:
    """Delays and logarithms of gains (L,), sums of model and sounding over frequency (L, T) and what turns them (L, T), by
    Gauss-Newton steps from some delays."""
    if tracing:
        free = heard.phase != "none"
        return tracing.settled(
            cross, moments, heard.omega, delay_s, heard.ends, free, heard.gain, heard.delay, _ROUNDS
        )  # fmt: skip
    omega, bend = heard.omega, _bend(heard, moments)
    log_gain = np.zeros(len(cross))
    for number in range(_ROUNDS if heard.gain != "none" or heard.delay != "none" else 1):
        if heard.delay != "none" or not number:
            turn = np.exp(1j * delay_s[:, None] * omega)
            sums = cross @ (turn[:, :, None] * heard.powers_of_omega[:, :2])  # (L, T, 2): over frequencies, and times them
            phase = _phases(sums[:, :, 0], heard.phase)
        if heard.gain != "none":
            log_gain = _gains(heard, (sums[:, :, 0] * phase.conj()).real.sum(axis=1), moments, log_gain if number else None)
        if heard.delay != "none" and number + 1 < _ROUNDS:
            delay_s = delay_s + _delay_step(heard, sums * phase.conj()[:, :, None], *bend, np.exp(log_gain))
    return delay_s, log_gain, sums[:, :, 0], phase


def tempered(energy: np.ndarray, count: np.ndarray) -> np.ndarray:
    """Energy of responses of `count` numbers where each may have as much more noise as suits it: n + n·ln(E/n) above n. What
    another cause spoils beyond repair then hides no cause that explains the rest."""
    least = np.maximum(count, 1)
    return np.where(energy > count, least * (1 + np.log(np.maximum(energy, least) / least)), energy)


def _turns_nats(heard: Heard, cross: np.ndarray) -> float:
    """What the unknown phases took, by `cross` (L, T) of model and sounding: −ln p is the mean over all that a phase may be, not
    of the best of them. Without it, a faint echo where the twin has nothing would gain from noise in every snapshot."""
    if heard.phase == "none":
        return 0.0
    return turns_nats(np.abs(cross if heard.phase == "snapshot" else cross.sum(axis=1)))


def turns_nats(cross: np.ndarray) -> float:
    """−ln of the mean over a phase of exp(2·cross·cos) over its greatest value, of all together."""
    near, far = np.minimum(2 * cross, _FAR), np.maximum(2 * cross, _FAR)
    return float(np.where(2 * cross < _FAR, -np.log(ive(0, near)), 0.5 * np.log(2 * np.pi * far)).sum())


def _phases(cross: np.ndarray, kind: str) -> np.ndarray:
    """(L, T), or (L, 1) of links."""
    if kind == "none":
        return np.ones(cross.shape, complex)
    if kind == "link":
        cross = cross.sum(axis=1, keepdims=True)
    size = np.abs(cross)
    return np.where(size > _FAINT, cross / np.maximum(size, _FAINT), 1)


def numbered(links) -> np.ndarray:
    """(L, 2) numbers of links' ends."""
    names = sorted({name for link in links for name in link})
    return np.array([[names.index(name) for name in link] for link in links], int).reshape(-1, 2)


def incidence(links) -> np.ndarray:
    """(L, nodes) how often each node is an end of a link."""
    ends = numbered(links)
    out = np.zeros((len(ends), ends.max(initial=-1) + 1))
    np.add.at(out, (np.arange(len(ends))[:, None], ends), 1)
    return out


def _gains(heard: Heard, wanted: np.ndarray, moments: np.ndarray, before: np.ndarray | None) -> np.ndarray:
    """Log gains of links (L,), whose models are `wanted` (L,) for what they have: of nodes, summed per link, by weighted least
    squares of the logarithm first, then by Gauss-Newton steps in amplitude."""
    have = moments[:, :, 0].sum(axis=1)
    if heard.gain == "common":
        return np.full(len(have), np.log(max(wanted.sum(), 1e-6 * have.sum(), 1e-300) / max(have.sum(), 1e-300)))
    ratio = np.where(have > 0, np.maximum(wanted, 1e-6 * have) / np.where(have > 0, have, 1), 1)  # 1: nothing is predicted
    if heard.gain == "link":
        return np.log(ratio)
    design = heard.design
    if before is None:
        root = np.sqrt(have) * np.minimum(ratio, 1 / np.maximum(ratio, 1e-12))
        return design @ np.linalg.lstsq(root[:, None] * design, root * np.log(ratio), rcond=1e-9)[0]
    now = np.exp(before)
    root = np.sqrt(have) * now
    step = np.linalg.lstsq(root[:, None] * design, np.sqrt(have) * (ratio - now), rcond=1e-9)[0]
    return before + np.clip(design @ step, -1, 1)


def _shared(delay_s: np.ndarray, heard: Heard, weight: np.ndarray) -> np.ndarray:
    """Delays (L,) of links as the sums of their nodes', where it is those that are unknown."""
    if heard.delay == "link":
        return delay_s
    design, root = heard.design, np.sqrt(weight)
    return design @ np.linalg.lstsq(root[:, None] * design, root * delay_s, rcond=1e-9)[0]


def _agreed(delay_s: np.ndarray, heard: Heard, weight: np.ndarray) -> list[np.ndarray]:
    """Delays (L,) that suit all links, and where these differ those that most agree on: a link whose paths the world has not is
    best at a delay that is no node's (iteratively reweighted least squares, Holland and Welsch 1977)."""
    cell_s, known = 1 / (len(heard.frequency_hz) * heard.spacing_hz), weight > 0
    out = [_shared(delay_s, heard, weight)]
    for _ in range(_AGREEING):
        off = np.where(known, np.abs(delay_s - out[-1]), 0.0) / cell_s
        if off.max(initial=0.0) < 1:
            break
        out.append(_shared(delay_s, heard, weight / (1 + off**2) ** 2))
    return [out[0], *out[1:][-1:]]


def _delays(heard: Heard, cross: np.ndarray) -> np.ndarray:
    """The best delay per link from the whole range that the steps of frequency tell apart."""
    size = 1 << int(np.ceil(np.log2(_FINER * len(heard.frequency_hz))))
    return np.fft.fftfreq(size, heard.spacing_hz)[_late(heard, cross, size)]


def _late(heard: Heard, cross: np.ndarray, size: int) -> np.ndarray:
    """(L,) numbers of the best delays on a grid of `size`, as a transform has it."""
    first, free = heard.frequency_hz[0] / heard.spacing_hz, heard.phase != "none"  # the grid starts at the first frequency
    if tracing:
        return tracing.late(cross, size, first, free)
    most = np.abs(cross).max(axis=(1, 2), keepdims=True)  # single precision holds no powers of amplitudes
    profile = ifft((cross / np.maximum(most, _FAINT)).astype(np.complex64), size)
    face = 1.0 if free else np.exp(2j * np.pi * first * np.fft.fftfreq(size))
    return np.argmax((np.abs(profile) if free else (profile * face).real).sum(axis=1, dtype=float), axis=-1)


def _bend(heard: Heard, moments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The middle (L, T) over frequency of the model's power, of which an unknown phase makes up for what delays turn, and by how
    much the energy of links (L,) bends with their delays, from `moments` of that power."""
    middle = moments[:, :, 1] / np.maximum(moments[:, :, 0], 1e-300) if heard.phase != "none" else np.zeros(moments.shape[:2])
    return middle, (moments[:, :, 2] - 2 * middle * moments[:, :, 1] + middle**2 * moments[:, :, 0]).sum(axis=1)


def _delay_step(heard: Heard, sums: np.ndarray, middle: np.ndarray, bend: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """One Gauss-Newton step of the delays (L,) from `sums` of model and sounding, in phase, for a model that is `gain` (L,) as
    strong as it was."""
    top = (middle * sums[:, :, 0].imag - sums[:, :, 1].imag).sum(axis=1) * gain
    bottom = np.maximum(bend * gain**2, _FAINT)
    return _shared(np.where(bottom > _FAINT, top / bottom, 0.0), heard, bottom)


def tangents(heard: Heard, model: np.ndarray) -> np.ndarray:
    """Derivatives (n, L, T, K) of the model after every unknown gain and delay; phases are projected out by `without_phases`."""
    out = [np.zeros((0, *model.shape), complex)]
    for kind, derivative in ((heard.gain, model), (heard.delay, -1j * heard.omega * model)):
        if kind == "common":
            out.append(derivative[None])
        elif kind == "link":
            out.append(np.eye(len(model))[:, :, None, None] * derivative)
        elif kind == "node":
            out.append(heard.design.T[:, :, None, None] * derivative)
    return np.concatenate(out)


def without_phases(heard: Heard, model: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Derivatives (..., L, T, K) less their parts along the unknown phases."""
    if heard.phase == "none":
        return columns
    axes = (-1,) if heard.phase == "snapshot" else (-2, -1)
    along = ((columns * model.conj()).imag * heard.weight).sum(axis=axes, keepdims=True)
    power = ((model.real**2 + model.imag**2) * heard.weight).sum(axis=axes, keepdims=True)
    return columns - 1j * model * (along / np.maximum(power, 1e-300))
