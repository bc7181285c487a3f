# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording's own metadata is doubted where its samples speak against it, and nowhere else."""

import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.signals.doubts import doubts
from gr_cast.signals.recording import DATATYPES, Recording, to_complex, to_raw

COUNT = 20_000


def signals():
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(COUNT, 2)) @ [1, 1j]
    code, tone = np.resize(codes.glfsr(8), COUNT), np.exp(0.077j * np.arange(COUNT))
    burst = np.where(np.arange(COUNT) % 5000 > 4000, noise, 0)
    for level in (1e-3, 0.03, 0.3):
        yield from (level * one for one in (noise, code + 0.1 * noise, tone + 0.01 * noise, burst))
    yield from (
        0.5 * code,
        tone,
        np.clip(noise, -1, 1),
        0.5 * (code + 1j * code),
        1e-6 * noise + (np.arange(COUNT) > 3000) * code,
    )


def read_as(samples, written: str, read: str) -> Recording:
    item = np.dtype(DATATYPES[read][0])
    raw = np.frombuffer(to_raw(samples, written).tobytes(), item)
    return Recording(samples=to_complex(raw, read), sample_rate_hz=1e6, center_frequency_hz=1e9, datatype=read)


@pytest.mark.parametrize("datatype", DATATYPES)
def test_samples_of_the_datatype_they_say_are_not_doubted(datatype):
    for number, samples in enumerate(signals()):
        assert doubts(read_as(samples, datatype, datatype)) == [], number


@pytest.mark.parametrize("written", DATATYPES)
@pytest.mark.parametrize("read", DATATYPES)
def test_noise_is_doubted_where_it_is_read_as_another_datatype(written, read):
    noise = 0.1 * np.random.default_rng(2).normal(size=(COUNT, 2)) @ [1, 1j]
    wrong = read_as(noise, written, read)
    told = not np.isfinite(wrong.samples).all() or any("core:datatype: says" in line for line in doubts(wrong))
    assert told == (written != read)


def test_rates_and_carriers_are_questioned_as_on_the_command_line():
    told = Recording(samples=np.ones(9), sample_rate_hz=20.0, center_frequency_hz=2400.0)
    assert doubts(told) == [
        "core:sample_rate: got 20, 20 Hz: is 20M meant?",
        "core:frequency: got 2400, 2400 Hz: is 2400M meant?",
    ]
    assert doubts(Recording(samples=np.ones(9), sample_rate_hz=48e3, center_frequency_hz=0.0)) == []
