# SPDX-License-Identifier: GPL-3.0-or-later
"""From recordings to whole periods on one axis of time, and what clipping is."""

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.signals.recording import Recording
from gr_cast.sounding.receive import clipped_fraction, contiguous_runs, remove_offset, whole_periods


def recorded(count, gaps=(), rate_hz=1e6):
    """Samples that say their own number on the air, of which some were lost: `gaps` are (place in the file, samples lost)."""
    number = np.arange(count + sum(lost for _, lost in gaps))
    captures, dropped = [{"core:sample_start": 0}], 0
    for place, lost in gaps:
        number = np.delete(number, slice(place, place + lost))
        captures.append({"core:sample_start": place, "cast:lost_samples": lost})
        dropped += lost
    return Recording(samples=number.astype(np.complex64), sample_rate_hz=rate_hz, captures=tuple(captures))


@pytest.mark.parametrize("gaps", [(), ((10, 3),), ((10, 5), (12, 1), (40, 22)), ((0, 4), (50, 7))])
@pytest.mark.parametrize("length", [5, 7])
def test_every_period_is_whole_and_begins_where_the_code_does(gaps, length):
    file = recorded(60, gaps)
    periods = whole_periods(file, length)
    on_air = file.samples.real.astype(int)
    want = [k for k in range(0, on_air[-1] + 1, length) if np.isin(np.arange(k, k + length), on_air).all()]
    assert periods.start_sample.tolist() == want
    assert np.array_equal(periods.samples.real, np.array(want)[:, None] + np.arange(length))


def test_runs_lie_between_gaps_and_count_what_was_lost():
    assert contiguous_runs(recorded(60)) == [(0, 60, 0)]
    assert contiguous_runs(recorded(60, ((10, 5), (40, 22)))) == [(0, 10, 0), (10, 40, 5), (40, 60, 27)]
    assert contiguous_runs(recorded(60, ((0, 4),))) == [(0, 60, 4)]  # nothing lies before


def test_without_a_whole_period_there_is_nothing_to_sound():
    with pytest.raises(CastError, match=r"recording: 12 samples hold no whole period of the code \(7 samples\) without a gap"):
        whole_periods(recorded(12, ((6, 2),)), 7)
    assert len(whole_periods(recorded(7), 7).samples) == 1


def test_an_offset_is_turned_back_by_its_cycles_and_none_changes_nothing():
    n = np.arange(50) + 7
    turned = np.exp(2j * np.pi * 0.02 * n)[None].astype(np.complex64)
    assert np.allclose(remove_offset(turned, 0.02, np.array([7])), 1, atol=1e-5)
    assert np.allclose(remove_offset(turned[0], 0.02, 7), 1, atol=1e-5)
    assert remove_offset(turned, 0.0) is turned


def wave(rail, rms=0.3, count=20_000, seed=1):
    """Noise that a converter limits at `rail`, or not."""
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(2, count)) * rms
    return np.clip(parts, -rail, rail).T.copy()


def complexes(parts):
    return (parts[:, 0] + 1j * parts[:, 1]).astype(np.complex64)


@pytest.mark.parametrize("rail", [0.4, 0.6, 0.75])
def test_the_share_that_clips_is_that_of_a_normal_law_beyond_the_rail(rail):
    from scipy.stats import norm

    share = 1 - (1 - 2 * norm.sf(rail / 0.3)) ** 2
    assert clipped_fraction(complexes(wave(rail))) == pytest.approx(share, rel=0.1)


def test_noise_that_meets_its_own_maximum_does_not_clip_nor_what_has_one_level_alone():
    assert clipped_fraction(complexes(wave(np.inf))) == 0
    rng = np.random.default_rng(2)
    assert clipped_fraction(rng.choice([1, -1, 1j, -1j], 5000)) == 0  # |samples| do not differ
    assert clipped_fraction(rng.choice([1 + 1j, 0.1 - 1j, 0.1j], 5000)) == 0  # nothing just below the largest


@pytest.mark.parametrize(
    ("count", "at_rail", "clips"),
    [(5000, 9, False), (5000, 10, True), (40_000, 39, False), (40_000, 41, True), (2000, 0, False)],
)
def test_a_rail_is_met_ten_times_at_least_and_by_more_than_a_thousandth(count, at_rail, clips):
    rng = np.random.default_rng(3)
    parts = rng.uniform(-0.88, 0.88, (count, 2))
    parts[:at_rail, 1] = -0.9
    parts[-1, 0] = 0.9 if at_rail == 0 else parts[-1, 0]
    assert clipped_fraction(complexes(parts)) == pytest.approx(at_rail / count if clips else 0)


@pytest.mark.parametrize(("rail", "clips"), [(0.94, False), (0.96, True)])
def test_whole_numbers_clip_at_full_scale_alone(rail, clips):
    samples = complexes(wave(0.6) * (rail / 0.6))
    assert clipped_fraction(samples) > 0
    assert (clipped_fraction(samples, "ci16_le") > 0) == clips
