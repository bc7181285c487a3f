# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenario → emulate → sound → the same scenario."""

import numpy as np
from gnuradio import blocks, gr
from gr_cast.blocks.flowgraphs import EmulatedSounding, waveform_source
from gr_cast.blocks.network import emulated_network
from gr_cast.scenario import LinkTaps, Scenario
from gr_cast.signals import recording
from gr_cast.signals.waveform import waveform_from_spec
from gr_cast.sounding.sound import sound

RATE_HZ, NODES, SENDERS = 50e6, [str(node) for node in range(1, 11)], ["1", "4", "10"]


def random_scenario(random):
    links = {}
    for link in ((a, b) for a in NODES for b in NODES if a != b):
        delays = np.sort(random.choice(np.arange(0, 256, 2), 4, replace=False)) / RATE_HZ
        gains = 10 ** (random.uniform(-25, -1, 4) / 20) * np.exp(2j * np.pi * random.random(4))
        links[link] = LinkTaps(delay_s=delays, gain=gains)
    return Scenario(name="random", nodes=NODES, links=links)


def test_a_random_scenario_of_ten_nodes_comes_back_within_the_sounders_uncertainty(tmp_path):
    scenario = random_scenario(np.random.default_rng(11))
    spec = {"code": "glfsr", "degree": 9}
    waveform = waveform_from_spec(spec)
    z = []
    for sender in SENDERS:
        stems = {node: tmp_path / f"tx{sender}_rx{node}" for node in NODES if node != sender}
        top = EmulatedSounding(
            scenario, sender, stems, waveform_source(waveform, spec), sample_rate_hz=RATE_HZ, n_samples=511 * 20,
            settle_samples=511, noise_power_db=-30.0, seed=int(sender),
        )  # fmt: skip
        top.run()
        top.finish()
        for node, stem in stems.items():
            taps = sound(recording.read(stem), waveform).taps
            true = scenario.links[(sender, node)]
            assert np.array_equal(np.rint(taps.delay_samples), np.rint(true.delay_s[0] * RATE_HZ))
            z.append((taps.delay_samples - true.delay_s[0] * RATE_HZ) / taps.delay_std_samples)
            z.append((np.abs(taps.gain[:, 0]) - np.abs(true.gain[0])) / taps.gain_std)
            z.append(np.angle(taps.gain[:, 0] / true.gain[0]) / taps.phase_std_rad)
    z = np.concatenate(z)
    assert np.sqrt(np.mean(z**2)) < 1.15, "the reported deviations hold"
    assert np.abs(z).max() < 5


def test_taps_that_move_in_straight_lines_do_so_on_the_emulator_too():
    still = LinkTaps(delay_s=np.array([[0.0]]), gain=np.array([[0.5]]))
    moving = LinkTaps(delay_s=np.zeros((2, 1)), gain=np.array([[0.0], [1.0]], complex))
    scenario = Scenario(
        name="ramp", nodes=["a", "b", "c"], links={("a", "b"): still, ("c", "b"): moving},
        time_s=np.array([0.0, 1e-3]), interpolation="linear", base_loss_db=6.0,
    )  # fmt: skip
    top, sink = gr.top_block(), blocks.vector_sink_c()
    emulator = emulated_network(scenario, ["c"], ["b"], 1e6)
    top.connect(blocks.vector_source_c([1] * 2000), emulator, sink)
    top.run()
    expected = np.minimum(np.arange(2000) / 1000, 1) * 10 ** (-6.0 / 20)
    np.testing.assert_allclose(sink.data(), expected, atol=1e-6)
