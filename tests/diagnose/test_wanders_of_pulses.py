# SPDX-License-Identifier: GPL-3.0-or-later
"""An oscillator that wanders under pulses: between them nobody hears it."""

import numpy as np
import pytest
from conftest_world import COUNT, RATE_HZ, World
from gr_cast.diagnose import align, diagnose, heldout, read_case
from gr_cast.diagnose.search import refit
from gr_cast.signals import recording
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.effects.phase_noise import shape_of


def course(rng, orders: int, rms: float) -> np.ndarray:
    """(COUNT,) random phase on cosines, all of one variance."""
    u = (np.arange(COUNT) + 0.5) / COUNT
    return rms * np.sqrt(2 / orders) * sum(rng.normal() * np.cos(np.pi * k * u) for k in range(1, orders + 1))


class Pulses(World):
    """Pulses of ten samples of random phases, one sample in four on the air, over one path."""

    def __init__(self, seed: int):
        super().__init__(seed)
        on = (np.arange(1500) % 40 < 10) * 1.0
        self.x = on * np.exp(2j * np.pi * np.repeat(self.rng.integers(0, 4, 150), 10) / 4)
        self.taps = [(0, 1.0)]

    def twin(self):
        return super().twin() | {"waveforms": {"w1": {"file": "sent"}}}

    def case(self, folder, y):
        self.write(folder, self.noisy(y))
        recording.write(folder / "sent", self.x, sample_rate_hz=RATE_HZ)
        return read_case(folder)


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("orders", [100, 400])
def test_its_size_is_that_of_the_phases_that_are_heard(tmp_path, seed, orders):
    world = Pulses(seed)
    phase = course(world.rng, orders, 0.2)
    (effect,) = diagnose(world.case(tmp_path / "case", world.clean() * np.exp(1j * phase))).document["effects"]
    assert effect["family"] == "phase_noise"
    assert effect["parameters"]["rms_rad"]["value"] == pytest.approx(phase.std(), rel=0.15)


def test_unseen_samples_are_foretold_with_what_is_not_known_of_a_course(tmp_path):
    """Their energies over what is expected of them have the mean 1, in silence between pulses as during them."""
    world = Pulses(3)
    phase = course(world.rng, 400, 0.2)
    case = world.case(tmp_path / "case", world.clean() * np.exp(1j * phase))
    _, data, model = align.build(case, case.observations[0])
    wander = start(FAMILIES["phase_noise"], np.zeros(480), prior=shape_of({"law": "flat"}, 480) * 1e-4, aux={"law": "flat"})
    for part in heldout.folds(data):
        fit = refit(part, model.adding(wander))
        loud = part.vault & (np.abs(fit.chain.wanted) > 0.1)
        variance = fit.sigma2 + heldout._left_open(fit)
        assert np.mean(np.abs(fit.residual[loud]) ** 2 / variance[loud]) == pytest.approx(1.0, abs=0.25)
        assert np.mean(np.abs(fit.residual[loud]) ** 2) > 1.5 * fit.sigma2  # without that they would be too loud


def test_the_scale_of_a_course_is_found_though_nothing_is_heard_of_most_of_it():
    """One number in ten is told, with a variance of 0.01, of numbers whose variance is 1; the search begins 30 times off."""
    rng, told = np.random.default_rng(2), np.arange(1000) % 10 == 0
    seen = rng.normal(size=1000) + 0.1 * rng.normal(size=1000)
    effect = start(FAMILIES["phase_noise"], np.zeros(1000), prior=np.full(1000, 30.0))
    for _ in range(4):
        known = np.where(told, 100.0, 0.0)
        covariance = np.diag(1 / (known + 1 / effect.prior))
        effect = FAMILIES["phase_noise"].likelier(effect.moved(covariance @ (known * seen)), covariance)
    assert effect.prior[0] == pytest.approx(1.0, rel=0.3)
