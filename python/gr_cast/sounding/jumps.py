# SPDX-License-Identifier: GPL-3.0-or-later
"""Jumps of the code's phase: a transmitter that ran out of samples goes on with its code later. All paths then move alike and
at once, which no channel does."""

import numpy as np
from scipy.fft import irfft, rfft
from scipy.special import gammainccinv, gammaincinv

from .correlate import Template

BLOCKS = 128  # of periods, between which a jump is looked for first
CHUNK = 1 << 20  # samples that are correlated at once
CHANCE = 1e-6  # that noise alone looks like a path at some delay of a profile
ALIKE, ALIKE_NEAR = 0.9, 0.6  # coherence of two delay profiles that are one, shifted: of all on either side, of a few blocks
NEAR = 8  # blocks on either side that are compared first
RATHER = 2.0  # by which they must be more alike shifted than where they stand
LEAST_SAMPLES = 2  # of a jump; one is a clock's slip
STEADY = 0.95  # coherence with the mean delay profile, above which a profile is of the same channel and code


def is_steady(profiles: np.ndarray) -> bool:
    """Whether delay profiles (delays, blocks) are all alike: nothing has jumped, and nobody needs to look period by period."""
    whole = profiles.sum(axis=1)
    alike = whole @ profiles / np.maximum(np.linalg.norm(whole) * np.linalg.norm(profiles, axis=0), 1e-300)
    return bool(alike.min() > STEADY)


def code_jumps(samples: np.ndarray, template: Template) -> list[tuple[int, int]]:
    """[(first period behind a jump, samples by which the code comes later from there on)] in whole periods `samples` (periods,
    length), free of a carrier offset. The period that holds the jump belongs to neither side."""
    count = len(samples)
    if count < 4:
        return []
    edges = np.unique(np.linspace(0, count, min(BLOCKS, count // 2) + 1).astype(int))
    profiles = np.array([_profile(samples[a:b], template) for a, b in zip(edges[:-1], edges[1:], strict=True)])
    found = []
    for block, shift in _splits(profiles):
        begin, end = edges[max(block - 1, 0)], edges[min(block + 1, len(profiles))]
        before, after = profiles[max(block - 2, 0) : max(block - 1, 1)].sum(axis=0), profiles[block + 1 : block + 3].sum(axis=0)
        after = after if after.any() else np.roll(before, shift)
        found.append((begin + _between(samples[begin:end], template, before, after), shift))
    return found


def _profile(samples: np.ndarray, template: Template) -> np.ndarray:
    """(length,) mean power of the impulse responses of some periods, 0 where there is noise alone."""
    step = max(1, CHUNK // samples.shape[1])
    power = sum(np.sum(np.abs(template.matched_filter(part.T)) ** 2, axis=1) for part in _pieces(samples, step)) / len(samples)
    count = len(samples)
    noise = np.median(power) / gammaincinv(count, 0.5)  # of one period, over their number: sums of so many exponential variables
    return np.where(power > noise * gammainccinv(count, CHANCE), power - count * noise, 0.0)


def _pieces(samples: np.ndarray, step: int):
    return (samples[k : k + step] for k in range(0, len(samples), step))


def _shifted(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(length,) Σ a[d]·b[d + shift] for every shift around the period."""
    return irfft(np.conj(rfft(a)) * rfft(b), len(a))


def _splits(profiles: np.ndarray) -> list[tuple[int, int]]:
    """[(block behind a jump, shift in samples)], in order."""
    sums = np.concatenate([np.zeros((1, profiles.shape[1])), np.cumsum(profiles, axis=0)])
    part = lambda a, b: sums[min(b, len(profiles))] - sums[max(a, 0)]  # noqa: E731
    candidates = []
    for k in range(1, len(profiles)):
        shift, lead = _shift(part(k - NEAR, k), part(k, k + NEAR), ALIKE_NEAR)
        if shift and candidates and k - candidates[-1][0] <= NEAR:
            candidates[-1] = max(candidates[-1], (k, lead), key=lambda c: c[1])
        elif shift:
            candidates.append((k, lead))
    edges, found = [0, *(k for k, _ in candidates), len(profiles)], []
    for before, here, after in zip(edges, edges[1:], edges[2:], strict=False):
        shift, _ = _shift(part(before, here), part(here, after), ALIKE)
        if shift:
            found.append((here, shift))
    return found


def _shift(before: np.ndarray, after: np.ndarray, alike: float) -> tuple[int, float]:
    """(samples by which a delay profile is another one, later; 0: it is not, coherence that the shift gains)."""
    moved, size = _shifted(before, after), np.sqrt((before @ before) * (after @ after))
    best, length = int(np.argmax(moved)), len(before)
    shift = (best + length // 2) % length - length // 2
    if size == 0 or abs(shift) < LEAST_SAMPLES or moved[best] < max(alike * size, RATHER * moved[0]):
        return 0, 0.0
    return shift, float((moved[best] - moved[0]) / size)


def _between(samples: np.ndarray, template: Template, before: np.ndarray, after: np.ndarray) -> int:
    """The first of some periods (n, length) that has the delay profile `after` and no more of `before`."""
    power = np.abs(template.matched_filter(samples.T)) ** 2
    gain = before @ power / np.linalg.norm(before) - after @ power / np.linalg.norm(after)
    return int(np.argmax(np.concatenate([[0.0], np.cumsum(gain)])))


def longest_run(jumps: list[tuple[int, int]], count: int) -> slice:
    """The longest stretch of `count` periods without a jump; next to one a period on either side is left out."""
    edges = [0, *(k for k, _ in jumps), count]
    runs = [(a + (a > 0), b - (b < count)) for a, b in zip(edges[:-1], edges[1:], strict=True)]
    begin, end = max(runs, key=lambda run: run[1] - run[0])
    return slice(begin, max(end, begin + 1))
