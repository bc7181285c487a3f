# SPDX-License-Identifier: GPL-3.0-or-later
"""Impulses that ring on or bounce: a relay's contacts, a discharge in a resonant line."""

import numpy as np
from conftest_world import noise, sent_once
from gr_cast.diagnose import diagnose, read_case
from gr_cast.diagnose.align import split
from scipy import signal


def test_impulses_that_ring_are_no_band_of_interference(tmp_path):
    rng, count = np.random.default_rng(8), 80_000
    sent = np.fft.ifft(np.fft.fft(noise(rng, count)) * (np.abs(np.fft.fftfreq(count)) < 0.3))
    hit = (rng.random(count) < 1 / 300) * 0.03 * 10 ** (rng.normal(0, 3, count) / 20) * np.exp(2j * np.pi * rng.random(count))
    ring = np.exp((-0.25 + 2j * np.pi * 0.12) * np.arange(24))
    y = 0.3 * sent + noise(rng, count, 0.01) + signal.lfilter(ring, 1.0, hit)
    document = diagnose(sent_once(tmp_path, y, sent), budget_s=300).document
    assert [e["family"] for e in document["effects"]] == ["impulsive_noise"]


def test_a_band_beside_impulses_is_one(tmp_path):
    rng, count = np.random.default_rng(8), 40_000
    sent = np.fft.ifft(np.fft.fft(noise(rng, count)) * (np.abs(np.fft.fftfreq(count)) < 0.3))
    band = np.fft.ifft(np.fft.fft(noise(rng, count, 0.02)) * (np.abs(np.fft.fftfreq(count) - 0.1) < 0.02))
    y = 0.3 * sent + noise(rng, count, 0.01) + band + (rng.random(count) < 1 / 300) * noise(rng, count, 0.15)
    document = diagnose(sent_once(tmp_path, y, sent), budget_s=300).document
    assert {e["family"] for e in document["effects"]} == {"impulsive_noise", "narrowband_interference"}


def test_few_bursts_of_impulses_are_believed_though_chance_left_next_to_none_of_them_to_unseen_samples(world, tmp_path):
    """All within the runs of samples that are fitted: what unseen samples lack is then what chance may do."""
    rng, count = np.random.default_rng(8), len(world.n)
    vault = split(np.ones(count, bool))
    y = world.noisy(world.clean())
    free = [k for k in range(200, count - 200, 64) if not vault[k : k + 40].any()]
    for first in rng.choice(free, 20, replace=False):
        y[first + 3 * np.arange(6)] += noise(rng, 6, 0.025)
    document = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=300).document
    assert [e["family"] for e in document["effects"]] == ["impulsive_noise"]
