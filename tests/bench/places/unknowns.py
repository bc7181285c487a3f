# SPDX-License-Identifier: GPL-3.0-or-later
"""Energy that a prediction leaves in soundings after what they do not claim to know is fitted: phases, delays, gains."""

import numpy as np

ROUNDS = 12


def excess(model, data, noise_power, links, frequency_hz, unknown, near=False):
    """(residual energy over noise variance, fitted model): best constants of `unknown` {phase, delay, gain}.

    `near`: the delays are small, so that no grid has to find them.
    """
    f = np.asarray(frequency_hz, float)
    weight = np.isfinite(data) / np.asarray(noise_power, float)[:, None, None]
    y, h = np.where(np.isfinite(data), data, 0), np.asarray(model, complex)
    phase, delay, gain = (unknown.get(k, "none") for k in ("phase", "delay", "gain"))
    nodes = sorted({n for link in links for n in link})
    has = np.array([[n in link for n in nodes] for link in links], float)
    fitted, level, late, before = h, np.zeros(len(links)), np.zeros(len(links)), np.inf
    if delay != "none" and not near:
        late = _coarse_delay(h, y, weight, f, phase, has, delay)
    for _ in range(ROUNDS):
        fitted = _turned(h * np.exp(level[:, None, None] - 2j * np.pi * f * late[:, None, None]), y, weight, phase)
        energy = float((weight * np.abs(y - fitted) ** 2).sum())
        if before - energy < 1e-3 + (1e-3 if near else 1e-6) * energy or (gain, delay) == ("none", "none"):
            break
        before = energy
        if gain != "none":
            top, norm = (weight * (y * fitted.conj()).real).sum((1, 2)), (weight * np.abs(fitted) ** 2).sum((1, 2))
            level = level + _gains(top, norm, has, gain)
            fitted = _turned(h * np.exp(level[:, None, None] - 2j * np.pi * f * late[:, None, None]), y, weight, phase)
        if delay != "none":
            late = late + _delay_step(fitted, y, weight, f, phase, has, delay)
    return energy, fitted


def _turned(h, y, weight, phase):
    """The model with the best phases."""
    if phase == "none":
        return h
    inner = (weight * y * h.conj()).sum(2 if phase == "snapshot" else (1, 2), keepdims=True)
    return h * np.exp(1j * np.angle(inner))


def _gains(top, norm, has, gain):
    """Step of log amplitudes of links: least squares of ln(top / norm), weighted by energy; one for all, or a sum over nodes."""
    good = norm > 0
    if gain == "common":
        ratio = top.sum() / max(norm.sum(), 1e-300)
        return np.full(len(top), np.log(np.clip(ratio, 0.05, 20)))
    ratio = np.log(np.clip(np.where(good, top / np.where(good, norm, 1), 1), 0.2, 5))
    root = np.sqrt(norm)[:, None]
    return has @ np.linalg.lstsq(has * root, ratio * root[:, 0], rcond=1e-9)[0]


def _coarse_delay(h, y, weight, f, phase, has, delay):
    """Delays that align model and data best, on a grid finer than the band resolves: of each link, or node after node."""
    grid = np.arange(-4 * len(f), 4 * len(f) + 1) / (8 * len(f) * (f[1] - f[0]))
    cross = weight * y * h.conj()

    turns = np.exp(2j * np.pi * f[:, None] * grid)

    def scores(late, mine=slice(None)):  # (L, G)
        sums = (cross[mine] * np.exp(2j * np.pi * f * late[mine, None, None])) @ turns
        if phase == "snapshot":
            return np.abs(sums).sum(1)
        return np.abs(sums.sum(1)) if phase == "link" else sums.sum(1).real

    late = grid[np.argmax(scores(np.zeros(len(h))), 1)]
    if delay == "link":
        return late
    best, gain = np.zeros(len(h)), -np.inf
    loud = np.sqrt((weight * np.abs(h) ** 2).sum((1, 2)))[:, None]
    trust, robust = loud, None
    for _ in range(20):  # least absolute errors: a link whose peak is another's does not pull the rest
        robust = np.linalg.lstsq(has * trust, late * trust[:, 0], rcond=None)[0]
        trust = np.sqrt(loud / (np.abs(late - has @ robust) + 1e-12)[:, None])
    for begin in (np.zeros(has.shape[1]), robust):
        of_node = begin.copy()
        for node in [*range(has.shape[1])] * 3:
            mine = has[:, node] > 0
            of_node[node] += grid[np.argmax(scores(has @ of_node, mine).sum(0))]
        top = scores(has @ of_node)[:, 4 * len(f)].sum()
        if top > gain:
            best, gain = has @ of_node, top
    return best


def _delay_step(fitted, y, weight, f, phase, has, delay):
    """One Gauss-Newton step of the delays; the best phase moves with them."""
    slope = -2j * np.pi * f * fitted
    if phase != "none":
        axis = 2 if phase == "snapshot" else (1, 2)
        power = (weight * np.abs(fitted) ** 2).sum(axis, keepdims=True)
        shift = (weight * np.imag(slope * fitted.conj())).sum(axis, keepdims=True) / np.where(power > 0, power, 1)
        slope = slope - 1j * shift * fitted
    top = (weight * (slope.conj() * (y - fitted)).real).sum((1, 2))
    norm = (weight * np.abs(slope) ** 2).sum((1, 2))
    if delay == "link":
        return np.where(norm > 0, top / np.where(norm > 0, norm, 1), 0)
    left = (has * norm[:, None]).T @ has
    return has @ np.linalg.lstsq(left, has.T @ top, rcond=1e-9)[0]
