# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of `space`, its menu of causes and its strangers."""

from .._craft.world import Maker, World, recipe
from . import waveforms as w


def _maker(build, rates, carriers, **traits):
    return Maker(make=recipe(build, **traits), rates=rates, carriers=carriers, **traits)


L_BAND, X_BAND, AERO = (1.57542e9, 1.2276e9), (2.2e9, 8.4e9), (1.09e9,)
HF, MARINE = (5.3e6, 7.1e6, 14.2e6, 21.1e6), (161.975e6, 156.5e6)

WORLD = World(
    name="space",
    makers=(
        _maker(w.gnss, (2.048e6, 4.0e6, 5.0e6), L_BAND, real=True),
        _maker(w.boc, (4.0e6, 8.0e6), L_BAND, real=True),
        _maker(w.qpsk, (1.0e6, 2.5e6, 10e6), X_BAND),
        _maker(w.offset_qpsk, (1.0e6, 4.0e6), X_BAND),
        _maker(w.bpsk, (250e3, 1.0e6), (435e6, 2.2e9), real=True),
        _maker(w.d8psk, (50e3, 105e3), (136.9e6,)),
        _maker(w.gmsk, (48e3, 96e3), MARINE, flat=True),
        _maker(w.eight_fsk, (12e3, 24e3), HF, flat=True),
        _maker(w.ionosonde, (48e3, 100e3, 250e3), HF, flat=True),
        _maker(w.squitter, (4e6, 6e6, 8e6), AERO, repeat=False, unique=False),
        _maker(w.burst_gmsk, (48e3, 96e3), MARINE, repeat=False),
        _maker(w.frame_qpsk, (1.0e6, 2.5e6), X_BAND, repeat=False),
    ),
    menu={
        "carrier_frequency_offset": ("still", "drift", "both", "far"),
        "sample_clock_offset": ("fine",),
        "phase_noise": ("wiener", "flicker", "pll"),
        "iq_imbalance": ("gain", "phase", "mixed"),
        "dc_offset": ("steady", "steady", "decaying"),
        "lo_leakage": ("steady",),
        "pa_nonlinearity": ("saleh", "saleh", "rapp", "fifth"),
        "adc_clipping": ("rails",),
        "quantization": ("tread", "rise"),
        "gain_step": ("inside", "end"),
        "gain_drift": ("decibels", "warming"),
        "power_supply_hum": ("pure", "harmonics"),
        "front_end_filter": ("saw", "saw", "chebyshev", "delay"),
        "extra_path": ("still", "moving", "late"),
        "missing_path": ("gone",),
        "tap_gain_error": ("gain", "phase", "both"),
        "tap_delay_error": ("early", "late"),
        "tap_doppler": ("moves",),
        "tap_fading": ("gaussian", "gaussian", "few", "even"),
        "diffuse_tail": ("gaussian", "two"),
        "second_transmitter": ("listed",),
        "tone_interference": ("carrier",),
        "narrowband_interference": ("fm", "keyed"),
        "pulsed_interference": ("sweep", "carrier", "noise"),
        "impulsive_noise": ("lightning", "single", "gaussian"),
        "noise_floor": ("up", "down"),
        "signal_dependent_noise": ("sparkle",),
        "sample_loss": ("lost", "repeated", "end"),
        "spectral_inversion": ("mirrored",),
    },
    strangers=(
        "Glitch",
        "Hop",
        "WarmUp",
        "Blades",
        "Blanking",
        "Keyed",
        "Sweeper",
        "Symbols",
        "RepeatedStretch",
        "ClockWander",
        "SecondOrder",
        "NoiseBurst",
        "CoChannel",
    ),
    types={"cf32_le": 3, "ci16_le": 2, "cu8": 2, "ci8": 1},
    spread=(4.0, 60.0),
    decays=(5.0, 60.0),
)
