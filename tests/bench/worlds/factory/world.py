# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of `factory`, its menu of causes and its strangers."""

from .._craft.world import Maker, World, recipe
from . import waveforms as w


def _maker(build, rates, carriers, **traits):
    return Maker(make=recipe(build, **traits), rates=rates, carriers=carriers, **traits)


ISM, FIVE, SUB, UWB = (2.412e9, 2.437e9, 2.462e9), (5.18e9, 5.785e9), (868.1e6, 915e6), (3.9936e9, 6.4896e9)

WORLD = World(
    name="factory",
    makers=(
        _maker(w.ofdm, (25e6, 40e6), ISM + FIVE),
        _maker(w.barker, (22e6, 33e6), ISM, real=True),
        _maker(w.cck, (20e6, 25e6), ISM),
        _maker(w.gfsk, (4e6, 8e6), ISM, flat=True),
        _maker(w.chirps, (250e3, 500e3), SUB, flat=True),
        _maker(w.pulses, (100e6, 200e6), UWB, real=True),
        _maker(w.half_sine, (5e6, 8e6), ISM + SUB),
        _maker(w.sounding, (10e6, 50e6, 100e6), FIVE + UWB, real=True),
        _maker(w.qam, (2e6, 10e6), ISM + FIVE),
        _maker(w.packets, (25e6, 40e6), ISM + FIVE, repeat=False),
        _maker(w.chirp_packet, (250e3, 500e3), SUB, repeat=False, flat=True, unique=False),
    ),
    menu={
        "carrier_frequency_offset": ("still", "far", "far", "both"),
        "sample_clock_offset": ("fine", "coarse"),
        "phase_noise": ("wiener", "pll", "hump"),
        "iq_imbalance": ("gain", "phase", "mixed"),
        "dc_offset": ("steady", "decaying"),
        "lo_leakage": ("steady",),
        "pa_nonlinearity": ("rapp", "cubic", "memory", "memory"),
        "adc_clipping": ("rails",),
        "quantization": ("tread", "rise"),
        "gain_step": ("inside", "inside", "end"),
        "gain_drift": ("linear", "decibels", "warming"),
        "power_supply_hum": ("harmonics", "pure"),
        "front_end_filter": ("butterworth", "chebyshev", "bessel", "tilt", "delay"),
        "extra_path": ("still", "late", "moving"),
        "missing_path": ("gone",),
        "tap_gain_error": ("gain", "phase", "both"),
        "tap_delay_error": ("early", "late"),
        "tap_doppler": ("moves",),
        "tap_fading": ("ring", "even", "few"),
        "diffuse_tail": ("gaussian", "clusters", "two"),
        "second_transmitter": ("listed",),
        "tone_interference": ("carrier",),
        "narrowband_interference": ("noise", "keyed", "fm"),
        "pulsed_interference": ("noise", "noise", "carrier"),
        "impulsive_noise": ("motor", "motor", "single", "gaussian"),
        "noise_floor": ("up", "down"),
        "signal_dependent_noise": ("sparkle",),
        "sample_loss": ("lost", "repeated", "end"),
        "spectral_inversion": ("mirrored",),
    },
    strangers=(
        "Glitch",
        "Hop",
        "Pumping",
        "Blanking",
        "CoChannel",
        "Hopper",
        "NoiseBurst",
        "Symbols",
        "ShiftedStretch",
        "RepeatedStretch",
        "VaryingFilter",
        "ClockWander",
        "ColouredImage",
    ),
    types={"cf32_le": 2, "ci16_le": 3, "ci8": 2, "cu8": 1},
    spread=(4.0, 40.0),
    decays=(5.0, 200.0),
    most_taps=5,
)
