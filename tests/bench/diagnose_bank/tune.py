# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws causes that go together, and tunes each to its λ."""

from dataclasses import replace

import numpy as np

from . import world
from .impairments import FAMILIES

TAP_FAMILIES = {"missing_path", "tap_gain_error", "tap_delay_error", "tap_doppler", "tap_fading"}
NOISE_FAMILIES = {
    "noise_floor",
    "signal_dependent_noise",
    "impulsive_noise",
    "pulsed_interference",
    "narrowband_interference",
    "quantization",
}
OSCILLATORS = {"carrier_frequency_offset", "phase_noise", "sample_clock_offset"}
GAINS = {"gain_step", "gain_drift"}
MOVERS = ("spectral_inversion", "carrier_frequency_offset", "sample_clock_offset")  # they move a tone as well
FIRS = {"front_end_filter", "diffuse_tail"}


def compatible(keys):
    names = [FAMILIES[k].name for k in keys]
    if len(set(names)) < len(names):
        return False
    for exclusive in (
        TAP_FAMILIES,
        NOISE_FAMILIES,
        OSCILLATORS,
        GAINS,
        FIRS,
        {"dc_offset", "lo_leakage", "carrier_frequency_offset"},
        {"spectral_inversion", "iq_imbalance"},
        {"tap_fading", "phase_noise"},
        {"diffuse_tail", "extra_path"},
        {"tone_interference", "narrowband_interference"},
        {"adc_clipping", "quantization", "signal_dependent_noise"},
        {"spectral_inversion", "carrier_frequency_offset"},
        {"front_end_filter", "noise_floor"},
        *({moved, "tone_interference"} for moved in MOVERS),
        *({moved, "narrowband_interference"} for moved in MOVERS),
    ):
        if len(exclusive & set(names)) > 1:
            return False
    return True


def owner_of(rng, family, scene):
    level = family.level if family.level != "either" else str(rng.choice(["tx", "rx"]))
    name = {"tx": scene.transmitter, "rx": scene.receiver, "link": scene.link, "environment": "environment"}[level]
    return {"level": level, "name": name}


def total_lambda(scenes, causes, cause):
    return float(sum(world.strength_lambda(s, causes, cause) for s in scenes))


def tune(scenes, causes, index, target):
    """Strength of one cause for a wanted λ, by secants in log–log. All causes with it replaced."""
    cause = causes[index]
    if cause.family.fixed:
        return causes
    for _ in range(7):
        causes = [*causes[:index], cause, *causes[index + 1 :]]
        lam = max(total_lambda(scenes, causes, cause), 1e-9)
        ratio = target / lam
        if abs(np.log(ratio)) < 0.1:
            break
        power = 0.5
        if cause.name in ("adc_clipping",):
            power = 0.25
        most = {
            "gain_step": 0.5,
            "gain_drift": 0.6,
            "power_supply_hum": 0.5,
            "pa_nonlinearity": 0.4,
            "iq_imbalance": 0.4,
            "front_end_filter": 0.6,
            "tap_gain_error": 0.7,
            "missing_path": 1.0,
            "extra_path": 1.0,
            "tap_delay_error": 0.9,
            "phase_noise": 0.3,
            "adc_clipping": 1.2,
            "sample_clock_offset": 2e-4,
            "noise_floor": 8.0,
            "tap_fading": 0.7,
        }
        new = float(np.clip(cause.strength * np.clip(ratio, 1e-8, 1e8) ** power, 1e-7, most.get(cause.name, 1e9)))
        if new == cause.strength:
            break
        cause = replace(cause, strength=new)
    return [*causes[:index], cause, *causes[index + 1 :]]


def draw_targets(rng, number, strong):
    low, high = (np.log(110), np.log(3000)) if strong else (np.log(3), np.log(3000))
    return [float(np.exp(rng.uniform(low, high))) for _ in range(number)]


def draw_causes(rng, scenes, keys, targets, owners=None):
    """Draws and tunes causes; None where one does not fit."""
    causes = []
    for k, key in enumerate(keys):
        family = FAMILIES[key]
        owner = owners[k] if owners else owner_of(rng, family, scenes[0])
        mine = [s for s in scenes if world.touches(world.Cause(key=key, owner=owner, strength=0, draw={}), s)]
        if not mine or not all(family.fits(s.context) for s in mine):
            return None
        causes.append(world.Cause(key=key, owner=owner, strength=family.start, draw=family.draw(rng, mine[0].context)))
    for _ in range(2 if len(causes) > 1 else 1):
        for k, target in enumerate(targets):
            causes = tune(scenes, causes, k, target)
    return causes
