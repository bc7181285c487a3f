# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattering leaves a residual that is noise with a delay profile: its likelihood, by bins of delay."""

import functools
from functools import partial

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create import fields, patches
from ...twin.places.predict import surface_key

_FINER = 4  # steps of a bin of delay
_COSINES = np.linspace(0, 1, 25)  # of incidence, between which reflections are interpolated
_COARSE_M = 0.1  # of positions: patches are half a metre wide
_INSTANTS = 6  # of a moving link at which its profile is computed


def gain(ear, fit, world) -> tuple[float, float, float]:
    """(nats, energy, count): what the profile that `world` scatters is worth against white noise on this fit's residual, how much
    less energy the residual has when it is whitened by it, and how many numbers are scattered rather than noise. Static links
    count once: patches keep their phases."""
    if not ear.has_responses or not (world.surface.scattering > 0).any():
        return 0.0, 0.0, 0.0
    unit = _unit(fit)
    nats = saved = scattered = 0.0
    for index in range(len(ear.heard.links)):
        known = ear.heard.weight[index] > 0
        if not known.any():
            continue
        noise, wide, is_still = _widths(ear, fit, world, index)
        rows = np.where(known, fit.residual[index] * unit[index].conj(), 0)
        if is_still:  # all instants say the same
            rows = rows.sum(axis=0, keepdims=True) / np.sqrt(max(len(rows), 1))
        power = np.abs(np.fft.ifft(rows, axis=1, norm="ortho")) ** 2
        whitened = power / wide
        nats += float((power / noise - whitened - np.log(wide / noise)).sum() * known.mean())
        saved += float((power / noise - whitened).sum())
        scattered += float((1 - noise / wide).sum())
    return nats, saved, scattered


def whitened(ear, fit, world, rows: np.ndarray) -> np.ndarray:
    """Rows (n, numbers of the residual) of a linear problem, over what noise and scattered field together may be: where the world
    scatters, a bin of delay says less."""
    if not ear.has_responses or not (world.surface.scattering > 0).any():
        return rows
    half = rows.shape[1] // 2
    bins = (rows[:, :half] + 1j * rows[:, half:]).reshape(len(rows), *fit.residual.shape) * _unit(fit).conj()
    bins = np.fft.ifft(bins, axis=3, norm="ortho")
    for index in np.flatnonzero((ear.heard.weight > 0).any(axis=(1, 2))):
        noise, wide, is_still = _widths(ear, fit, world, index)
        narrow = np.sqrt(noise / wide)
        if is_still:
            mean = bins[:, index].mean(axis=1, keepdims=True)
            bins[:, index] += mean * (narrow - 1)
        else:
            bins[:, index] *= narrow
    flat = bins.reshape(len(rows), -1)
    return np.concatenate([flat.real, flat.imag], axis=1)


def _unit(fit) -> np.ndarray:
    return fit.factor / np.maximum(np.abs(fit.factor), 1e-300)


def _widths(ear, fit, world, index: int) -> tuple[float, np.ndarray, bool]:
    """Noise of a link, with what is scattered to it (instants or 1, bins of delay), and whether patches keep their phases: then
    it is of the sum of all instants over the root of their number."""
    heard = ear.heard
    known, count = heard.weight[index] > 0, len(heard.frequency_hz)
    profile = profiles(world, ear.predictor, index, count, heard.frequency_hz[1] - heard.frequency_hz[0])
    noise = 1 / heard.weight[index][known].mean()
    is_still = len(profile) == 1
    scale = float((np.abs(fit.factor[index]) ** 2).mean()) * (len(heard.y[index]) if is_still else 1)
    return noise, noise + scale * profile * known.mean(), is_still


def profiles(world, predictor, index: int, count: int, spacing_hz: float) -> np.ndarray:
    """Scattered power (instants or 1, bins) per delay bin of a link, of unit transmitted power."""
    tx_m, rx_m = predictor.ends_m(world, index)
    tx, rx = (world.radios[name] for name in predictor.links[index])
    static = not (tx.node.is_moving or rx.node.is_moving)
    every = max(1, -(-len(tx_m) // _INSTANTS))
    steps = np.zeros(1, int) if static else np.arange(len(tx_m)) // every * every
    kept = predictor.remembered(("reflected", world.carrier_hz, surface_key(world.surface)), lambda: _kept(world))
    made = world.mesh.coarse.key, world.surface.present.tobytes(), world.surface.clear.tobytes()
    tx_m, rx_m = (np.round(end_m / _COARSE_M) * _COARSE_M for end_m in (tx_m, rx_m))
    power = []
    for step in steps:
        key = made, tx_m[step].tobytes(), rx_m[step].tobytes()
        lit = predictor.remembered(("lit", key), partial(_lit, world, tx_m[step], rx_m[step]))
        key = "mirrors", key, tx.antenna, rx.antenna
        cell, place, mirrored = predictor.remembered(key, partial(_mirrors, lit, tx.antenna, rx.antenna, count, spacing_hz))
        power.append(np.bincount(place, kept[cell] * mirrored, minlength=count * _FINER))
    spread = np.fft.rfft(_leakage(count))
    return np.fft.irfft(np.fft.rfft(np.array(power), axis=1) * spread, count * _FINER, axis=1)[:, ::_FINER] * count


@functools.cache
def _leakage(count: int) -> np.ndarray:
    """Share of a path's power in the bin of delay 0, by the path's delay in parts of a bin: |Dirichlet's kernel|²."""
    delay = np.arange(count * _FINER) / _FINER
    return np.abs(np.exp(-2j * np.pi * np.outer(np.arange(count), delay) / count).mean(axis=0)) ** 2


def _kept(world) -> np.ndarray:
    """Share of the power that objects scatter at each of the cosines: (λ/4π)²·S² of what they reflect."""
    owner, cosine = (grid.ravel() for grid in np.meshgrid(np.arange(len(world.mesh.solids)), _COSINES, indexing="ij"))
    share = (world.wavelength_m / (4 * np.pi)) ** 2 * world.surface.scattering[owner] ** 2
    return share * patches.reflected(world.surface, world.carrier_hz, owner, cosine)


def _lit(world, tx_m, rx_m) -> patches.Seen:
    mesh = world.mesh.coarse
    return patches.seen(mesh.patches, mesh.thick if world.is_clear else mesh.thin, world.surface, tx_m, rx_m)


def _mirrors(lit: patches.Seen, tx, rx, count: int, spacing_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where there is any, power of perfect mirrors between two antennas: number of object and cosine, delay bin, power."""
    antennas = (fields.far_field(tx, lit.first) ** 2).sum(axis=1) * (fields.far_field(rx, -lit.second) ** 2).sum(axis=1)
    many = count * _FINER
    place = np.round(lit.length_m / SPEED_OF_LIGHT_M_PER_S * many * spacing_hz).astype(int) % many
    at = lit.cos_in * (len(_COSINES) - 1)
    low = np.minimum(at.astype(int), len(_COSINES) - 2)
    cells = [(lit.owner * len(_COSINES) + low + more) * many + place for more in (0, 1)]
    shares = [lit.power * antennas * (1 - (at - low)), lit.power * antennas * (at - low)]
    total = np.bincount(np.concatenate(cells), np.concatenate(shares))
    used = np.flatnonzero(total)
    return used // many, used % many, total[used]
