# SPDX-License-Identifier: GPL-3.0-or-later
"""How much of a cause shows: λ, on one scale for what is a known signal and for what is noise.

A signal's λ is the energy that gain, phase and delay leave of it, over the noise's variance: the expected log-likelihood ratio in
nats. Noise has no signal to subtract: its λ is that ratio of its true law over even noise of the same power.
"""

import math

import numpy as np
from scipy import special

from . import channel
from .scene import Redraw

LEAST, MOST = 30.0, 1e5


def target(rng):
    return 10 ** rng.uniform(math.log10(LEAST), math.log10(MOST))


def refitted(link, difference):
    """What the fit of all that the twin does not claim leaves of a difference from its prediction."""
    columns = []
    if "gain" in link.unknown:
        columns.append(link.y)
    if "phase" in link.unknown:
        columns.append(1j * link.y)
    if "delay" in link.unknown:
        columns.append(link.slope)
    r = difference[link.mask]
    if not columns:
        return r
    a = np.stack([np.concatenate([c[link.mask].real, c[link.mask].imag]) for c in columns], 1)
    b = np.concatenate([r.real, r.imag])
    gram = a.T @ a
    b = b - a @ np.linalg.solve(gram + 1e-12 * np.trace(gram) * np.eye(len(gram)), a.T @ b)
    return b[: len(r)] + 1j * b[len(r) :]


def energy(link, causes):
    return over_noise(link, channel.received(link, causes) - link.y)


def over_noise(link, difference):
    return float(np.sum(np.abs(refitted(link, difference)) ** 2) / link.noise)


# ---------------------------------------------------------------- noise
def uneven(profile):
    """λ of complex Gaussian noise whose variances are `profile`, over even noise."""
    return float(np.sum(np.log(np.mean(profile)) - np.log(profile)))


def louder(count, ratio):
    """λ of white noise `ratio` times as strong as the twin says."""
    return count * (ratio - 1 - math.log(ratio))


def modes(total, energies):
    """λ of a random course: of `total` complex numbers, some hold these expected energies over the noise besides it."""
    extra = np.asarray(energies)
    return float(total * np.log1p(np.sum(extra) / total) - np.sum(np.log1p(extra)))


def phase_course(count, ratio, density):
    """λ of a random phase: quadrature numbers alone, `ratio` the wanted power over the noise, density: of the phase's variance
    over its modes, per sample."""
    v = 1 + 2 * ratio * density
    even = (count + np.sum(v)) / (2 * count)
    return 0.5 * float(2 * count * np.log(even) - np.sum(np.log(v)))


def impulses(train, share, sizes, noise, rng):
    """λ of rare impulses in single samples: `share` of all; sizes: amplitudes that are alike likely, or None for Gaussian ones.

    The mixture's law, at one realisation of the noise."""
    unit = (rng.standard_normal(len(train)) + 1j * rng.standard_normal(len(train))) / math.sqrt(2)
    w = np.abs(train / math.sqrt(noise) + unit) ** 2
    if sizes is None:
        wide = 1 + float(np.sum(np.abs(train) ** 2)) / noise / max(1, np.count_nonzero(train))
        hit = w - w / wide - math.log(wide)
    else:
        a = np.asarray(sizes)[:, None] / math.sqrt(noise)
        root = np.sqrt(w)[None]
        hit = special.logsumexp(w - (root - a) ** 2 + np.log(special.i0e(2 * a * root)), axis=0) - math.log(len(a))
    flat = np.mean(w)
    ratio = np.logaddexp(math.log1p(-share), math.log(share) + hit) - w + w / flat + math.log(flat)
    return float(np.sum(ratio))


# ---------------------------------------------------------------- sizes
def scaled(link, family, make, size, lo, hi, aim, measure=None, tries=5):
    """(spec, λ) of make(size) with λ near `aim`, as far as lo … hi goes; λ grows about as size²."""
    measure = measure or (lambda spec: energy(link, {family: spec}))
    under, over = 0.0, math.inf
    for _ in range(tries):
        size = min(max(size, lo), hi)
        spec = make(size)
        lam = measure(spec)
        if abs(math.log(max(lam, 1e-9) / aim)) < 0.35 or (size in (lo, hi) and (lam > aim) == (size == lo)):
            break
        under, over = (under, size) if lam > aim else (size, over)
        size *= min(max(math.sqrt(aim / max(lam, 1e-9)), 0.02), 50.0)
        if not under < size < over:  # where λ does not grow so
            size = math.sqrt(under * over)
    if lam < LEAST:
        raise Redraw(family + " does not show")
    return spec, lam
