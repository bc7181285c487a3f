# SPDX-License-Identifier: GPL-3.0-or-later
"""Random courses that pass: what moves in one stretch of a recording alone is no wander and no fading, whatever its course fits.

A random course has independent coefficients on its cosines: with other signs (phases, where it is complex) it is as likely, of
the same spectrum, and moves anywhere (surrogate data, Theiler 1992). So the chance of a stretch that moves this much more than
the rest is that of such courses.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..twin.basis import course_length, grid_of
from ..twin.effects import FAMILIES, Effect
from ..twin.effects.noise_family import two_levels
from .fit import Fit
from .policy import CELLS, DIFFERENCES, GRID, HEARD, LEAST_ORDERS, LINE_SHARE, OFTEN, PASSING_CLEAR, SURE_P, SURROGATES
from .residual import Leftover


@dataclass(frozen=True, kw_only=True)
class Heard:
    """Cells of a course, `long` samples each: `inside` (cells,) bool where it is heard."""

    inside: np.ndarray
    long: float


def without_passing(fit: Fit) -> tuple[Fit, list[Leftover]]:
    """(the fit with every random course marked as none of a cause, what is left in their place) where one of them moves in one
    stretch alone: what happens there moves the others too. The fit and nothing where none does."""
    at = [i for i, e in enumerate(fit.model.effects) if not e.fixed and FAMILIES[e.family].wanders]
    left = [rest for i in at if (rest := stretch(fit, fit.model.effects[i])) is not None and rest.p_value < SURE_P]
    model = fit.model
    for i in at if left else ():
        model = model.replacing(i, replace(model.effects[i], aux={**model.effects[i].aux, "_passing": True}))
    return replace(fit, model=model), left


def stretch(fit: Fit, effect: Effect) -> Leftover | None:
    """The stretch in which a random course moves most against the rest, with the chance of that; None of a course too slow to
    tell."""
    scene, coefficients = fit.data.scene, clear_part(*FAMILIES[effect.family].spectrum_of(effect))
    if len(coefficients) < LEAST_ORDERS:
        return None
    size = len(grid_of(coefficients)) - 1
    heard = _heard(fit, size // GRID, course_length(scene.span) * GRID / size)
    log_p, nats, first, last = min(_contrast(coefficients, heard, d) for d in DIFFERENCES)
    t = np.minimum(np.array([first, last]) * heard.long, scene.span) / scene.sample_rate_hz
    p_value = float(min(1.0, len(DIFFERENCES) * np.exp(log_p)))
    return Leftover(test=f"{effect.family} in one stretch alone", p_value=p_value, nats=nats, where={"time_s": t.tolist()})


def _heard(fit: Fit, cells: int, long: float) -> Heard:
    used, cell = fit.data.use > 0, np.minimum((fit.data.scene.index / long).astype(int), cells - 1)
    hits = np.bincount(cell, used, cells)
    level = np.bincount(cell, np.abs(fit.chain.wanted) ** 2 * used, cells) / np.maximum(hits, 1)
    inside = (hits > 0) & (level > HEARD * np.mean(level[hits > 0]))  # where nothing is sent a course goes anywhere
    inside[:OFTEN] = inside[cells - OFTEN :] = False  # the ends of a course are held by little
    return Heard(inside=inside, long=long)


def _contrast(coefficients: np.ndarray, heard: Heard, differences: int) -> tuple[float, float, float, float]:
    """(ln of the chance of so loud a stretch, its nats over one level, its first and last cell)."""
    inside = np.convolve(heard.inside, np.ones(differences + 1), "valid") > differences
    edges = np.arange(0, len(inside), -(-len(inside) // CELLS))
    count = np.add.reduceat(inside.astype(float), edges) / OFTEN * (1.0 if np.iscomplexobj(coefficients) else 0.5)

    def loudest(c):
        moves = np.diff(grid_of(c)[GRID // 2 :: GRID][: len(heard.inside)], differences)
        return _loudest(np.add.reduceat(np.abs(moves) ** 2 * inside, edges), count)

    rng = np.random.default_rng(3)
    others = np.array([loudest(coefficients * _turns(rng, coefficients))[0] for _ in range(SURROGATES)])
    nats, first, last = loudest(coefficients)
    reduced = (nats - np.mean(others)) / max(np.std(others) * np.sqrt(6) / np.pi, 1e-300) + np.euler_gamma
    log_p = float(np.log(-np.expm1(-np.exp(-reduced)))) if reduced < 30 else -float(reduced)
    bounds = np.append(edges, len(inside)) + (differences + 1) / 2
    return log_p, float(nats), float(bounds[first]), float(bounds[last])


def of_one_line(coefficients: np.ndarray, variance: np.ndarray) -> float:
    """p-value of complex coefficients (orders,) that lie along one line: circular ones, each band of them of one power, are as
    even as a sample of a normal distribution is spherical (Mauchly 1940, in two dimensions). Of orders that hold next to nothing
    of a course nothing is asked: what is faster than it turns is the cosines' answer to its two ends, of two phases alone."""
    clear = clear_part(coefficients, variance)
    power = np.cumsum(np.abs(clear) ** 2)
    clear = clear[: np.searchsorted(power, LINE_SHARE * power[-1]) + 1] if power[-1:].any() else clear[:0]
    if len(clear) < 2:
        return 1.0
    edges = _bands(len(clear))
    power, count = np.add.reduceat(np.abs(clear) ** 2, edges), np.diff(np.append(edges, len(clear)))
    even = clear / np.sqrt(np.repeat(np.maximum(power, 1e-300) / count, count))
    along = np.abs(np.sum(even**2)) / len(even)
    return float(max(1 - along**2, 0.0) ** ((len(even) - 1) / 2))


def _bands(count: int) -> np.ndarray:
    """The first coefficient of each of some bands of `count` of them, wider the faster they are."""
    return np.unique(np.geomspace(1, count + 1, 2 + 2 * int(np.log2(count))).astype(int))[:-1] - 1


def clear_part(coefficients: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """(up to orders,) the coefficients of a course as far as they are more than the `variance` (orders,) of their estimate."""
    edges = _bands(len(coefficients))
    clear = np.add.reduceat(np.abs(coefficients) ** 2, edges) > PASSING_CLEAR * np.add.reduceat(variance, edges)
    return coefficients if clear.all() else coefficients[: edges[int(np.argmin(clear))]]


def _turns(rng, coefficients: np.ndarray) -> np.ndarray:
    """Factors that make another course of the same law."""
    if np.iscomplexobj(coefficients):
        return np.exp(2j * np.pi * rng.random(len(coefficients)))
    return rng.choice([-1.0, 1.0], len(coefficients))


def _loudest(energy: np.ndarray, count: np.ndarray) -> tuple[float, int, int]:
    """(nats, first cell, last + 1) of the stretch, up to half of all, that is likeliest to have a higher level of its own."""
    e, n = (np.concatenate([[0.0], np.cumsum(x)]) for x in (energy, count))
    best = (0.0, 0, 1)
    for length in range(1, len(energy) // 2 + 1):
        gain = two_levels(n[length:] - n[:-length], e[length:] - e[:-length], n[-1], e[-1])
        k = int(np.argmax(gain))
        best = max(best, (float(gain[k]), k, k + length))
    return best
