# SPDX-License-Identifier: GPL-3.0-or-later
"""Filters as a ratio of two polynomials in z⁻¹, and which of them is between two signals: read off their spectra first
(Sanathanan and Koerner 1963), then settled on the samples.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft as sp_fft
from scipy import linalg
from scipy import signal as sp_signal

from .interpolate import TAU

ORDERS = (1, 2, 3, 4, 5, 6, 8)
FIRST = -12  # earliest lag of the first tap of B: the delay that was fitted is that of the filter too
MORE_TAPS = 3  # of B than poles: for a delay between two samples
ROUNDS = 6  # of the ratio's weights
STEPS = 40  # of a ratio that settles, at most
SHARES = (1.0, 0.3, 0.1)  # of a step
SETTLED = 0.9999  # of the energy, that the next step leaves at least
BEGUN = 2  # places of the first tap, of each order, from which one does
MOST = 1 << 13  # samples in which all orders do
MOST_OF_THE_BEST = 1 << 15  # in which the best do
ROUNDING = 1e-12  # of the largest, that is nothing
LEAST_POWER = 1e-12  # of a bin, over that of the strongest
SEGMENT = 512  # samples in which it is read off
LEAST_SEGMENTS = 16
CLEAR = 6.0  # standard deviations by which the residual must have more of the wanted signal than noise has
MUCH = 0.1  # of the residual, that must be of the wanted signal: else other causes come first, and a row of taps is enough
BEST = 2  # ratios that are tried
FURTHER = 3  # orders, none of which is better than one before, behind which there is no better one
LONGEST, SHORTEST = 0.9995, 0.01  # radius of a pole
UNHEARD = 1e-30  # of what rings
SMALLEST = 1e-300  # for what may be nothing


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """Σ taps[k]·z^−(low + k) over Σ feedback[k]·z^−k, feedback[0] = 1, every pole within LONGEST."""

    low: int
    taps: np.ndarray
    feedback: np.ndarray

    @property
    def slowest(self) -> float:
        """Radius of the pole that rings longest."""
        return float(np.abs(np.roots(self.feedback)).max())

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """Of frequencies, shares of the sample rate."""
        above, below = _powers(frequency, self.low, len(self.taps)), _powers(frequency, 0, len(self.feedback))
        return above @ self.taps / (below @ self.feedback)

    def behind(self, y: np.ndarray) -> np.ndarray:
        """A signal behind it that was silence before."""
        return sp_signal.lfilter(self.taps, self.feedback, np.concatenate([y, np.zeros(-self.low)]))[-self.low :]

    def ringing(self, left: np.ndarray, count: int) -> np.ndarray:
        """(count,) what rings on from `left` (k,), what comes out first: as long as there is anything of it (denormal numbers
        take a hundred times as long)."""
        longest = min(count, len(left) + int(np.log(UNHEARD) / np.log(max(self.slowest, SHORTEST))) + 1)
        heard = np.zeros(count, complex)
        heard[:longest] = sp_signal.lfilter(left, self.feedback, np.eye(1, longest)[0])
        return heard

    def around(self, wave: np.ndarray) -> np.ndarray:
        """A wave behind it that goes round."""
        response = sp_fft.fft(self.taps, len(wave)) / sp_fft.fft(self.feedback, len(wave))
        return np.roll(sp_fft.ifft(sp_fft.fft(wave) * response), self.low)


def _powers(frequency: np.ndarray, low: int, count: int) -> np.ndarray:
    return np.exp(-1j * TAU * np.outer(frequency, low + np.arange(count)))


def monic(feedback) -> np.ndarray:
    """(k + 1,) a polynomial whose first coefficient is 1, of Re and Im of each of the others."""
    return np.concatenate([[1.0], np.asarray(feedback, float).view(complex)])


def stable(feedback: np.ndarray) -> np.ndarray:
    """The polynomial with its poles within LONGEST: those outside the unit circle inside it, where they have the same response
    but for its phase."""
    poles = np.roots(feedback)
    radius = np.maximum(np.abs(poles), SMALLEST)
    inside = np.where(radius > 1, 1 / np.maximum(radius, 1.0), radius)
    return feedback if radius.max(initial=0.0) <= LONGEST else np.poly(poles / radius * np.minimum(inside, LONGEST))


def read_off(wanted: np.ndarray, left: np.ndarray, use: np.ndarray) -> list[Ratio]:
    """The ratios behind which the signal `wanted` (n,) leaves least of itself and of the residual `left` (n,), zero where samples
    are not in `use` (n,) bool, of the orders that pay; none where the residual has no more of it than noise has."""
    told = _response(wanted * use, left)
    if told is None:
        return []
    few = _loudest(wanted * use, MOST)
    heard, found = left + wanted * use, []
    for order in ORDERS:
        begun = sorted((_fitted(*told, order, low) for low in range(FIRST, 1)), key=lambda one: one[0])[:BEGUN]
        found.append(min((_priced(ratio, wanted[few], heard[few], use[few]) for _, ratio in begun), key=lambda one: one[0]))
        if min(found[-FURTHER:], key=lambda one: one[0])[0] > min(found, key=lambda one: one[0])[0]:
            break
    many = _loudest(wanted * use, MOST_OF_THE_BEST)
    best = (_trimmed(one, wanted[few], heard[few], use[few]) for one in sorted(found, key=lambda one: one[0])[:BEST])
    return [_settled(ratio, wanted[many], heard[many], use[many])[1] for ratio in best]


def _priced(ratio: Ratio, wanted, heard, use) -> tuple[float, Ratio]:
    """(−ln L and the price of its numbers, the ratio) that settles from one."""
    energy, ratio = _settled(ratio, wanted, heard, use)
    count = np.count_nonzero(use)
    return float(count * np.log(energy + SMALLEST) + np.log(count) * (len(ratio.taps) + len(ratio.feedback))), ratio


def _trimmed(priced: tuple[float, Ratio], wanted, heard, use) -> Ratio:
    """The ratio without the taps at its ends that do not pay."""
    cost, ratio = priced
    while len(ratio.taps) > 2:
        ends = [replace(ratio, taps=ratio.taps[:-1])]
        ends += [replace(ratio, low=ratio.low + 1, taps=ratio.taps[1:])] * (ratio.low < 0)
        less = min((_priced(one, wanted, heard, use) for one in ends), key=lambda one: one[0])
        if less[0] > cost:
            break
        cost, ratio = less
    return ratio


def _loudest(signal: np.ndarray, most: int) -> slice:
    """The stretch of so many samples at most in which most of a signal is."""
    energy = np.cumsum(np.abs(signal) ** 2)
    first = int(np.argmax(energy[most:] - energy[:-most])) if len(energy) > most else 0
    return slice(first, first + most)


def _response(wanted, left) -> tuple[np.ndarray, np.ndarray] | None:
    """((SEGMENT,) what becomes of the wanted signal in each bin, (SEGMENT,) how well that is known: the root of its inverse
    variance); None where the residual has no more of the wanted signal than noise has."""
    segments = len(wanted) // (SEGMENT // 2) - 1
    if segments < LEAST_SEGMENTS:
        return None
    window = np.hanning(SEGMENT)
    at = np.arange(segments)[:, None] * (SEGMENT // 2) + np.arange(SEGMENT)
    sent, heard = (sp_fft.fft(signal[at] * window, axis=1) for signal in (wanted, left))
    power, common = np.sum(np.abs(sent) ** 2, 0), np.sum(heard * np.conj(sent), 0)
    power = np.maximum(power, LEAST_POWER * power.max())
    noise = (np.sum(np.abs(heard) ** 2) - np.sum(np.abs(common) ** 2 / power)) / (SEGMENT * (segments - 1))
    weight = power / max(noise, LEAST_POWER * power.mean() / segments)
    told = 0.5 * np.sum(weight * np.abs(common / power) ** 2)  # each bin is in two segments
    is_clear = told - SEGMENT / 2 > CLEAR * np.sqrt(SEGMENT / 2)
    is_much = np.sum(np.abs(common) ** 2 / power) > MUCH * np.sum(np.abs(heard) ** 2)
    return (1 + common / power, np.sqrt(weight)) if is_clear and is_much else None


def _fitted(response, root, order: int, low: int) -> tuple[float, Ratio]:
    """(what it leaves, the ratio) of an order that is nearest to a response, its first tap at `low`."""
    frequency, count = np.arange(len(response)) / len(response), order + 1 + MORE_TAPS
    top, under = _powers(frequency, low, count), _powers(frequency, 1, order)
    columns, feedback = np.concatenate([top, -response[:, None] * under], axis=1), np.eye(1, order + 1)[0]
    best = (np.inf, Ratio(low=low, taps=np.eye(1, count)[0], feedback=feedback))
    for _ in range(ROUNDS):
        scale = root / np.abs(1 + under @ feedback[1:])
        numbers = _least_squares((columns * scale[:, None]).T, response * scale)
        feedback = stable(np.concatenate([[1.0], numbers[count:]]))
        ratio = Ratio(low=low, taps=numbers[:count], feedback=feedback)
        left = float(np.linalg.norm(root * (response - top @ ratio.taps / (1 + under @ feedback[1:]))))
        best = min(best, (left, ratio), key=lambda one: one[0])
    return best


def _settled(ratio: Ratio, wanted, heard, use) -> tuple[float, Ratio]:
    """(energy left, the ratio) that leaves least of the samples `heard`, of those in `use`, near one: its taps at their least
    squares, its feedback by steps of Gauss and Newton, shorter ones where those lead astray."""
    energy, best, rows = _with_taps(ratio, wanted, heard, use)
    for _ in range(STEPS):
        twice = replace(best, low=0, taps=np.ones(1)).behind(best.behind(wanted))
        fed = np.array([-_late(twice, k) for k in range(1, len(best.feedback))])[:, use]
        step = np.concatenate([[0.0], _least_squares(np.concatenate([rows, fed]), heard[use])[len(rows) :]])
        for share in SHARES:
            now = _with_taps(replace(best, feedback=stable(best.feedback + share * step)), wanted, heard, use)
            if now[0] < energy:
                break
        if now[0] > SETTLED * energy:
            break
        energy, best, rows = now
    return energy, best


def _with_taps(ratio: Ratio, wanted, heard, use) -> tuple[float, Ratio, np.ndarray]:
    """(energy left, the ratio with its taps at their least squares, what each of them and of what rings on from before the first
    sample makes of the samples in use)."""
    plain = replace(ratio, low=0, taps=np.ones(1))
    once, ringing = plain.behind(wanted), ratio.ringing(np.ones(1), len(wanted))
    rows = [_late(once, ratio.low + k) for k in range(len(ratio.taps))]
    rows = np.array(rows + [_late(ringing, k) for k in range(len(ratio.feedback) - 1)])[:, use]
    found = _least_squares(rows, heard[use])
    return float(np.linalg.norm(heard[use] - found @ rows) ** 2), replace(ratio, taps=found[: len(ratio.taps)]), rows


def _least_squares(rows: np.ndarray, heard: np.ndarray) -> np.ndarray:
    """(k,) the factors under which `rows` (k, n) add up to what was heard (n,)."""
    scale = np.linalg.norm(rows, axis=1) + SMALLEST
    rows = rows / scale[:, None]
    return linalg.lstsq(rows.conj() @ rows.T, rows.conj() @ heard, cond=ROUNDING, check_finite=False)[0] / scale


def _late(signal: np.ndarray, lag: int) -> np.ndarray:
    """A signal so many samples later, silence where it is not known."""
    out = np.zeros_like(signal)
    out[max(lag, 0) : len(out) + min(lag, 0)] = signal[max(-lag, 0) : len(out) - max(lag, 0)]
    return out
