# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a recording jumps against a waveform of which only pieces are known: samples were lost or inserted between them."""

import numpy as np
from scipy import fft as sp_fft
from scipy import ndimage

from ..twin.interpolate import TAU, phasor
from .policy import (
    HERE,
    LONGEST_PIECE,
    MOST_PIECES,
    PIECES_FEWEST,
    PIECES_JUMP_NATS,
    PIECES_LEAST_PIECE,
    REACH,
    SPREAD,
    STEP_NATS,
)


def segments(samples, waveforms, delay: int) -> list[tuple[int, int, int]]:
    """[(first sample, last + 1, delay)] of the stretches of a recording between its jumps against waveforms, NaN where they
    are not known, that begin at `delay`.

    The likeliest course of the lag over the pieces (Viterbi 1967); a piece of N samples whose correlation is ρ speaks for a
    lag with −N·ln(1 − |ρ|²) nats, the likelihood under any gain.
    """
    pieces = _pieces(waveforms[0], delay, len(samples))
    if len(pieces) < 2:
        return [(0, len(samples), delay)]
    turn = _carrier(samples, waveforms[0], delay, pieces)
    told = np.array([sum(_nats(samples, x, delay, a, b, turn) for x in waveforms) for a, b in pieces])
    told[:, REACH - SPREAD : REACH + SPREAD + 1] *= HERE  # pilots on every sixth carrier look alike a sixth of a symbol away
    lags = _course(ndimage.maximum_filter1d(told, 2 * SPREAD + 1, axis=1))
    jumps = np.flatnonzero(np.abs(np.diff(lags)) > SPREAD)
    ends = np.append(jumps, len(lags) - 1)
    jumps = jumps[np.diff(np.concatenate([[-1], ends]))[:-1] >= PIECES_FEWEST]
    jumps = jumps[len(lags) - 1 - jumps >= PIECES_FEWEST]
    if not len(jumps):
        return [(0, len(samples), delay)]
    edges = [0, *((pieces[k][1] + pieces[k + 1][0] + lags[k] + lags[k + 1]) // 2 + delay for k in jumps), len(samples)]
    around = [delay + round(np.median(part)) for part in np.split(lags, jumps + 1)]
    return [(int(a), int(b), at) for a, b, at in zip(edges, edges[1:], around, strict=False)]


def _pieces(x, delay: int, count: int) -> list[tuple[int, int]]:
    """[(first, last + 1)] of the known pieces of a waveform that the recording holds."""
    known = np.isfinite(x[max(0, -delay) : max(0, count - delay)])
    cuts = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(np.int8), [0]]))) + max(0, -delay)
    pieces = []
    for a, b in cuts.reshape(-1, 2):
        edges = np.linspace(a, b, -(-(b - a) // LONGEST_PIECE) + 1).astype(int)
        pieces += [(p, q) for p, q in zip(edges, edges[1:], strict=False) if q - p >= PIECES_LEAST_PIECE and x[p:q].any()]
    return pieces[:: -(-len(pieces) // MOST_PIECES) or 1]


def _carrier(samples, x, delay: int, pieces) -> float:
    """Cycles per sample by which the recording turns against the waveform within the pieces."""
    total = np.zeros(2 * LONGEST_PIECE)
    for a, b in pieces:
        y = samples[max(0, a + delay) : b + delay]
        total += np.abs(sp_fft.fft(y * np.conj(x[b - len(y) : b]), len(total))) ** 2
    return float(sp_fft.fftfreq(len(total))[int(np.argmax(total))])


def _nats(samples, x, delay: int, a: int, b: int, turn: float) -> np.ndarray:
    """(2·REACH + 1,) what a piece from `a` to `b` of a waveform says for every lag around `delay`."""
    first, size = a + delay - REACH, b - a + 2 * REACH
    y = np.zeros(size, complex)
    begin, end = max(first, 0), min(first + size, len(samples))
    if end > begin:
        y[begin - first : end - first] = samples[begin:end]
    y *= phasor(-TAU * turn * np.arange(size))
    block = sp_fft.next_fast_len(size)
    piece = np.nan_to_num(x[a:b])
    c = sp_fft.ifft(sp_fft.fft(y, block) * np.conj(sp_fft.fft(piece, block)))[: 2 * REACH + 1]
    heard = np.cumsum(np.concatenate([[0.0], np.abs(y) ** 2]))
    energy = (heard[b - a :] - heard[: 2 * REACH + 1]) * np.vdot(piece, piece).real
    return -(b - a) * np.log1p(-np.minimum(np.abs(c) ** 2 / np.maximum(energy, 1e-6 * energy.max() + 1e-300), 1 - 1e-9))


def _course(told: np.ndarray) -> np.ndarray:
    """(pieces,) the lags, from −REACH on, of the likeliest course through nats (pieces, lags)."""
    total, came_from = told[0], []
    index = np.arange(told.shape[1])
    for row in told[1:]:
        best = int(np.argmax(total))
        options = np.stack(
            [
                total,
                np.concatenate([[-np.inf], total[:-1]]) - STEP_NATS,
                np.concatenate([total[1:], [-np.inf]]) - STEP_NATS,
                np.full(len(total), total[best] - PIECES_JUMP_NATS),
            ]
        )
        chosen = np.argmax(options, axis=0)
        came_from.append(np.choose(chosen, [index, index - 1, index + 1, best]))
        total = row + options[chosen, index]
    lags = [int(np.argmax(total))]
    for steps in reversed(came_from):
        lags.append(int(steps[lags[-1]]))
    return np.array(lags[::-1]) - (told.shape[1] - 1) // 2
