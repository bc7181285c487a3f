# SPDX-License-Identifier: GPL-3.0-or-later
"""No effect is claimed whose size is nothing within its error, that only cancels another, or that held-out samples contradict."""

from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose import align, claims, finding, policy, read_case
from gr_cast.diagnose.finding import Worth
from gr_cast.diagnose.search import plausible, refit
from gr_cast.diagnose.verdict import Told
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.model import Model, predict


@pytest.fixture
def part(world, tmp_path):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + 0.02)))
    return align.build(case, align.parts_of(case, case.observations[0])[0][0])


def dc(level=0.0):
    return start(FAMILIES["dc_offset"], [level, 0.0, 0.0], free=[True, True, False])


def test_the_size_of_what_is_there_is_many_errors_and_of_what_is_not_a_few(part):
    _, data, model = part
    fit = refit(data, model.adding(dc()).adding(start(FAMILIES["iq_imbalance"], [0.0, 0.0], aux={"side": "rx"})))
    by_family = {e.family: claims.sigmas(fit, i) for i, e in enumerate(fit.model.effects)}
    # 0.02 over noise of 0.01 rms: |c|²/(σ²/2n) is chi-square over its mean of 2
    assert by_family["dc_offset"] == pytest.approx(np.sqrt(0.02**2 * 2 * data.count / 0.01**2), rel=0.1)
    assert by_family["iq_imbalance"] < policy.SIZE_SIGMA
    assert fit.model.effects[claims.unsure(fit)].family == "iq_imbalance"


def test_of_two_that_cancel_each_other_one_is_not_claimed(part):
    scene, data, model = part
    alone = refit(data, model.adding(dc()))
    assert claims.unsure(alone) is None
    # with one carrier for both, a leak of the transmitter is a constant too: a great one, and its opposite after the mixer
    leaking = alone.model.adding(start(FAMILIES["lo_leakage"], [2.0, 0.0], aux={"source": 0}))
    added = np.mean(predict(scene, leaking).y - alone.chain.y) / scene.rms
    at = next(k for k, e in enumerate(leaking.effects) if e.family == "dc_offset")
    opposite = leaking.effects[at].moved(leaking.effects[at].p - [added.real, added.imag, 0.0])
    both = refit(data, leaking.replacing(at, opposite), iterations=0)
    assert both.likelihood == pytest.approx(alone.likelihood, abs=1.0)
    assert claims.unsure(both) is not None


@pytest.mark.parametrize("evidence, held_out, is_broken", [(400.0, 60.0, False), (400.0, -20.0, True), (-51.0, 5.0, True)])
def test_held_out_samples_contradict_what_loses_there_what_fitted_ones_promise(part, evidence, held_out, is_broken):
    """And what the fitted ones are likelier without stays in no model, whatever it brought when it was found."""
    _, data, model = part
    fit = refit(data, model.adding(dc()))
    worth = Worth(evidence=evidence, held_out=held_out)
    assert (claims.broken(SimpleNamespace(fit=fit, worth_of=lambda i: worth)) is not None) == is_broken


@pytest.mark.parametrize("told, is_throughout", [(range(20_000), True), (range(2_000, 2_400), False)])
def test_an_offset_in_one_burst_alone_is_no_receivers_dc(world, tmp_path, told, is_throughout):
    """Fitted to the whole recording it makes the burst likelier, and everything else less likely than without."""
    y = world.noisy(world.clean())
    y[told] += 0.02
    case = read_case(world.write(tmp_path / "case", y))
    _, data, model = align.build(case, case.observations[0])
    fit, bare = refit(data, model.adding(dc())), refit(data, model)
    assert fit.evidence > bare.evidence + 10.0
    worth = finding.worth(fit, bare)
    assert worth.throughout == is_throughout
    assert (claims.broken(SimpleNamespace(fit=fit, worth_of=lambda i: worth)) is None) == is_throughout


@pytest.mark.parametrize("ripple, is_broken", [(0.018, True), (0.18, False)])
def test_a_filter_that_is_hardly_one_and_brings_little_is_not_claimed(part, monkeypatch, ripple, is_broken):
    _, data, model = part
    filtering = start(FAMILIES["front_end_filter"], [0.001, 0.0], aux={"low": 0, "high": 1, "side": "tx", "source": 0})
    fit = SimpleNamespace(data=data, model=model.adding(filtering))
    monkeypatch.setattr(claims, "numbers", lambda f, i: ({"ripple_db": {"value": ripple, "std": 0.009}}, {}))
    weighed = SimpleNamespace(fit=fit, worth_of=lambda i: Worth(evidence=60.0, held_out=15.0))
    assert (claims.broken(weighed) is not None) == is_broken


@pytest.mark.parametrize("compression, is_broken", [(0.004, True), (0.4, False)])
def test_an_amplifier_that_hardly_compresses_and_brings_little_is_not_claimed(part, monkeypatch, compression, is_broken):
    _, data, model = part
    fit = SimpleNamespace(data=data, model=model.adding(start(FAMILIES["pa_nonlinearity"], [compression])))
    monkeypatch.setattr(claims, "numbers", lambda f, i: ({"compression_db": {"value": compression, "std": 0.005}}, {}))
    weighed = SimpleNamespace(fit=fit, worth_of=lambda i: Worth(evidence=60.0, held_out=5.0))
    assert (claims.broken(weighed) is not None) == is_broken
    told = Told(
        members=[(weighed, 0)], finding=weighed, index=0, owner={}, shared=set(), nats=60.0, held_out=5.0
    )  # no time was left
    assert told.claimed != is_broken


def test_a_path_that_comes_and_goes_is_no_row_of_echoes_at_one_delay():
    """Two beat as a tap and its change do; any course of one path is a sum of more, and told so would be the whole truth."""
    echo = lambda delay, doppler: start(FAMILIES["extra_path"], [0.1, 0.0, delay, doppler], aux={"source": 0})  # noqa: E731
    two = Model(base=np.array([0.0, 1.0, 0.0])).adding(echo(20.0, 0.0)).adding(echo(20.1, 1.0))
    assert plausible(two) and plausible(two.adding(echo(22.0, 2.0)))
    assert not plausible(two.adding(echo(20.2, 2.0)))


@pytest.mark.parametrize("share, is_unfounded", [(0.02, True), (0.98, True), (0.4, False)])
def test_a_step_where_a_gain_that_fades_begins_or_ends_is_its_own(part, share, is_unfounded):
    """Cosines have no slope at their ends: with ten of them a moment within a tenth of the recording mends that."""
    _, data, model = part
    fading = start(FAMILIES["tap_fading"], np.zeros(20), aux={"tap": 0}, prior=np.ones(20))
    step = start(FAMILIES["gain_step"], [-0.3, share], free=[True, False])
    for effects in ((fading, step), (step,)):
        fit = SimpleNamespace(data=data, model=Model(base=model.base, effects=effects))
        weighed = SimpleNamespace(fit=fit, worth_of=lambda i: Worth(evidence=300.0, held_out=60.0))
        assert claims.is_unfounded(weighed, len(effects) - 1) == (is_unfounded and len(effects) == 2)
