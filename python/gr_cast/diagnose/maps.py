# SPDX-License-Identifier: GPL-3.0-or-later
"""What a finding shows of the residual, before (twin) and after (corrected): the maps behind the pictures, and the steps
of the residual's power from cause to cause."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft

from ..twin.effects import FAMILIES
from .fit import solve, with_noise
from .policy import MAP_FEWEST, MAP_LEVELS
from .residual import delay_time


@dataclass(frozen=True, kw_only=True)
class Maps:
    """Residual of one fit as power over the noise floor (linear), and the curve of the signal path.

    `time_frequency` (times, bins) with bins from −rate/2 up; `delay_time` (segments, delays) at `delay_s`; `amplitude`
    (k,) of the prediction over its rms, `gain` (k,) complex, recorded over predicted, `gain_std` (k,) of its real part;
    `position` (m,) power at each place of the period, empty for a waveform sent once.
    """

    time_frequency: np.ndarray
    delay_s: np.ndarray
    delay_time: np.ndarray
    amplitude: np.ndarray
    gain: np.ndarray
    gain_std: np.ndarray
    position: np.ndarray


def before_and_after(finding, floor: float) -> tuple[Maps, Maps]:
    """The maps of the twin's fit and of the corrected twin's, over the same delays and samples: a stretch that the search was
    made without is shown too."""
    longest = max(p.delay for p in finding.fit.chain.paths)
    after = replace(finding.fit, data=replace(finding.fit.data, use=finding.twin.data.use))
    return maps_of(finding.twin, floor, longest), maps_of(after, floor, longest)


def maps_of(fit, floor: float, longest: float = 0.0) -> Maps:
    """The maps of a fit; `floor` is the noise power that levels are relative to, `longest` a delay that is to be seen."""
    delay_s, paths = delay_time(fit, longest=longest)
    amplitude, gain, std = _transfer(fit)
    return Maps(
        time_frequency=_time_frequency(fit) / floor,
        delay_s=delay_s,
        delay_time=paths * fit.sigma2 / floor,
        amplitude=amplitude,
        gain=gain,
        gain_std=std,
        position=_place_in_period(fit) / floor,
    )


def _time_frequency(fit, rows: int = 64, bins: int = 48) -> np.ndarray:
    """(rows, bins) mean power of the residual as it is, by time and frequency from −rate/2 up; NaN where nothing is used."""
    use, residual = (fit.data.scene.spread(x) for x in (fit.data.use > 0, fit.residual))
    n = len(use)
    rows = max(1, min(rows, n // bins))
    length = n // rows // bins * bins
    firsts = np.linspace(0, n - length, rows).astype(int)
    out = np.full((rows, bins), np.nan)
    for row, first in enumerate(firsts):
        used = use[first : first + length].reshape(-1, bins)
        if used.any():
            blocks = (residual[first : first + length] * used.ravel()).reshape(-1, bins)
            out[row] = np.sum(np.abs(sp_fft.fft(blocks, axis=1)) ** 2, axis=0) / used.sum()
    return sp_fft.fftshift(out, axes=1)


def _transfer(fit):
    """Mean complex gain from prediction to recording in cells of the prediction's amplitude."""
    use = fit.data.use > 0
    said, recorded = fit.chain.y[use], fit.data.y[use]
    level = np.abs(said)
    rms = max(float(np.sqrt(np.mean(level**2))), 1e-30)
    edges = np.linspace(level.min(), level.max() * (1 + 1e-9), MAP_LEVELS + 1)
    cell = np.clip(np.searchsorted(edges, level, side="right") - 1, 0, MAP_LEVELS - 1)
    hits, energy = np.bincount(cell, minlength=MAP_LEVELS), np.bincount(cell, level**2, MAP_LEVELS)
    product = recorded * np.conj(said)
    gain = (np.bincount(cell, product.real, MAP_LEVELS) + 1j * np.bincount(cell, product.imag, MAP_LEVELS)) / np.maximum(
        energy, 1e-300
    )
    kept = (hits >= MAP_FEWEST) & (energy > 1e-6 * energy.max())
    amplitude = np.sqrt(energy / np.maximum(hits, 1)) / rms
    return amplitude[kept], gain[kept], np.sqrt(fit.sigma2 / 2 / energy[kept])


def _place_in_period(fit) -> np.ndarray:
    """(period,) mean power of the residual at each place of a repeated waveform, at most 512 places."""
    source = fit.data.scene.sources[0]
    period = len(source.samples)
    if not source.repeat or fit.data.scene.count < 2 * period:
        return np.zeros(0)
    cells = min(period, 512)
    index = (fit.data.scene.wrap(period) * cells) // period
    use = fit.data.use > 0
    power = np.bincount(index[use], np.abs(fit.residual[use]) ** 2, cells)
    return power / np.maximum(np.bincount(index[use], minlength=cells), 1)


def steps(finding) -> list[tuple[int, float]] | None:
    """[(index of an effect, power of the residual once it and those before it are in the model)], the strongest first, worked out
    once; None where that is not told by the deadline of the finding's data.

    Effects that change the noise alone have no place here.
    """
    if finding.steps is None and not finding.data.late:
        finding.steps = _steps(finding)
    return finding.steps


def _steps(finding) -> list[tuple[int, float]] | None:
    fit, deadline = finding.fit, finding.data.deadline
    told = [i for i, e in enumerate(fit.model.effects) if not (e.fixed or FAMILIES[e.family].noise_like or "nats" in e.aux)]
    order = sorted(told, key=lambda i: -finding.gain_of(i))
    out = []
    for k in range(1, len(order)):
        inside = set(order[:k])
        kept = tuple(e for i, e in enumerate(fit.model.effects) if e.fixed or i in inside)
        model = replace(fit.model, effects=kept)
        part = solve(replace(with_noise(fit, model), deadline=deadline), model, iterations=3)
        if part.data.late:  # it may stand where it began
            return None
        out.append((order[k - 1], power_of(part)))
    return out + [(i, power_of(fit)) for i in order[-1:]]


def power_of(fit) -> float:
    """Mean power of a fit's residual, over the samples used."""
    return float(np.mean(np.abs(fit.residual[fit.data.use > 0]) ** 2))
