# SPDX-License-Identifier: GPL-3.0-or-later
"""Intervals and what they say: as SciPy has them, and as seldom wrong as they promise."""

import numpy as np
import pytest
from equal_sites import said
from gr_cast.pipeline.cause import concluded
from gr_cast.pipeline.intervals import FAMILY_ERROR, Difference, paired
from scipy import stats


def test_an_interval_is_students_at_the_level_that_all_comparisons_share():
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=6), rng.normal(1, 2, size=6)
    for comparisons in (1, 7):
        told = stats.ttest_rel(b, a).confidence_interval(1 - FAMILY_ERROR / comparisons)
        d = paired(a, b, comparisons)
        assert (d.low, d.high, d.mean) == pytest.approx((told.low, told.high, np.mean(b - a)))


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_harmless_commits_raise_an_alarm_no_more_often_than_the_family_error(shift):
    """At worst the change is as large as the tolerance; eight metrics of a commit are judged together."""
    rng, commits, metrics = np.random.default_rng(2), 2000, 8
    alarms = 0
    for _ in range(commits):
        pairs = rng.normal(size=(metrics, 2, 4)) * 0.3
        alarms += any(paired(a, b + shift, metrics).worse(1.0, "lower") == "beyond" for a, b in pairs)
    assert alarms <= stats.binom.ppf(0.999, commits, FAMILY_ERROR)


@pytest.mark.parametrize(
    ("low", "high", "two_sided", "lower", "higher"),
    [
        (-0.5, 0.5, "within", "within", "within"),
        (1.5, 2.0, "beyond", "beyond", "within"),
        (-2.0, -1.5, "beyond", "within", "beyond"),
        (0.5, 1.5, "open", "open", "within"),
        (-1.5, -0.5, "open", "within", "open"),
    ],
)
def test_an_interval_is_within_beyond_or_open_against_a_tolerance_of_one(low, high, two_sided, lower, higher):
    d = Difference(mean=(low + high) / 2, low=low, high=high, std=0.1, n=4)
    assert (d.said(1.0), d.worse(1.0, "lower"), d.worse(1.0, "higher")) == (two_sided, lower, higher)
    assert d.repeats_wanted(1.0) > 4


def test_equal_sites_are_the_same_and_two_decibels_of_noise_are_seen():
    assert said(12, 4, 1).count({"within"}) == 12
    assert all("beyond" in one for one in said(2, 4, 2, more_noise_db=2.0))


def diagnosis(verdict: str, *effects, ambiguous=()) -> dict:
    entries = [
        {"family": f, "owner": {"level": level, "name": "1"}, "sentence": f, "evidence": {"delta_loglik": nats}}
        for f, level, nats in effects
    ]
    return {"verdict": verdict, "effects": entries, "ambiguous": list(ambiguous), "residual": {"record_next": "longer_recording"}}


CLEAN = diagnosis("no_mismatch")
CAUSES = [
    (diagnosis("identified", ("dc_offset", "rx", 9.0), ("missing_path", "link", 99.0)), CLEAN, 0.0, "channel", "missing_path"),
    (diagnosis("identified", ("dc_offset", "rx", 9.0)), CLEAN, 0.0, "radio", "dc_offset"),
    (
        diagnosis("identified", ("dc_offset", "rx", 9.0)),
        diagnosis("identified", ("dc_offset", "rx", 8.0)),
        0.0,
        "unexplained",
        None,
    ),
    (CLEAN, CLEAN, -3.0, "channel", "level"),
    (CLEAN, CLEAN, 0.0, "stack", None),
    (diagnosis("ambiguous", ambiguous=[{"families": ["a", "b"], "record_next": "second_link"}]), CLEAN, 0.0, "open", "a"),
]


@pytest.mark.parametrize(("here", "twin", "level_db", "kind", "first"), CAUSES)
def test_the_cause_is_the_loudest_effect_that_the_twins_own_recordings_do_not_show(here, twin, level_db, kind, first):
    cause = concluded(here, twin, level_db, True)
    assert cause.kind == kind and (cause.families[:1] or (None,))[0] == first
    assert (cause.record == "second_link") == (kind == "open")
