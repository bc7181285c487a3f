# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's comparison of codes against closed forms: what m-sequences, complementary pairs and Zadoff-Chu must give."""

import numpy as np
import pytest
from gr_cast.signals import codes
from gr_cast.sounding import code_comparison as comparison


@pytest.fixture(scope="module")
def rows():
    return {row["name"]: row for row in comparison.compare()}


def test_the_papers_codes_are_marked_and_all_have_800_microseconds(rows):
    assert [name for name, row in rows.items() if row["published"]] == ["glfsr:8", "gold_paper", "ga128", "ls"]
    assert [name for name, row in rows.items() if not row["published"]] == [
        "gold:127",
        "gold:511",
        "ga128+gb128",
        "zadoff_chu:255:1",
    ]
    for row in rows.values():
        assert len(row["time_us"]) == len(row["alone_db"]) == len(row["link_db"]) == 800
        assert np.allclose(row["time_us"], np.arange(800))


def test_peaks_come_once_a_period_and_stand_at_their_level_30_db_lower_through_the_link(rows):
    for row in rows.values():
        peaks = np.arange(0, 800, row["length"])
        assert row["alone_db"][peaks] == pytest.approx(np.zeros(len(peaks)), abs=1e-6)
        assert row["link_db"][peaks] == pytest.approx(np.full(len(peaks), -30.0), abs=0.1)
        if len(peaks) > 1 and row["name"] != "ls":
            assert row["peak_spacing_s"] == pytest.approx(row["length"] * 1e-6)


@pytest.mark.parametrize(
    ("name", "length", "sidelobe_db"),
    [
        ("glfsr:8", 255, 20 * np.log10(1 / 255)),  # −1 of 255
        ("gold:127", 127, 20 * np.log10(17 / 127)),  # t(7) = 2^((7+1)/2) + 1
        ("gold:511", 511, 20 * np.log10(33 / 511)),  # t(9)
        ("ga128+gb128", 128, None),  # complementary: none at all
        ("zadoff_chu:255:1", 255, None),  # constant amplitude, zero autocorrelation
    ],
)
def test_sidelobes_are_those_of_the_closed_forms(rows, name, length, sidelobe_db):
    row = rows[name]
    assert row["length"] == length
    for key in ("periodic_sidelobe_db", "alone_sidelobe_db"):
        assert row[key] == (None if sidelobe_db is None else pytest.approx(sidelobe_db, abs=1e-3))


def test_alone_and_by_the_closed_form_every_code_has_the_same_sidelobe_and_through_the_link_noise_on_top(rows):
    for row in rows.values():
        if row["periodic_sidelobe_db"] is not None:
            assert row["alone_sidelobe_db"] == pytest.approx(row["periodic_sidelobe_db"], abs=1e-3)
        # Of 800 lags the largest of noise 30 dB under what arrives, over a period.
        noise_db = -30.0 - 10 * np.log10(row["length"] * (2 if "+" in row["name"] else 1))
        level = 10 ** ((row["periodic_sidelobe_db"] or -300.0) / 20)
        most_db = 20 * np.log10(level + 4 * 10 ** (noise_db / 20))
        least_db = max(row["periodic_sidelobe_db"] or -300.0, noise_db + 4)
        assert least_db - 0.1 < row["link_sidelobe_db"] < most_db


def test_correlation_over_the_energy_is_one_at_the_beginning_of_every_period():
    code = codes.zadoff_chu(63, 5)
    got = comparison._correlation(np.tile(0.5j * code, 3), code)
    want = [np.sum(np.tile(0.5j * code, 3)[k : k + 63] * np.conj(code)) / 63 for k in range(127)]
    np.testing.assert_allclose(got, want, atol=1e-7)


def test_noise_of_the_link_stands_60_db_under_full_scale():
    heard = comparison._through_link(np.zeros(100_000), np.random.default_rng(1))
    assert np.mean(np.abs(heard) ** 2) == pytest.approx(1e-6, rel=0.02)
    assert np.mean(heard.real**2) == pytest.approx(0.5e-6, rel=0.03) and abs(np.mean(heard**2)) < 2e-8


def test_another_seed_is_other_noise_alone(rows):
    other = {row["name"]: row for row in comparison.compare(2)}
    for name, row in rows.items():
        assert np.array_equal(row["alone_db"], other[name]["alone_db"])
        assert not np.array_equal(row["link_db"], other[name]["link_db"])
