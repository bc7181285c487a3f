# SPDX-License-Identifier: GPL-3.0-or-later
"""A confidence rises with what speaks for an effect and falls with what speaks against it; a list is whole when it is likelier so
than not."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose.confidence import Figures, confidence, is_whole, unseen_rest
from gr_cast.diagnose.policy import CLAIMED, OPEN, SUREST, TEMPER_NATS, UNEXPLAINED_NATS
from scipy import stats

CLEAR = Figures(
    evidence=3000.0, held_out=400.0, lead=600.0, left=0.0, explains=0.0, flexible=False, complete=True, proven=True, open=False
)
BARE = replace(CLEAR, evidence=9.0, held_out=1.0, lead=None)


@pytest.mark.parametrize(("name", "values", "way"), [
    ("evidence", [0.0, 10.0, 40.0, 300.0, 1e6], 1),
    ("held_out", [-40.0, -3.0, 0.0, 3.0, 40.0], 1),
    ("lead", [-9.0, 0.0, 3.0, 12.0, 1e4], 1),
    ("left", [0.0, 10.0, 300.0, 1e4], -1),
    ("flexible", [False, True], -1),
    ("complete", [True, False], -1),
])  # fmt: skip
def test_a_confidence_moves_one_way_with_each_figure(name, values, way):
    sure = [confidence(replace(BARE, **{name: v})) for v in values]
    assert np.all(way * np.diff(sure) >= -1e-12) and way * (sure[-1] - sure[0]) > 0
    assert all(0 <= s <= SUREST for s in sure)


def test_an_effect_that_all_figures_speak_for_is_as_sure_as_any_and_one_of_no_evidence_is_a_toss_up():
    assert confidence(CLEAR) == pytest.approx(SUREST, abs=0.001)
    assert confidence(replace(BARE, evidence=0.0, held_out=None)) == pytest.approx(SUREST / 2)


def test_nats_count_alike_whether_fitted_or_unseen_and_whatever_they_are_compared_with():
    odds = lambda f: confidence(f) / (SUREST - confidence(f))  # noqa: E731
    assert odds(replace(BARE, evidence=6.0, held_out=6.0)) == pytest.approx(odds(replace(BARE, evidence=12.0, held_out=None)))
    assert odds(replace(CLEAR, lead=12.0)) == pytest.approx(odds(replace(BARE, evidence=12.0, held_out=None)), rel=1e-6)
    assert odds(replace(CLEAR, lead=12.0 + TEMPER_NATS)) == pytest.approx(np.e * odds(replace(CLEAR, lead=12.0)), rel=1e-6)


def test_an_effect_with_an_equal_rival_is_no_likelier_than_that():
    assert confidence(replace(CLEAR, open=True)) == OPEN
    assert confidence(replace(CLEAR, lead=0.0)) == pytest.approx(SUREST / 2)


def test_what_an_unexplained_case_shows_loudly_is_surer_than_what_it_hardly_shows():
    loud, faint = (replace(CLEAR, evidence=e, held_out=e / 7, left=200.0) for e in (2362.0, 0.4))
    assert confidence(loud) > 0.5 > 3 * confidence(faint)


@pytest.mark.parametrize(("explains", "claimed"), [(0.0, True), (6e4, False)])
def test_what_had_no_time_to_prove_itself_must_be_louder_than_what_no_test_of_the_residual_sees(explains, claimed):
    """A hundredth of what is explained: models are not exact."""
    hurried = replace(CLEAR, evidence=550.0, held_out=None, lead=None, explains=explains, complete=False, proven=False)
    assert (confidence(hurried) >= CLAIMED) == claimed
    assert confidence(replace(hurried, evidence=0.4 * 6e4)) > CLAIMED
    assert confidence(replace(hurried, complete=True)) == confidence(replace(hurried, complete=True, explains=0.0))


@pytest.mark.parametrize("left", [1.0, 30.0, 3e4])
def test_an_effect_as_loud_as_what_is_left_may_as_well_be_a_part_of_it(left):
    for flexible in (False, True):
        whole = replace(CLEAR, flexible=flexible, evidence=left + 1e3, held_out=None)
        sure = confidence(replace(whole, left=left + 1e3))
        assert sure == pytest.approx(confidence(whole) / 2)


@pytest.mark.parametrize("nats", [8.0, 40.0, 900.0, 1e5])
def test_what_would_fit_something_else_leaves_nothing_as_seldom_as_an_unknown_share_is_so_near_to_all(nats):
    share = nats / (nats + UNEXPLAINED_NATS)  # with less of it explained, tests would see the rest
    assert unseen_rest(nats) == pytest.approx(stats.beta(0.5, 0.5).sf(share))


def test_what_the_time_left_unproven_is_hardly_likelier_right_than_not_and_with_another_no_whole_list():
    cut = replace(CLEAR, complete=False)
    unproven = confidence(replace(cut, held_out=None, proven=False))
    assert 0.5 < unproven < 0.65 < confidence(cut)
    assert not is_whole([unproven] * 2)


def test_what_the_time_left_unproven_is_no_claim_where_it_brings_little():
    """A hum of seven errors' size, in the rest of what a search that was cut short had no time to explain."""
    cut = replace(CLEAR, held_out=None, lead=None, complete=False, proven=False)
    assert confidence(replace(cut, evidence=60.0)) < CLAIMED < confidence(replace(cut, evidence=400.0))


def test_six_effects_that_are_each_sure_are_a_whole_list_random_courses_among_them():
    assert is_whole([confidence(CLEAR)] * 4 + [confidence(replace(CLEAR, flexible=True))] * 2)
    faint = replace(BARE, flexible=True)
    assert not is_whole([confidence(faint)] * 2)
