# SPDX-License-Identifier: GPL-3.0-or-later
"""How well a predicted response explains a sounding, after what the sounding does not claim to know is fitted.

The residual is circular noise of known power, so that −ln p is the energy E = Σ|Y − g·H|²/noise up to a constant: nats.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ive

_ROUNDS = 4  # of gains and delays, which are Gauss-Newton steps near the optimum
_FAR = 1e6  # of a Bessel function's argument, beyond which its asymptote stands
_FINER = 8  # of the grid of delays over the resolution of the band


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

    @property
    def count(self) -> int:
        return int((self.weight > 0).sum())

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
    links, (shape_l, shape_t, _) = heard.links, h.shape
    delay_s = np.zeros(shape_l)
    if heard.delay != "none":
        delay_s = _shared(_delays(heard, h), heard, heard.delay, (np.abs(h) ** 2 * heard.weight).sum(axis=(1, 2)))
    log_gain = np.zeros(shape_l)
    omega = 2 * np.pi * heard.frequency_hz
    factor = np.ones((shape_l, shape_t, 1), complex)
    rounds = _ROUNDS if heard.gain != "none" or heard.delay != "none" else 1
    turned = h
    for number in range(rounds):
        turned = h if heard.delay == "none" else h * np.exp(-1j * delay_s[:, None, None] * omega)
        cross = (turned.conj() * heard.y * heard.weight).sum(axis=2)  # (L, T)
        factor = _phases(cross, heard.phase)[:, :, None]
        power = (np.abs(turned) ** 2 * heard.weight).sum(axis=2)
        if heard.gain != "none":
            wanted = (cross * factor[:, :, 0].conj()).real.sum(axis=1)
            have = power.sum(axis=1)
            ratio = np.where(
                have > 0, np.maximum(wanted, 1e-6 * have) / np.where(have > 0, have, 1), 1
            )  # 1: nothing is predicted
            if heard.gain == "common":
                log_gain = np.full(shape_l, np.log(max(wanted.sum(), 1e-6 * have.sum(), 1e-300) / max(have.sum(), 1e-300)))
            else:
                log_gain = _gains(ratio, have, log_gain if number else None, links)
        if heard.delay != "none" and number + 1 < rounds:
            delay_s = delay_s + _delay_step(heard, turned * factor * np.exp(log_gain)[:, None, None], omega)
    factor = factor * np.exp(log_gain)[:, None, None]
    if heard.delay != "none":
        factor = factor * np.exp(-1j * delay_s[:, None, None] * omega)
    model = h * factor
    residual = np.where(heard.weight > 0, heard.y - model, 0)
    turns = _turns_nats(heard, model)
    energy = float((np.abs(residual) ** 2 * heard.weight).sum()) + turns
    return Fitted(model=model, residual=residual, energy=energy, factor=np.broadcast_to(factor, h.shape), offset=turns)


def _turns_nats(heard: Heard, model: np.ndarray) -> float:
    """What the unknown phases took: −ln p is the mean over all that a phase may be, not of the best of them. Without it, a faint
    echo where the twin has nothing would gain from noise in every snapshot."""
    if heard.phase == "none":
        return 0.0
    cross = np.abs((model.conj() * heard.y * heard.weight).sum(axis=2 if heard.phase == "snapshot" else (1, 2)))
    near, far = np.minimum(2 * cross, _FAR), np.maximum(2 * cross, _FAR)
    return float(np.where(2 * cross < _FAR, -np.log(ive(0, near)), 0.5 * np.log(2 * np.pi * far)).sum())


def _phases(cross: np.ndarray, kind: str) -> np.ndarray:
    if kind == "none":
        return np.ones(cross.shape, complex)
    if kind == "link":
        cross = np.broadcast_to(cross.sum(axis=1, keepdims=True), cross.shape)
    size = np.abs(cross)
    return np.where(size > 0, cross / np.where(size > 0, size, 1), 1)


def incidence(links) -> np.ndarray:
    names = sorted({name for link in links for name in link})
    out = np.zeros((len(links), len(names)))
    for row, link in enumerate(links):
        for name in link:
            out[row, names.index(name)] += 1
    return out


def _gains(ratio: np.ndarray, have: np.ndarray, before: np.ndarray | None, links) -> np.ndarray:
    """Log gains per node, summed per link: weighted least squares of ln(ratio), then Gauss-Newton in amplitude."""
    design = incidence(links)
    if before is None:
        root = np.sqrt(have) * np.minimum(ratio, 1 / np.maximum(ratio, 1e-12))
        return design @ np.linalg.lstsq(root[:, None] * design, root * np.log(ratio), rcond=1e-9)[0]
    now = np.exp(before)
    root = np.sqrt(have) * now
    step = np.linalg.lstsq(root[:, None] * design, np.sqrt(have) * (ratio - now), rcond=1e-9)[0]
    return before + np.clip(design @ step, -1, 1)


def _shared(delay_s: np.ndarray, heard: Heard, kind: str, weight: np.ndarray) -> np.ndarray:
    if kind == "link":
        return delay_s
    design, root = incidence(heard.links), np.sqrt(weight)
    return design @ np.linalg.lstsq(root[:, None] * design, root * delay_s, rcond=1e-9)[0]


def _delays(heard: Heard, h: np.ndarray) -> np.ndarray:
    """The best delay per link from the whole range that the steps of frequency tell apart."""
    count = len(heard.frequency_hz)
    size = 1 << int(np.ceil(np.log2(_FINER * count)))
    profile = np.fft.ifft(h.conj() * heard.y * heard.weight, size, axis=2)
    if heard.phase == "snapshot":
        score = np.abs(profile).sum(axis=1)
    else:
        score = np.abs(profile.sum(axis=1)) if heard.phase == "link" else profile.sum(axis=1).real
        if heard.phase == "none":  # the grid starts at the first frequency
            grid_s = np.fft.fftfreq(size, heard.spacing_hz)
            ramp = np.exp(2j * np.pi * heard.frequency_hz[0] * grid_s)
            score = (profile.sum(axis=1) * ramp).real
    return np.fft.fftfreq(size, heard.spacing_hz)[np.argmax(score, axis=1)]


def _delay_step(heard: Heard, model: np.ndarray, omega: np.ndarray) -> np.ndarray:
    power = np.abs(model) ** 2 * heard.weight
    residual = np.where(heard.weight > 0, heard.y - model, 0)
    if heard.phase == "none":
        centred = np.broadcast_to(omega, model.shape)
    else:
        axes = (2,) if heard.phase == "snapshot" else (1, 2)
        total = power.sum(axis=axes, keepdims=True)
        centred = omega - (power * omega).sum(axis=axes, keepdims=True) / np.maximum(total, 1e-300)
    tangent = -1j * centred * model
    top = ((tangent.conj() * residual).real * heard.weight).sum(axis=(1, 2))
    bottom = np.maximum((centred**2 * power).sum(axis=(1, 2)), 1e-300)
    if heard.delay == "link":
        return top / bottom
    design, root = incidence(heard.links), np.sqrt(bottom)
    return design @ np.linalg.lstsq(root[:, None] * design, root * top / bottom, rcond=1e-9)[0]


def tangents(heard: Heard, model: np.ndarray) -> list[np.ndarray]:
    """Derivatives (L, T, K) of the model after every unknown gain and delay; phases are projected out by `without_phases`."""
    omega, out = 2 * np.pi * heard.frequency_hz, []
    for kind, derivative in ((heard.gain, model), (heard.delay, -1j * omega * model)):
        if kind == "common":
            out.append(derivative)
        elif kind == "link":
            for row in range(len(heard.links)):
                column = np.zeros_like(model)
                column[row] = derivative[row]
                out.append(column)
        elif kind == "node":
            for weights in incidence(heard.links).T:
                out.append(derivative * weights[:, None, None])
    return out


def without_phases(heard: Heard, model: np.ndarray, column: np.ndarray) -> np.ndarray:
    """A derivative less its part along the unknown phases."""
    if heard.phase == "none":
        return column
    axes = (2,) if heard.phase == "snapshot" else (1, 2)
    along = ((column * model.conj()).imag * heard.weight).sum(axis=axes, keepdims=True)
    power = (np.abs(model) ** 2 * heard.weight).sum(axis=axes, keepdims=True)
    return column - 1j * model * (along / np.maximum(power, 1e-300))
