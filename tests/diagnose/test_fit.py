# SPDX-License-Identifier: GPL-3.0-or-later
"""A fit reaches the optimum, and what is left of it is made white, whatever part of it is held out."""

from dataclasses import replace

import numpy as np
import pytest
from conftest_world import noise, sent_once
from gr_cast.diagnose import align, offsets
from gr_cast.diagnose.fit import Data, solve
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


@pytest.mark.parametrize("excess_db", [10.0, 44.0])
def test_noise_with_a_loud_band_is_white_of_unit_power_beside_samples_that_are_held_out(excess_db):
    rng, count = np.random.default_rng(4), 48_000
    inside = np.abs(np.fft.fftfreq(count) + 0.1) < 0.02
    spectrum = np.where(inside, 10 ** (excess_db / 10), 1.0)
    y = np.fft.ifft(np.fft.fft(rng.normal(size=(count, 2)) @ [1, 1j] / np.sqrt(2)) * np.sqrt(spectrum))
    use = np.repeat(rng.integers(0, 8, count // 16) > 0, 16).astype(float)
    white = Data(scene=None, y=y, use=use, vault=use == 0, spectrum=spectrum, loud=True).whitened(y)
    assert np.mean(np.abs(white[use > 0]) ** 2) == pytest.approx(1.0, abs=0.05)
    assert not white[use == 0].any()


@pytest.mark.parametrize("side", ["tx", "rx"])
def test_one_solution_reaches_the_bottom_of_the_valley_of_a_delay_and_a_row_of_taps(tmp_path, side):
    """Of an oversampled waveform a delay and neighbouring taps do all but the same; least squares over the taps at the delay
    that was played is what a fit must not stay above."""
    rng, count, taps = np.random.default_rng(4), 60_000, {-1: 0.15, 0: 1.0, 1: 0.9, 2: 0.4j}
    band = np.abs(np.fft.fftfreq(count)) < 0.08
    sent = np.fft.ifft(np.fft.fft(noise(rng, count, 3.0)) * band)
    y = sum(tap * np.roll(sent, lag) for lag, tap in taps.items()) + noise(rng, count, 0.01)
    case = sent_once(tmp_path, y, sent)
    _, data, model = align.build(case, case.observations[0])
    low, high = -4, 4
    aux = {"low": low, "high": high, "side": side, **({"source": 0} if side == "tx" else {})}
    fit = solve(data, model.adding(start(FAMILIES["front_end_filter"], np.zeros(2 * (high - low)), aux=aux)))
    columns = np.array([np.roll(sent, lag) for lag in range(low - 1, high + 2)]).T * data.use[:, None]
    left = y * data.use - columns @ np.linalg.lstsq(columns, y * data.use, rcond=None)[0]
    assert fit.sigma2 < 1.001 * np.vdot(left, left).real / data.count


@pytest.mark.parametrize("family", ["diffuse_tail", "front_end_filter"])
def test_one_solution_finds_taps_under_a_carrier_that_turns_far_from_one_tap_to_the_last(tmp_path, family):
    """The twin knows the receiver's offset of 0.03 cycles per sample: three turns in 100 taps. The bar is what least squares over
    as many taps leaves."""
    rng, count, size = np.random.default_rng(4), 20_000, 100
    sent, n = noise(rng, count, 1.0), np.arange(count)
    late = np.array([np.concatenate([np.zeros(k), sent[: count - k]]) for k in range(size + 1)])
    y = np.concatenate([[1.0], noise(rng, size, 0.02)]) @ late * np.exp(2j * np.pi * 0.03 * n) + noise(rng, count, 0.01)
    case = sent_once(tmp_path, y, sent)
    _, data, model = align.build(case, case.observations[0], near=(0.0, False))
    carrier = start(FAMILIES["carrier_frequency_offset"], [0.03 * data.scene.span, 0.0], free=[False, False])
    model = offsets.with_gains(data, model.adding(replace(carrier, fixed=True)))
    aux = {"source": 0, "first": 1.0, "low": 0, "high": size, "side": "tx"}
    prior = np.full(2 * size, 1e3)  # next to none
    fit = solve(data, model.adding(start(FAMILIES[family], np.zeros(2 * size), aux=aux, prior=prior)))
    columns = late.T * data.use[:, None]
    wanted = y * np.exp(-2j * np.pi * 0.03 * n) * data.use
    left = wanted - columns @ np.linalg.lstsq(columns, wanted, rcond=None)[0]
    assert fit.sigma2 < 1.02 * np.vdot(left, left).real / data.count
