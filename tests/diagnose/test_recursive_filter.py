# SPDX-License-Identifier: GPL-3.0-or-later
"""A front end's filter that rings is a filter, however long, and no diffuse tail; SciPy's designs are the other side."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest_world import COUNT, noise, sent_once
from gr_cast.diagnose import diagnose, read_case
from gr_cast.twin.effects import FAMILIES
from scipy import signal

DESIGNS = {
    "Butterworth": signal.butter(4, 0.4),
    "Chebyshev": signal.cheby1(5, 1.0, 0.4),
    "elliptic": signal.ellip(5, 0.5, 50.0, 0.4),
    "notch": signal.iirnotch(0.12, 8.0),
    "high-pass": signal.butter(3, 0.02, "high"),
}


def _told(case):
    document = diagnose(case, budget_s=3000).document
    return document["verdict"], [e["family"] for e in document["effects"]]


@pytest.mark.parametrize("design", ["Chebyshev", "elliptic"])
def test_a_front_end_that_rings_is_filtered_and_hears_no_tail(world, tmp_path, design):
    y = world.noisy(signal.lfilter(*DESIGNS[design], np.concatenate([world.clean(), world.clean()]))[-COUNT:])
    assert _told(read_case(world.write(tmp_path / "case", y))) == ("identified", ["front_end_filter"])


@pytest.mark.parametrize("design", ["Butterworth", "Chebyshev", "notch"])
def test_of_a_waveform_that_is_sent_once_too(tmp_path, design):
    rng = np.random.default_rng(4)
    sent = 2 * signal.upfirdn(signal.firwin(41, 0.5), noise(rng, COUNT // 2), up=2)[:COUNT]
    y = signal.lfilter(*DESIGNS[design], sent) + noise(rng, COUNT, 0.005)
    (tmp_path / "case").mkdir()
    assert _told(sent_once(tmp_path / "case", y, sent)) == ("identified", ["front_end_filter"])


@pytest.mark.parametrize("side", ["rx", "tx"])
@pytest.mark.parametrize("design", DESIGNS)
def test_its_entry_plays_the_filter_of_the_design_and_tells_it_back(design, side):
    b, a = DESIGNS[design]
    y, scene = noise(np.random.default_rng(4), 5000), SimpleNamespace(count=5000, rms=1.0)
    main = int(np.argmax(np.abs(b)))
    model = {"side": side, "low": 0, "main": main} | {
        "taps": (b + 0j).view(float).tolist(),
        "feedback": (a[1:] + 0j).view(float).tolist(),
    }
    filters = FAMILIES["front_end_filter"]
    assert filters.contradiction({}, model) is None
    effect = filters.parse(scene, {"ripple_db": 1.0}, model)
    chain = SimpleNamespace(y=y, waves=[y], scene=scene)
    FAMILIES[effect.family].apply(chain, effect)
    played = chain.waves[0] if side == "tx" else chain.y
    ringing = slice(1000, None)  # behind which a wave that goes round and one that begins are alike
    want = signal.lfilter(b, a, np.concatenate([y, y]))[5000:] if side == "tx" else signal.lfilter(b, a, y)
    assert np.allclose(played[ringing], want[ringing], atol=1e-6 * np.abs(want).max())
    assert FAMILIES[effect.family].model(scene, effect) == model


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"feedback": [-2.0, 0.0]}, "stable"),
        ({"feedback": [0.5]}, "Re and Im"),
        ({"feedback": []}, "Re and Im"),
        ({"main": 3}, "main"),
        ({"main": 2}, "main"),
        ({"low": 1, "main": 1}, "main"),
        ({"taps": [1.0]}, "taps"),
    ],
)
def test_an_entry_that_no_filter_has_is_told(wrong, says):
    model = {"low": 0, "main": 0, "taps": [1.0, 0.0, 0.5, 0.0], "feedback": [-0.5, 0.0]}
    assert FAMILIES["front_end_filter"].contradiction({}, model) is None
    assert says in FAMILIES["front_end_filter"].contradiction({}, model | wrong)
