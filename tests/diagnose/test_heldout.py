# SPDX-License-Identifier: GPL-3.0-or-later
"""Gains are measured on samples that nothing was fitted to, and time that is over ends the search."""

import time
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.diagnose import align, diagnose, heldout, read_case
from gr_cast.diagnose.maps import power_of
from gr_cast.diagnose.residual import Leftover
from gr_cast.diagnose.search import proven, refit
from gr_cast.diagnose.verdict import conclude
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


@pytest.fixture
def part(world, tmp_path):
    folder = world.write(tmp_path / "case", world.noisy(world.clean() + 0.02))
    case = read_case(folder)
    return align.build(case, align.parts_of(case, case.observations[0])[0][0])


def test_the_likelihood_of_the_vault_is_that_of_a_circular_gaussian(part):
    _, data, model = part
    fit = refit(data, model)
    r = fit.residual[data.vault]
    by_hand = sum(-(abs(v) ** 2) / fit.sigma2 - np.log(np.pi * fit.sigma2) for v in r)
    assert heldout.log_likelihood(fit) == pytest.approx(by_hand, rel=1e-9)


def test_what_is_there_gains_on_the_vault_and_what_is_not_gains_nothing(part):
    _, data, model = part
    plain = refit(data, model)
    with_dc = refit(data, model.adding(start(FAMILIES["dc_offset"], [0.0, 0.0, 0.0], free=[True, True, False])))
    lags = start(FAMILIES["front_end_filter"], np.zeros(64), aux={"low": -16, "high": 16, "side": "tx", "source": 0})
    bent = refit(data, with_dc.model.adding(lags))
    gain = heldout.log_likelihood(with_dc) - heldout.log_likelihood(plain)
    # per sample, DC of 0.02 over noise of 0.01 rms was ln(1 + 4) nats
    assert gain == pytest.approx(np.log(5) * data.vault.sum(), rel=0.1)
    assert bent.likelihood > with_dc.likelihood + 10  # 64 numbers bend to noise on the samples fitted
    assert heldout.log_likelihood(bent) < heldout.log_likelihood(with_dc)  # and pay for it on the others


def test_folds_hold_out_fitted_samples_and_leave_the_vault_alone(part):
    _, data, _ = part
    first, second = heldout.folds(data)
    for fold in (first, second):
        assert not (fold.vault & data.vault).any()
        assert (((fold.use > 0) | fold.vault) == (data.use > 0)).all() and not ((fold.use > 0) & fold.vault).any()
        assert fold.vault.sum() == pytest.approx(data.count / 4, rel=0.05)
    assert not (first.vault & second.vault).any()


def test_what_only_imitates_is_taken_out_and_what_is_there_stays(part):
    _, data, model = part
    there = start(FAMILIES["dc_offset"], [0.0, 0.0, 0.0], free=[True, True, False])
    lags = start(FAMILIES["front_end_filter"], np.zeros(64), aux={"low": -16, "high": 16, "side": "tx", "source": 0})
    both = refit(data, model.adding(there).adding(lags))
    assert [e.family for e in proven(data, both, []).model.found] == ["dc_offset"]


def test_a_budget_that_is_over_leaves_an_unexplained_case_with_what_was_found(world, tmp_path):
    folder = world.write(tmp_path / "case", world.noisy(world.clean() + 0.02))
    document = diagnose(read_case(folder), budget_s=0.2).document
    assert document["verdict"] == "unexplained" and document["residual"]["out_of_time"]
    assert document["seconds"] < 20


def test_a_cause_is_not_claimed_against_unseen_samples(world, tmp_path):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + 0.02)))
    (finding,) = diagnose(case).findings
    index = next(i for i, e in enumerate(finding.fit.model.effects) if e.family == "dc_offset")
    finding.worths[finding.fit.model.effects[index].key] = replace(finding.worth_of(index), held_out=-300.0)
    document = conclude(case, [finding], lambda entries: [])
    assert document["verdict"] == "unexplained" and not document["effects"]


def test_a_cause_that_is_likelier_wrong_than_right_is_left_and_not_claimed(world, tmp_path):
    """One that explains less than what is left unexplained may as well be a part of it, unless that is in samples of its own."""
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + 0.02)))
    (finding,) = diagnose(case).findings
    index = next(i for i, e in enumerate(finding.fit.model.effects) if e.family == "dc_offset")
    finding.worths[finding.fit.model.effects[index].key] = replace(finding.worth_of(index), rivals=[])
    for louder, apart, claimed in ((0.5, False, True), (2.0, False, False), (2.0, True, True)):
        rest = Leftover(test="time", p_value=0.0, nats=louder * finding.gain_of(index), where={}, apart=apart)
        finding.left, finding.ambiguous = [rest], []
        document = conclude(case, [finding], lambda entries: [])
        unsure = [w for w in document["residual"]["where"] if "confidence" in w]
        assert document["verdict"] == "unexplained" and bool(document["effects"]) == claimed == (not unsure)
        assert all(0.1 < w["confidence"] < 0.5 and "DC" in w["sentence"] for w in unsure)


@pytest.mark.parametrize("held_out", [None, 50.0])
@pytest.mark.parametrize("left", [0.9, 1.1])
@pytest.mark.parametrize("complete", [True, False])
def test_what_leaves_more_than_is_left_without_it_is_not_claimed_unless_unseen_samples_want_it(
    world, tmp_path, held_out, left, complete
):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + 0.02)))
    (finding,) = diagnose(case).findings
    index = next(i for i, e in enumerate(finding.fit.model.effects) if e.family == "dc_offset")
    finding.worths[finding.fit.model.effects[index].key] = replace(finding.worth_of(index), held_out=held_out)
    finding.steps, finding.complete = [(index, left * power_of(finding.twin))], complete
    document = conclude(case, [finding], lambda entries: [])
    is_told = left < 1 or held_out is not None
    assert bool(document["effects"]) == is_told
    assert (document["verdict"] == "unexplained") == (not is_told or not complete)
    assert document["residual"]["out_of_time"] == (not complete)
    assert is_told or any("DC" in place.get("sentence", "") for place in document["residual"]["where"])


def test_a_wild_sample_that_was_held_out_says_no_more_than_the_others_can(part):
    _, data, model = part
    fit, wild = refit(data, model), data.y.copy()
    wild[np.flatnonzero(data.vault)[100]] += 1e6
    there = refit(replace(data, y=wild), model)
    most = (data.count + data.vault.sum()) * np.log(1e12 / fit.sigma2 / data.count)
    assert 0 < heldout.gained(fit, there) < 1.01 * most
    assert heldout.log_likelihood(fit) - heldout.log_likelihood(there) > 1e12


def test_what_an_effect_gains_on_the_vault_is_the_ratio_of_likelihoods(part):
    _, data, model = part
    fit = refit(data, model)
    other = replace(fit, residual=fit.residual * 1.05)
    plain = heldout.log_likelihood(fit) - heldout.log_likelihood(other)
    assert heldout.gained(fit, other) == pytest.approx(plain, rel=0.01)


def test_held_out_samples_around_a_moment_say_nothing_of_it_and_others_do(part):
    _, data, model = part
    runs = np.flatnonzero(data.vault)
    first, far = (int(runs[runs > at][0]) for at in (9_000, 12_000))
    y = data.y * np.where(np.arange(len(data.y)) < first, 1.0, 2.0)
    effect = start(FAMILIES["gain_step"], [0.0, data.scene.index[first] / data.scene.span], free=[True, False])

    def gained(at: int) -> float:
        """Nats of the step, with the held-out samples from `at` on as loud as before it."""
        late = replace(data, y=np.where(data.vault & (abs(np.arange(len(y)) - at - 8) <= 8), data.y, y))
        return heldout.gained(refit(late, model.adding(effect)), refit(late, model))

    there = gained(-100)
    assert there > 100 and gained(first) == pytest.approx(there, rel=1e-9)
    assert gained(far) < there - 100


def test_waiting_for_other_programs_takes_nothing_from_a_budget(world, tmp_path):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    document = diagnose(case, budget_s=10.0, progress=lambda where: time.sleep(11.0)).document
    assert document["verdict"] == "no_mismatch" and document["seconds"] > 11.0


@pytest.mark.parametrize("in_the_vault", [False, True])
def test_few_impulses_are_told_whether_or_not_samples_held_out_have_one(world, tmp_path, in_the_vault):
    quiet = world.noisy(world.clean())
    case = read_case(world.write(tmp_path / "quiet", quiet))
    _, data, _ = align.build(case, align.parts_of(case, case.observations[0])[0][0])
    fitted, held_out = (np.flatnonzero(where) for where in (data.use > 0, data.vault))
    at = np.concatenate([world.rng.choice(fitted, 7, replace=False), held_out[100:101] if in_the_vault else []]).astype(int)
    quiet[at] += 4.5 * world.noise_rms * np.exp(1j * world.rng.uniform(0, 6.28, len(at)))
    (told,) = diagnose(read_case(world.write(tmp_path / "case", quiet))).document["effects"]
    assert told["family"] == "impulsive_noise" and (told["evidence"]["heldout_gain_nats"] > 0) == in_the_vault
