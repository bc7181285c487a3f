# SPDX-License-Identifier: GPL-3.0-or-later
"""Effects that others may stand in the place of: taken where they explain more, left open where they explain as much."""

from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose import align, ambiguity, read_case
from gr_cast.diagnose.exchange import exchanged
from gr_cast.diagnose.search import candidates, refit
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


@pytest.fixture
def one_path(world):
    """A world whose twin has one path."""
    world.taps = world.taps[:1]
    world.noise_rms = 0.003
    return world


def _as_an_echo(world, folder, y):
    """The best fit with an echo alone."""
    case = read_case(world.write(folder, world.noisy(y)))
    _, data, model = align.build(case, case.observations[0])
    plain = refit(data, model)
    echo = next(s.effect for s in candidates(plain) if s.effect.family == "extra_path")
    return refit(data, model.adding(echo)), plain


def test_a_tail_that_was_taken_for_an_echo_becomes_one(one_path, tmp_path):
    late = np.arange(1, 25)
    gains = 0.02 * np.exp(-late / 8) * np.exp(1j * one_path.rng.uniform(0, 2 * np.pi, len(late)))
    tail = 0.3 * np.exp(0.4j) * sum(g * one_path.path(d) for d, g in zip(late, gains, strict=True))
    fit, plain = _as_an_echo(one_path, tmp_path / "case", one_path.clean() + tail)
    assert {e.family for e in exchanged(fit, [plain, fit]).model.found} == {"diffuse_tail"}


def test_an_echo_stays_one(one_path, tmp_path):
    echo = 0.3 * np.exp(1.4j) * 0.03 * one_path.path(23)
    fit, plain = _as_an_echo(one_path, tmp_path / "case", one_path.clean() + echo)
    assert [e.family for e in exchanged(fit, [plain, fit]).model.found] == ["extra_path"]


def _rival(family, evidence):
    effect = start(FAMILIES[family], np.zeros(4), prior=np.ones(4), aux={"source": 0})
    return ambiguity.Rival(effect=effect, evidence=evidence, likelihood=evidence, fit=SimpleNamespace())


def test_a_short_tail_that_explains_as_much_as_an_echo_is_left_open_with_what_resembles_it():
    echo = start(FAMILIES["extra_path"], np.zeros(4), aux={"source": 0})
    tail, row, far = _rival("diffuse_tail", 1.7), _rival("front_end_filter", 9.0), _rival("front_end_filter", 15.0)
    left_open = [r.evidence for r in ambiguity.all_alike(echo, [tail, row, far])]
    assert left_open == [1.7, 9.0]
    assert not ambiguity.all_alike(echo, [_rival("diffuse_tail", 4.0), row])
