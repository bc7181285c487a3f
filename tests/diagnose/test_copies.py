# SPDX-License-Identifier: GPL-3.0-or-later
"""What is sent, once more in what is left: a copy that no map of powers shows, and nothing that noise itself is."""

import numpy as np
import pytest
from conftest_world import sent_once
from gr_cast.diagnose import diagnose
from gr_cast.diagnose.copies import line


def _noise(rng, count, taps=(1.0,)):
    white = rng.normal(size=count + len(taps) - 1) + 1j * rng.normal(size=count + len(taps) - 1)
    return np.convolve(white, taps, "valid") / np.sqrt(2 * np.sum(np.square(taps)))


@pytest.mark.parametrize("taps", [(1.0,), np.hanning(5)])
def test_chance_has_a_copy_at_one_carrier_as_seldom_as_is_told(taps):
    """White or filtered, under a signal that is narrow too: of 200 draws, by the union bound, a tenth has a p-value of 0.1."""
    rng, count = np.random.default_rng(5), 6000
    told = [line(_noise(rng, count, taps), _noise(rng, count, np.hanning(9)))[0] + np.log(count) for _ in range(200)]
    assert 0.03 < np.mean(np.exp(told) < 0.1) < 0.16


@pytest.mark.parametrize("carrier", [0.0, 0.5, -0.1234])
def test_a_copy_is_found_at_its_carrier_with_what_it_holds(carrier):
    rng, count = np.random.default_rng(6), 20_000
    copy = _noise(rng, count, np.hanning(9))
    log_p, nats, cycles = line(_noise(rng, count) + 0.1 * copy * np.exp(2j * np.pi * carrier * np.arange(count)), copy)
    assert log_p < -50 and abs(np.exp(2j * np.pi * cycles) - np.exp(2j * np.pi * carrier)) < 2 * np.pi / count
    assert abs(nats - 0.01 * count) < 4 * np.sqrt(2 * 0.01 * count)


def _interleaved(y):
    """Two converters by turns, of which one is louder."""
    return y * (1 + 0.04 * (-1.0) ** np.arange(len(y)))


def _coloured_image(y):
    """A mirror image that is late in one part of the receiver."""
    return y + 0.04 * np.conj(np.roll(y, 5))


@pytest.mark.parametrize("fault", [None, _interleaved, _coloured_image])
def test_what_no_family_is_does_not_pass_for_noise_that_follows_the_signal(tmp_path, fault):
    rng, count = np.random.default_rng(7), 12_000
    x = _noise(rng, count, np.hanning(7))
    y = x if fault is None else fault(x)
    document = diagnose(sent_once(tmp_path, y + 0.05 * _noise(rng, count), x)).document
    assert document["verdict"] == ("unexplained" if fault else "no_mismatch")
    assert any("once more" in where["test"] for where in document["residual"]["where"]) == bool(fault)
