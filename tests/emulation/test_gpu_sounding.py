# SPDX-License-Identifier: GPL-3.0-or-later
"""A scenario of ten nodes, played as a graphics card computes it, is sounded as what it is. On a card with CAST_DEVICE=cuda."""

import os

import numpy as np
import pytest
from gr_cast.comparing.validation import check_link
from gr_cast.emulation.gpu.device import open_device
from gr_cast.emulation.gpu.form import Form
from gr_cast.emulation.gpu.network import DeviceNetwork
from gr_cast.emulation.gpu.scenario import send_update
from gr_cast.emulation.reference import emulate, filter_length, scenario_updates
from gr_cast.scenario import LinkTaps, Scenario
from gr_cast.scenario.model import GRID_STEP_S

NODES = tuple(f"n{k}" for k in range(10))
LIMIT_DB = {"fp32": -95, "tf32": -65}


def random_scenario(rng) -> Scenario:
    def taps():
        delay_s = np.sort(rng.choice(500, (1, 4), replace=False)) * GRID_STEP_S
        gain = 10 ** (rng.uniform(-15, 0, (1, 4)) / 20) * np.exp(2j * np.pi * rng.random((1, 4)))
        return LinkTaps(delay_s=delay_s, gain=gain)

    return Scenario(name="ten", nodes=NODES, links={(a, b): taps() for a in NODES for b in NODES if a != b}, base_loss_db=30.0)


@pytest.mark.parametrize("precision", LIMIT_DB)
def test_links_of_ten_nodes_are_recovered_within_the_sounders_uncertainty(precision):
    rng = np.random.default_rng(1)
    scenario, ops = random_scenario(rng), open_device(os.environ.get("CAST_DEVICE", "numpy"))

    def play(frozen, sent, rate_hz):
        """The link alone on the air, among all others; what is heard is also the reference's."""
        link = Scenario(name="ten", nodes=NODES, links=scenario.links | {("n3", "n7"): frozen.links["tx", "rx"]})
        n_taps = filter_length(rate_hz)
        network = DeviceNetwork(ops, Form(n_inputs=10, n_outputs=10, n_taps=n_taps, precision=precision, n_bins=4096))
        updates = scenario_updates(link, rate_hz)
        for update in updates:
            send_update(network, update)
        inputs = np.zeros((10, n_taps - 1 + len(sent)), np.complex64)
        inputs[3, n_taps - 1 :] = sent
        heard = network.process(inputs)
        law = emulate(inputs[:, n_taps - 1 :][:, :5000], updates, 10)
        error = np.mean(np.abs(heard[:, :5000] - law) ** 2) / np.mean(np.abs(law) ** 2)
        assert 10 * np.log10(error) < LIMIT_DB[precision]
        return heard[7]

    assert check_link(scenario, ("n3", "n7"), 0.0, play=play).holds
