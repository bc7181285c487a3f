# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.emulation.network import emulate_network
from gr_cast.emulation.reference import receiver_noise, scenario_bulk_delay
from gr_cast.scenario import LinkTaps, Scenario
from gr_cast.signals.recording import Recording
from scipy.signal import lfilter


def test_what_changes_in_a_scenario_is_heard_from_that_instant_on():
    rate_hz, count = 1e6, 400
    taps = LinkTaps(delay_s=np.array([[0.0], [0.0]]), gain=np.array([[1.0], [0.25j]]))
    scenario = Scenario(name="step", nodes=("a", "b"), links={("a", "b"): taps}, time_s=np.array([0.0, 2e-4]))
    sent = Recording(samples=np.ones(count, np.complex64), sample_rate_hz=rate_hz)
    heard = emulate_network(scenario, {"a": sent})["b"]
    late = int(heard.metadata["cast:bulk_delay_samples"])
    assert heard.samples[late + 50 : 190] == pytest.approx(np.ones(140 - late), abs=1e-6)
    assert heard.samples[late + 250 : count] == pytest.approx(np.full(150 - late, 0.25j), abs=1e-6)


RATE_HZ = 1e6
CHAIN = Scenario(
    name="chain", nodes=("a", "b", "c"), center_frequency_hz=2e9, base_loss_db=6.0,
    links={("a", "b"): LinkTaps(delay_s=[[0.0, 2e-6]], gain=[[1.0, 0.5j]]), ("b", "c"): LinkTaps(delay_s=[[1e-6]], gain=[[2.0]])},
)  # fmt: skip


def sent(count, seed=0, rate_hz=RATE_HZ):
    rng = np.random.default_rng(seed)
    samples = (rng.normal(size=count) + 1j * rng.normal(size=count)).astype(np.complex64)
    return Recording(samples=samples, sample_rate_hz=rate_hz)


def test_every_node_hears_the_filters_of_its_links_and_the_shorter_recording_ends_in_silence():
    first, second = sent(500), sent(300, 1)
    heard = emulate_network(CHAIN, {"b": second, "a": first})
    loss = 10 ** (-6 / 20)
    padded = np.append(second.samples, np.zeros(200))
    np.testing.assert_allclose(heard["b"].samples, loss * lfilter([1, 0, 0.5j], 1, first.samples), rtol=0, atol=1e-6)
    np.testing.assert_allclose(heard["c"].samples, loss * lfilter([0, 2], 1, padded), rtol=0, atol=1e-6)
    assert list(heard) == ["a", "b", "c"] and not heard["a"].samples.any()
    for node, recorded in heard.items():
        assert recorded.samples.dtype == np.complex64
        assert (recorded.sample_rate_hz, recorded.center_frequency_hz) == (RATE_HZ, 2e9)
        assert recorded.metadata == {
            "cast:scenario": "chain", "cast:seed": 0, "cast:bulk_delay_samples": 0, "cast:receiver": node,
        }  # fmt: skip
    assert emulate_network(CHAIN, {"a": first})["c"].metadata["cast:transmitter"] == "a"


def test_every_receiver_has_its_own_noise_of_the_power_that_is_told():
    heard = emulate_network(CHAIN, {"a": sent(40_000)}, noise_power_db=-20.0, seed=7)
    quiet = emulate_network(CHAIN, {"a": sent(40_000)})
    for index, node in enumerate("abc"):
        noise = heard[node].samples - quiet[node].samples
        np.testing.assert_allclose(noise, 0.1 * receiver_noise(7, index, 40_000), atol=1e-6)
        assert heard[node].metadata["cast:seed"] == 7


@pytest.mark.parametrize(
    ("recordings", "says"),
    [
        ({}, "chain: sent: got nothing, the scenario has a, b, c"),
        ({"x": sent(9), "y": sent(9), "a": sent(9)}, "chain: sent: got x, y, the scenario has a, b, c"),
        ({"a": sent(9), "b": sent(9, rate_hz=2e6)}, "sent: sample rates: got .*, needs one"),
        ({"a": sent(9, rate_hz=None)}, "sent: sample rates: got None Hz, needs one"),
    ],
)
def test_what_cannot_be_played_is_refused(recordings, says):
    with pytest.raises(CastError, match=says):
        emulate_network(CHAIN, recordings)


def test_delays_between_samples_cost_a_delay_that_is_told():
    between = Scenario(name="s", nodes=("a", "b"), links={("a", "b"): LinkTaps(delay_s=[[0.5e-6]], gain=[[1.0]])})
    heard = emulate_network(between, {"a": sent(400)})["b"]
    assert heard.metadata["cast:bulk_delay_samples"] == scenario_bulk_delay(between, RATE_HZ) > 0
