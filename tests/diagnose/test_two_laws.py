# SPDX-License-Identifier: GPL-3.0-or-later
"""Two laws of the noise in one recording, each drawn from its own formula, are both named, and told as large as
they are."""

import itertools

import numpy as np
import pytest
from conftest_world import COUNT, RATE_HZ, noise
from gr_cast.diagnose import diagnose, read_case

BAND_RMS, PULSE_RMS, IMPULSE = 0.01, 0.02, 0.1
WANTED_DB = 20 * np.log10(0.3) + 10 * np.log10(1 + 0.25)  # of both paths, which a long code keeps apart


def _narrowband_interference(world):
    spectrum = np.fft.fft(noise(world.rng, COUNT))
    spectrum[np.abs(np.fft.fftfreq(COUNT) - 0.2) > 0.03] = 0
    band = np.fft.ifft(spectrum)
    return BAND_RMS * band / np.sqrt(np.mean(np.abs(band) ** 2))


def _impulsive_noise(world):
    out = np.zeros(COUNT, complex)
    out[world.rng.choice(COUNT, 60, replace=False)] = IMPULSE * np.exp(1j * world.rng.uniform(0, 2 * np.pi, 60))
    return out


def _pulsed_interference(world):
    return np.where(world.n % 2100 < 300, noise(world.rng, COUNT, PULSE_RMS), 0)


def _signal_dependent_noise(world):
    return 0.05 * np.abs(world.clean()) * noise(world.rng, COUNT)


LAWS = {
    "narrowband_interference": (_narrowband_interference, {"power_dbc": 20 * np.log10(BAND_RMS) - WANTED_DB}),
    "impulsive_noise": (_impulsive_noise, {"rate_hz": 60 / COUNT * RATE_HZ, "power_db": 20 * np.log10(IMPULSE)}),
    "pulsed_interference": (
        _pulsed_interference,
        {"period_s": 2100 / RATE_HZ, "duty_cycle": 300 / 2100, "power_dbc": 20 * np.log10(PULSE_RMS) - WANTED_DB},
    ),
    "signal_dependent_noise": (_signal_dependent_noise, {"slope_db": 20 * np.log10(0.05 / 0.01) + WANTED_DB}),
}


@pytest.mark.parametrize(("one", "other"), itertools.combinations(LAWS, 2))
def test_two_laws_of_the_noise_are_both_named(world, tmp_path, one, other):
    y = world.noisy(world.clean() + LAWS[one][0](world) + LAWS[other][0](world))
    document = diagnose(read_case(world.write(tmp_path / "case", y))).document
    found = {e["family"]: e["parameters"] for e in document["effects"]}
    assert document["verdict"] == "identified" and set(found) == {one, other}
    if {one, other} == {"narrowband_interference", "signal_dependent_noise"}:  # which changes from chip to chip, and so spreads
        del found["narrowband_interference"]  # a band that is weighted by it: 1.3 dB low
    for family in found:
        for name, value in LAWS[family][1].items():
            number = found[family][name]
            assert abs(number["value"] - value) < max(4 * number["std"], 1e-3 * abs(value)), (family, name, number, value)


def test_one_law_of_the_noise_is_no_second_one(world, tmp_path):
    y = world.noisy(world.clean() + 10 * _narrowband_interference(world))
    document = diagnose(read_case(world.write(tmp_path / "case", y))).document
    assert [e["family"] for e in document["effects"]] == ["narrowband_interference"]
