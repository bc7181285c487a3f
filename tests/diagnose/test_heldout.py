# SPDX-License-Identifier: GPL-3.0-or-later
"""Gains are measured on samples that nothing was fitted to, and time that is over ends the search."""

import numpy as np
import pytest
from gr_cast.diagnose import align, diagnose, heldout, read_case
from gr_cast.diagnose.search import refit
from gr_cast.effects import FAMILIES
from gr_cast.effects.base import start


@pytest.fixture
def part(world, tmp_path):
    folder = world.write(tmp_path / "case", world.noisy(world.clean() + 0.02))
    case = read_case(folder)
    return align.build(case, align.parts_of(case, case.observations[0])[0][0])


def test_the_likelihood_of_the_vault_is_that_of_a_circular_gaussian(part):
    _, data, model = part
    fit = refit(data, model)
    r = fit.residual[data.vault]
    by_hand = sum(-abs(v) ** 2 / fit.sigma2 - np.log(np.pi * fit.sigma2) for v in r)
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


def test_a_budget_that_is_over_leaves_an_unexplained_case_with_what_was_found(world, tmp_path):
    folder = world.write(tmp_path / "case", world.noisy(world.clean() + 0.02))
    document = diagnose(read_case(folder), budget_s=0.2).document
    assert document["verdict"] == "unexplained"
    assert document["seconds"] < 20
