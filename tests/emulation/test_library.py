# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.emulation.network import emulate_network
from gr_cast.scenario import LinkTaps, Scenario
from gr_cast.signals.recording import Recording


def test_what_changes_in_a_scenario_is_heard_from_that_instant_on():
    rate_hz, count = 1e6, 400
    taps = LinkTaps(delay_s=np.array([[0.0], [0.0]]), gain=np.array([[1.0], [0.25j]]))
    scenario = Scenario(name="step", nodes=("a", "b"), links={("a", "b"): taps}, time_s=np.array([0.0, 2e-4]))
    sent = Recording(samples=np.ones(count, np.complex64), sample_rate_hz=rate_hz)
    heard = emulate_network(scenario, {"a": sent})["b"]
    late = int(heard.metadata["cast:bulk_delay_samples"])
    assert heard.samples[late + 50 : 190] == pytest.approx(np.ones(140 - late), abs=1e-6)
    assert heard.samples[late + 250 : count] == pytest.approx(np.full(150 - late, 0.25j), abs=1e-6)
