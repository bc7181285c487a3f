# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose sample clock runs fast: a transmitter's stretches what is sent, so that a path of τ is τ·(1 + ε) of its samples late."""

import numpy as np
import pytest
from conftest_world import RATE_HZ
from gr_cast.diagnose import align, diagnose, read_case, search
from gr_cast.diagnose.view import View
from gr_cast.signals import recording
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start


def sampled(samples: np.ndarray, at: np.ndarray) -> np.ndarray:
    """A periodic waveform (p,) between its samples, by its Fourier series, where `at` (n,) falls."""
    k = np.fft.fftfreq(len(samples), 1 / len(samples))
    terms = np.fft.fft(samples) / len(samples)
    return sum(np.exp(2j * np.pi * f / len(samples) * at) * term for f, term in zip(k, terms, strict=True) if abs(term) > 1e-12)


PPM = 180.0


@pytest.fixture(params=["tx", "rx"])
def side(request):
    return request.param


@pytest.fixture
def heard(world, tmp_path, side):
    """Effects that the twin knows → the diagnosis of a recording with a fast clock on a side."""

    def document(*known, carrier_hz=0.0):
        world.taps, world.noise_rms = [(0, 1.0), (120, 0.6 * np.exp(0.7j))], 0.003
        world.x = np.fft.ifft(np.fft.fft(world.x) * (np.abs(np.fft.fftfreq(len(world.x))) < 0.3))
        fast = 1 + PPM * 1e-6
        at = [(world.n - d) * fast if side == "tx" else world.n * fast - d for d, _ in world.taps]
        y = 0.3 * sum(a * sampled(world.x, t - 37) for t, (_, a) in zip(at, world.taps, strict=True))
        y = y * np.exp(2j * np.pi * carrier_hz / RATE_HZ * world.n * (fast if side == "rx" else 1.0))
        twin = world.twin() | {"waveforms": {"w1": {"file": "sent", "repeat": True}}, "effects": [*known]}
        world.twin = lambda: twin
        folder = world.write(tmp_path / "case", world.noisy(y))
        recording.write(folder / "sent", world.x, sample_rate_hz=RATE_HZ)
        return diagnose(read_case(folder), budget_s=300).document

    return document


def test_a_clock_on_either_side_is_a_clock_and_no_path_that_is_late(heard, side):
    (told,) = heard()["effects"]
    assert told["family"] == "sample_clock_offset"
    clock = told["parameters"]["offset_ppm"]
    assert clock["value"] == pytest.approx(PPM, abs=4 * clock["std"])
    assert told["model"]["at"] == side and told["owner"]["level"] == side


def test_a_transmitters_clock_that_the_twin_knows_is_no_path_that_is_late(heard):
    """Whoever made the twin may say whose clock it is and mean what came, or what was sent."""
    owner, parameters = {"level": "tx", "name": "tx1"}, {"offset_ppm": {"value": PPM, "std": 0.1}}
    assert heard({"family": "sample_clock_offset", "owner": owner, "parameters": parameters})["verdict"] == "no_mismatch"


def test_a_carrier_that_the_twin_knows_turns_by_the_receivers_clock(heard, side):
    """And has no other offset for that, whoever's clock runs fast."""
    carrier_hz, owner = 41e3, {"level": "rx", "name": "rx1"}
    parameters = {"offset_hz": {"value": carrier_hz, "std": 0.0}}
    known = {"family": "carrier_frequency_offset", "owner": owner, "parameters": parameters}
    (told,) = heard(known, carrier_hz=carrier_hz)["effects"]
    assert told["family"] == "sample_clock_offset" and told["owner"]["level"] == side
    assert told["parameters"]["offset_ppm"]["value"] == pytest.approx(PPM, abs=4 * told["parameters"]["offset_ppm"]["std"])


def test_a_view_sees_what_a_receivers_clock_makes_of_a_carrier(world, tmp_path):
    """What it puts on every path is what the fit has there, whoever's time counts."""
    owner, parameters = {"level": "rx", "name": "rx1"}, {"offset_hz": {"value": 41e3, "std": 0.0}}
    twin = world.twin() | {"effects": [{"family": "carrier_frequency_offset", "owner": owner, "parameters": parameters}]}
    world.twin = lambda: twin
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    _, data, model = align.build(case, case.observations[0])
    clock = start(FAMILIES["sample_clock_offset"], [200e-6 * data.scene.span], aux={"side": "rx"})
    view = View(search.refit(data, model.adding(clock)))
    assert np.abs(view.tap_signals.sum(axis=0) - view.fit.chain.y).max() < 1e-9
    turned = np.exp(2j * np.pi * 41e3 / RATE_HZ * world.n * 200e-6)
    bare = View(search.refit(data, model)).receiver
    apart = view.receiver / np.abs(view.receiver) / (bare / np.abs(bare)) * np.conj(turned)[data.scene.index.astype(int)]
    assert np.abs(apart / apart[0] - 1).max() < 0.02  # of a radian; what both fits differ by
