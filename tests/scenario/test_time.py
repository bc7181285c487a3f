# SPDX-License-Identifier: GPL-3.0-or-later
"""A scenario begun later, or begun again: the same taps at other times."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.emulation.reference import link_taps, scenario_updates
from gr_cast.scenario import LinkTaps, Scenario
from gr_cast.scenario.reduced import reduced

LINK = ("a", "b")


def moving(interpolation="hold"):
    clock = np.arange(0, 1.01, 0.1)
    gain = np.stack([np.exp(1j * clock), 0.1 + clock], axis=1)
    taps = LinkTaps(delay_s=np.broadcast_to([0.0, 1e-3], gain.shape) * 1e-3, gain=gain)
    return Scenario(name="moving", nodes=LINK, links={LINK: taps}, time_s=clock, interpolation=interpolation)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("held_s", [0.0, 0.03])
def test_a_scenario_begun_later_has_the_taps_of_then(interpolation, held_s):
    scenario, after_s = moving(interpolation), np.array([0.0, 0.01, 0.049, 0.11, 0.3, 0.6])
    begun = sc.begun_at(scenario, 0.35, held_s)
    for here, there in zip(
        sc.taps_at(begun, LINK, after_s + held_s + 1e-12), sc.taps_at(scenario, LINK, 0.35 + after_s), strict=True
    ):
        np.testing.assert_allclose(here, there, atol=1e-9)
    np.testing.assert_allclose(sc.taps_at(begun, LINK, np.zeros(1))[1], sc.taps_at(scenario, LINK, np.array([0.35]))[1])


def test_a_time_outside_of_the_scenario_is_refused():
    with pytest.raises(CastError, match="got 1.5 s, the scenario lasts from 0 to 1 s"):
        sc.begun_at(moving(), 1.5)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_in_cycles_every_turn_is_like_the_first(interpolation):
    rate_hz = 1e3
    updates = scenario_updates(moving(interpolation), rate_hz, until_s=3.0, cycle=True)
    _, taps = link_taps(updates, 3000)
    _, once = link_taps(scenario_updates(moving(interpolation), rate_hz), 1000)
    np.testing.assert_allclose(taps[1000:2000], once, atol=1e-9)
    np.testing.assert_allclose(taps[2000:], once, atol=1e-9)


def test_cycles_in_parts_are_the_cycles():
    whole = scenario_updates(moving(), 1e3, until_s=2.5, cycle=True)
    parts = [scenario_updates(moving(), 1e3, a, b, cycle=True) for a, b in ((0, 0.7), (0.7, 1.6), (1.6, 2.5))]
    _, one = link_taps(whole, 2500)
    _, other = link_taps([update for part in parts for update in part], 2500)
    np.testing.assert_allclose(one, other)


def test_five_taps_become_four_that_the_band_can_hardly_tell():
    """Two taps 10 ns apart are one over 1 MHz: the response of the four, worked out here, is that of the five."""
    delay_s, gain = np.array([[0.0, 1e-6, 1.01e-6, 2e-6, 3e-6]]), np.array([[1.0, 0.5, 0.4j, 0.3, -0.2]])
    five = Scenario(name="five", nodes=LINK, links={LINK: LinkTaps(delay_s=delay_s, gain=gain)})
    four, nmse_db = reduced(five, 1e6)
    frequency_hz = np.linspace(-0.5e6, 0.5e6, 201)
    responses = [
        np.exp(-2j * np.pi * np.outer(frequency_hz, taps.delay_s[0])) @ taps.gain[0]
        for taps in (four.links[LINK], five.links[LINK])
    ]
    error = np.sum(np.abs(responses[0] - responses[1]) ** 2) / np.sum(np.abs(responses[1]) ** 2)
    assert four.links[LINK].gain.shape == (1, 4)
    assert 10 * np.log10(error) == pytest.approx(nmse_db[LINK], abs=0.5) and nmse_db[LINK] < -25
    assert reduced(replace(four), 1e6)[1] == {}
