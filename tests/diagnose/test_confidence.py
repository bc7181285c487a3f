# SPDX-License-Identifier: GPL-3.0-or-later
"""A confidence rises with what speaks for an effect and falls with what speaks against it; a list is whole when it is likelier so
than not."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.confidence import Figures, confidence, is_whole
from gr_cast.diagnose.policy import OPEN, SUREST, WEAKEST

CLEAR = Figures(
    evidence=300.0,
    held_out=40.0,
    lead=60.0,
    largest=300.0,
    causes=1,
    courses=0,
    left=0.0,
    flexible=True,
    complete=True,
    open=False,
)


@pytest.mark.parametrize(("name", "values", "way"), [
    ("evidence", [0.0, 10.0, 40.0, 300.0, 1e6], 1),
    ("held_out", [-40.0, -3.0, 0.0, 3.0, 40.0], 1),
    ("lead", [-9.0, 0.0, 3.0, 12.0, 1e4], 1),
    ("largest", [300.0, 3e3, 3e5], -1),
    ("causes", [1, 2, 4, 6], -1),
    ("courses", [0, 1, 2, 4], -1),
    ("left", [0.0, 10.0, 300.0, 1e4], -1),
])  # fmt: skip
def test_a_confidence_moves_one_way_with_each_figure(name, values, way):
    weak = replace(CLEAR, largest=3000.0, causes=2)
    sure = [confidence(replace(weak, **{name: v})) for v in values]
    assert np.all(way * np.diff(sure) >= -1e-12) and way * (sure[-1] - sure[0]) > 0
    assert all(0 <= s <= SUREST for s in sure)


def test_an_effect_that_all_figures_speak_for_is_as_sure_as_any_and_one_that_only_pays_its_price_is_not():
    assert confidence(CLEAR) == pytest.approx(SUREST, abs=0.001)
    bare = replace(CLEAR, evidence=0.0, held_out=None, lead=None, largest=0.0)
    assert confidence(bare) == pytest.approx(WEAKEST)


def test_an_effect_with_an_equal_rival_is_no_likelier_than_that():
    assert confidence(replace(CLEAR, open=True)) == OPEN


def test_what_an_unexplained_case_shows_loudly_is_surer_than_what_it_hardly_shows():
    loud, faint = (replace(CLEAR, evidence=e, held_out=e / 7, largest=2362.0, causes=2, left=200.0) for e in (2362.0, 0.4))
    assert confidence(loud) > 0.5 > 3 * confidence(faint)


@pytest.mark.parametrize("left", [1.0, 30.0, 3e3])
def test_what_is_left_speaks_against_what_can_look_like_it_rather_than_against_few_numbers(left):
    few, flexible = (confidence(replace(CLEAR, flexible=f, left=left)) for f in (False, True))
    assert flexible < few < confidence(CLEAR)
    assert few < 0.5 or left < CLEAR.evidence  # but what is louder than an effect makes it doubtful, whatever it is


def test_six_effects_that_are_each_sure_are_a_whole_list_and_two_random_courses_are_none():
    strong = replace(CLEAR, evidence=5e3, held_out=700.0, lead=500.0, largest=6e3, causes=6)
    assert is_whole([confidence(strong)] * 6)
    course = replace(strong, causes=2, courses=2)
    assert not is_whole([confidence(course)] * 2)
