# SPDX-License-Identifier: GPL-3.0-or-later
"""Which cause makes which family, at which end, beside which others, and what it asks of its link."""

import numpy as np

from . import causes_channel as paths
from . import causes_environment as air
from . import causes_receiver as rx
from . import causes_transmitter as tx
from .strength import LEAST

FAMILIES = {
    "carrier_frequency_offset": (tx.carrier_offset, "side"),
    "sample_clock_offset": (tx.sample_clock, "side"),
    "phase_noise": (tx.phase_noise, "side"),
    "iq_imbalance": (tx.imbalance, "side"),
    "dc_offset": (rx.direct_current, "rx"),
    "lo_leakage": (tx.leakage, "tx"),
    "pa_nonlinearity": (tx.amplifier, "tx"),
    "adc_clipping": (rx.clipping, "rx"),
    "quantization": (rx.quantizer, "rx"),
    "gain_step": (tx.gain_step, "side"),
    "gain_drift": (tx.gain_drift, "side"),
    "power_supply_hum": (tx.hum, "side"),
    "front_end_filter": (tx.filtering, "side"),
    "extra_path": (paths.extra_path, "link"),
    "missing_path": (paths.missing_path, "link"),
    "tap_gain_error": (paths.tap_gain, "link"),
    "tap_delay_error": (paths.tap_delay, "link"),
    "tap_doppler": (paths.tap_doppler, "link"),
    "tap_fading": (paths.tap_fading, "link"),
    "diffuse_tail": (paths.tail, "link"),
    "second_transmitter": (air.second_transmitter, "environment"),
    "tone_interference": (air.tone, "environment"),
    "narrowband_interference": (air.narrowband, "environment"),
    "pulsed_interference": (air.pulsed, "environment"),
    "impulsive_noise": (air.impulses, "environment"),
    "noise_floor": (rx.noise_floor, "rx"),
    "signal_dependent_noise": (rx.signal_noise, "rx"),
    "sample_loss": (rx.sample_loss, "rx"),
    "spectral_inversion": (rx.inversion, "rx"),
}

# Of each group a case holds one at most: together they explain one another, or one changes what the other is told to be.
APART = (
    {"carrier_frequency_offset", "phase_noise", "tap_doppler", "tap_fading"},
    {"gain_step", "gain_drift", "tap_fading"},
    {"gain_drift", "power_supply_hum", "tap_fading"},
    {
        "noise_floor",
        "signal_dependent_noise",
        "impulsive_noise",
        "narrowband_interference",
        "quantization",
        "pulsed_interference",
    },
    {"front_end_filter", "diffuse_tail"},
    {"diffuse_tail", "extra_path"},
    {"pa_nonlinearity", "adc_clipping"},
    {"dc_offset", "lo_leakage"},
    {"tap_gain_error", "tap_delay_error", "tap_doppler", "tap_fading", "missing_path"},
    {"missing_path", "extra_path"},
    {"tone_interference", "narrowband_interference", "pulsed_interference", "second_transmitter"},
    {"sample_clock_offset", "sample_loss"},
    {"sample_loss", "gain_step"},
    {"front_end_filter", "dc_offset"},
    {"adc_clipping", "quantization", "impulsive_noise"},
    {"front_end_filter", "tap_gain_error"},
    {"front_end_filter", "tap_delay_error"},
    {"front_end_filter", "tone_interference"},
    {"front_end_filter", "narrowband_interference"},
    {"front_end_filter", "pulsed_interference"},
    {"front_end_filter", "impulsive_noise"},
    {"second_transmitter", "pa_nonlinearity"},
    {"second_transmitter", "iq_imbalance"},
    {"second_transmitter", "front_end_filter"},
    {"second_transmitter", "gain_drift"},
)
BESIDE_INVERSION = {
    "pa_nonlinearity",
    "sample_clock_offset",
    "gain_step",
    "gain_drift",
    "power_supply_hum",
    "noise_floor",
    "adc_clipping",
    "phase_noise",
    "sample_loss",
}
# A cause that is noise raises the floor for the others.
SPREAD = ("noise_floor", "signal_dependent_noise", "quantization", "phase_noise")


def compatible(families):
    got = set(families)
    if "spectral_inversion" in got and not got - {"spectral_inversion"} <= BESIDE_INVERSION:
        return False
    return len(got) == len(families) and all(len(group & got) < 2 for group in APART)


def families(rng, count):
    while True:
        got = [str(f) for f in rng.choice(list(FAMILIES), count, replace=False)]
        if compatible(got):
            return got


def needs(rng, got, silent):
    """What these families ask of scene.link; silent(rng): a waveform off the air."""
    got, out = set(got), {}
    if {"dc_offset", "lo_leakage"} & got:
        out["offset"] = 1.0
    if "spectral_inversion" in got:
        out |= dict(offset=0.0, doppler=0.0, kinds=["ofdm", "qam", "gmsk", "dsss", "lora", "fm", "zc"])
    if "iq_imbalance" in got:
        out["kinds"] = ["ofdm", "qam", "gmsk", "dsss", "zc", "lora", "fm"]
    if {"pa_nonlinearity", "signal_dependent_noise", "noise_floor"} & got:
        out["kinds"] = ["ofdm", "qam", "dsss", "zc", "fm"]
        out["tells_noise"] = "noise_floor" in got or bool(rng.random() < 0.7)
    if {"tap_gain_error", "tap_delay_error"} & got:
        out["taps"] = int(rng.integers(3, 8))
    elif {"missing_path", "tap_doppler"} & got:
        out["taps"] = int(rng.integers(2, 7))
    if "second_transmitter" in got or rng.random() < 0.15:
        out["second"] = silent(rng)
    if "quantization" in got:
        out["snr_db"] = rng.uniform(18, 42)
    claimed = {"extra_path", "tone_interference", "carrier_frequency_offset", "missing_path"}
    if got <= claimed and rng.random() < 0.3:
        out |= unknown(rng, [["delay", "phase"], ["phase", "gain"]])
    return out


def unknown(rng, options):
    """A twin that claims more; where it claims the gain, the amplitude is what the file holds."""
    left = options[int(rng.integers(len(options)))]
    out = dict(unknown=left)
    if "gain" not in left:
        out["amplitude"] = round(float(rng.uniform(0.05, 0.12)), 3)
    return out


def drowned(link, founds):
    """Whether a cause's signal is lost in what the others add to the noise."""
    rise = 1.0
    for family, found in founds.items():
        if family == "noise_floor":
            rise += 10 ** (found.spec["change_db"] / 10) - 1
        elif family == "signal_dependent_noise":
            rise += 10 ** (found.spec["slope_db"] / 10)
        elif family == "quantization":
            rise += found.spec["step"] ** 2 / 6 / link.noise
        elif family == "phase_noise":
            rise += found.spec["rms"] ** 2 * link.wanted / link.noise
        elif family == "narrowband_interference":
            rise += found.spec["s"] ** 2 * link.wanted / link.noise
    return any(found.lam / np.maximum(rise, 1) < LEAST for family, found in founds.items() if family not in SPREAD)
