# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattering leaves a residual that is noise with a delay profile: its likelihood, by bins of delay."""

from dataclasses import replace
from functools import partial

import numpy as np

from ...core.units import SPEED_OF_LIGHT_M_PER_S
from ...scenario.create import patches
from ...twin.places.predict import radio_key, surface_key

_SPREAD = (0.15, 0.7, 0.15)  # of a delay between two bins
_INSTANTS = 6  # of a moving link at which its profile is computed


def gain(ear, fit, world) -> tuple[float, float]:
    """(nats, energy): what the profile that `world` scatters is worth against white noise on this fit's residual, and how much
    less energy the residual has when it is whitened by it. Static links count once: patches keep their phases."""
    if not ear.has_responses or not (world.surface.scattering > 0).any():
        return 0.0, 0.0
    heard, predictor = ear.heard, ear.predictor
    spacing_hz = heard.frequency_hz[1] - heard.frequency_hz[0]
    count = len(heard.frequency_hz)
    amplitude = np.abs(fit.factor)
    unit = fit.factor / np.maximum(amplitude, 1e-300)
    nats = saved = 0.0
    for index in range(len(heard.links)):
        profile = profiles(world, predictor, index, count, spacing_hz)
        weight = heard.weight[index]
        known = weight > 0
        if not known.any():
            continue
        noise = 1 / weight[known].mean()
        rows = np.where(known, fit.residual[index] * unit[index].conj(), 0)
        scale = float((amplitude[index] ** 2).mean())
        if len(profile) == 1:  # patches keep their phases: all instants say the same
            rows = rows.sum(axis=0, keepdims=True) / np.sqrt(max(len(rows), 1))
            profile = profile * len(heard.y[index])
        bins = np.fft.ifft(rows, axis=1) * np.sqrt(count)
        share = known.mean()
        wide = noise + scale * profile * share
        power = np.abs(bins) ** 2
        whitened = power / wide
        nats += float((power / noise - whitened - np.log(wide / noise)).sum() * share)
        saved += float((power / noise - whitened).sum())
    return nats, saved


def profiles(world, predictor, index: int, count: int, spacing_hz: float) -> np.ndarray:
    """Scattered power (instants or 1, bins) per delay bin of a link, of unit transmitted power."""
    tx_m, rx_m = predictor.ends_m(world, index)
    tx, rx = (world.radios[name] for name in predictor.links[index])
    static = not (tx.node.is_moving or rx.node.is_moving)
    every = max(1, -(-len(tx_m) // _INSTANTS))
    steps = np.zeros(1, int) if static else np.arange(len(tx_m)) // every * every
    square, out = world.surface.scattering**2, []
    whole = replace(world.surface, scattering=np.zeros_like(square))  # powers over S² are the same for all S
    made = world.mesh.key, world.carrier_hz, surface_key(whole), radio_key(tx), radio_key(rx)
    for step in steps:
        key = ("scattered", made, tx_m[step].tobytes(), rx_m[step].tobytes())
        make = partial(_by_object, world, tx, rx, tx_m[step], rx_m[step], count, spacing_hz)
        power = square @ predictor.remembered(key, make)
        out.append(np.convolve(np.tile(power, 3), _SPREAD, "same")[count : 2 * count] * count)
    return np.array(out)


def _by_object(world, tx, rx, tx_m, rx_m, count: int, spacing_hz: float) -> np.ndarray:
    """Power over S² per object and delay bin (O, bins)."""
    power, length_m, owner = patches.powers(
        world.mesh.patches, world.faces, world.surface, world.carrier_hz, tx_m, rx_m, tx.antenna, rx.antenna
    )  # fmt: skip
    place = np.round(length_m / SPEED_OF_LIGHT_M_PER_S * count * spacing_hz).astype(int) % count
    objects = len(world.mesh.solids)
    return np.bincount(owner * count + place, power, minlength=objects * count).reshape(objects, count)
