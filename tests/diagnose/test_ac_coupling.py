# SPDX-License-Identifier: GPL-3.0-or-later
"""A receiver that lets no DC through: a filter whose memory is longer than any row of taps."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest_world import noise, sent_once
from gr_cast.diagnose import diagnose, read_case
from gr_cast.twin.effects import FAMILIES
from scipy import signal


def _told(case):
    document = diagnose(case, budget_s=3000).document
    return document["verdict"], [(e["family"], e["owner"]["level"]) for e in document["effects"]]


@pytest.mark.parametrize("corner", [0.0004, 0.002, 0.01], ids="{:g} of the rate".format)
def test_a_receiver_that_is_coupled_by_a_capacitor_is_filtered_and_hears_no_tail_nor_tones(world, tmp_path, corner):
    y = world.noisy(signal.lfilter(*signal.butter(1, 2 * corner, "high"), world.clean()))
    assert _told(read_case(world.write(tmp_path / "case", y))) == ("identified", [("front_end_filter", "rx")])


@pytest.mark.parametrize("corner", [0.0005, 0.005], ids="{:g} of the rate".format)
def test_of_a_waveform_that_is_sent_once_too(tmp_path, corner):
    rng, n = np.random.default_rng(4), 40_000
    sent = signal.upfirdn(signal.firwin(41, 0.25), noise(rng, n // 4), up=4)[:n] * 2
    y = signal.lfilter(*signal.butter(1, 2 * corner, "high"), sent) + noise(rng, n, 0.01)
    (tmp_path / "case").mkdir()
    assert _told(sent_once(tmp_path / "case", y, sent)) == ("identified", [("front_end_filter", "rx")])


def test_the_entry_of_a_coupled_receiver_plays_the_analogue_high_pass():
    """Against the bilinear one of SciPy, whose corner is the same where it is far below the rate."""
    rng, corner_hz, rate_hz = np.random.default_rng(4), 500.0, 1e6
    scene = SimpleNamespace(sample_rate_hz=rate_hz, count=20_000, rms=1.0, occupied=np.ones(512, bool))
    effect = FAMILIES["front_end_filter"].parse(scene, {"ripple_db": 1.0}, {"corner_hz": corner_hz, "passed": 0.0})
    y = noise(rng, scene.count)
    chain = SimpleNamespace(y=y, scene=scene)
    FAMILIES[effect.family].apply(chain, effect)
    want = signal.lfilter(*signal.butter(1, 2 * corner_hz / rate_hz, "high"), y)
    assert np.mean(np.abs(chain.y / np.vdot(want, chain.y) * np.vdot(want, want) - want) ** 2) < 1e-5
    assert FAMILIES[effect.family].model(scene, effect) == pytest.approx({"corner_hz": corner_hz, "passed": 0.0})
