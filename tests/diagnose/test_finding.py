# SPDX-License-Identifier: GPL-3.0-or-later
"""What an effect is worth is known of that effect, whatever its numbers are called in memory."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose import finding as findings
from gr_cast.diagnose.finding import Finding, Worth
from gr_cast.diagnose.fit import Data
from gr_cast.diagnose.search import refit
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.model import Model, predict
from gr_cast.twin.scene import Path, Scene, Source

COUNT = 800


@pytest.fixture
def finding():
    rng = np.random.default_rng(3)
    x = rng.normal(size=101) + 1j * rng.normal(size=101)
    source = Source(name="w", samples=x, repeat=True, known=np.ones(101, bool), power=2.0, peak=3.0)
    sent = {"sample_rate_hz": 1e6, "count": COUNT, "sources": [source], "taps": [Path(source=0, delay=0.0, gain=1.0)]}
    scene = Scene(name="r", transmitters=["tx1"], receiver="rx1", anchor=0, **sent)
    model = Model(base=np.array([0.0, 1.0, 0.0]))
    for name, p in (("dc_offset", [0.1, 0.05, 0.0]), ("tone_interference", [0.2, 0.0, 100.3])):
        model = model.adding(start(FAMILIES[name], p, free=[True, True, False]))
    y = predict(scene, model).y + 0.01 * (rng.normal(size=COUNT) + 1j * rng.normal(size=COUNT))
    data = Data(scene=scene, y=y, use=np.ones(COUNT), vault=np.zeros(COUNT, bool))
    fit = refit(data, model)
    return Finding(observation=None, scene=scene, data=data, twin=refit(data, Model(base=model.base)), fit=fit)


def test_an_effect_is_the_same_one_wherever_a_fit_moves_it(finding):
    model = finding.fit.model
    moved = model.at(model.vector() + 0.01)
    assert [e.key for e in moved.effects] == [e.key for e in model.effects]
    assert [e.key for e in model.without(0).effects] == [model.effects[1].key]


def test_two_of_a_kind_are_two(finding):
    twice = finding.fit.model.adding(finding.fit.model.effects[0])
    assert len({e.key for e in twice.effects}) == len(twice.effects) == 3


def test_what_an_effect_is_worth_is_open_again_where_another_fit_moves_it(finding):
    first, second = finding.fit.model.effects
    finding.worths = {e.key: Worth(evidence=50.0, held_out=1.0) for e in (first, second)}
    model = finding.fit.model.replacing(0, first.moved(first.p + 0.1))
    finding.refitted(refit(finding.data, model, iterations=0))
    assert set(finding.worths) == {second.key} and finding.worth_of(1).evidence == 50.0
    assert finding.worth_of(0).evidence != 50.0


def test_a_fit_that_the_time_cut_short_does_not_say_what_an_effect_is_worth(finding, monkeypatch):
    """No effect explains more nats than all of them together do."""

    def cut_short(data, model, known):
        finding.data = replace(finding.data, deadline=-np.inf)
        return refit(data, replace(model, base=3 * model.base), iterations=0)

    explained = finding.data.count * np.log(finding.twin.sigma2 / finding.fit.sigma2)
    monkeypatch.setattr(findings, "refit_or_known", cut_short)
    assert 8 < finding.gain_of(0) < 1.05 * explained
    assert finding.worth_of(0).held_out is None
    assert not finding.complete  # nothing proved it
