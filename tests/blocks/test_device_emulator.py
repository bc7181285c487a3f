# SPDX-License-Identifier: GPL-3.0-or-later
"""The block of a graphics card against the NumPy reference, in real flowgraphs; its arithmetic is that of NumPy here."""

import sys

import numpy as np
import pmt
import pytest
from gnuradio import blocks as stock
from gnuradio import gr
from gr_cast import scenario as sc
from gr_cast.blocks import devices
from gr_cast.blocks.device_emulator import DeviceEmulator
from gr_cast.blocks.emulation import Emulation
from gr_cast.blocks.ports import Port
from gr_cast.emulation.gpu import network as gpu_network
from gr_cast.emulation.gpu.device import open_device
from gr_cast.emulation.gpu.faults import DeviceFault
from gr_cast.emulation.gpu.form import Form
from gr_cast.emulation.gpu.planner import Choice, Task
from gr_cast.emulation.reference import LinkUpdate, emulate
from gr_cast.signals import recording

N_TAPS = 100


def made(**more):
    form = Form(n_inputs=2, n_outputs=3, n_taps=N_TAPS, n_bins=512)
    choice = Choice(form=form, seconds=1e-6, error_db=-130.0, tried=1)
    return DeviceEmulator(2, 3, N_TAPS, 1e6, "s", 5, "numpy", choice=choice, **more)


def noise(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def tag(offset, key, value):
    one = gr.tag_t()
    one.offset, one.key, one.value = offset, pmt.intern(key), pmt.to_pmt(value)
    return one


def play(emulator, inputs, tags=None):
    top = gr.top_block()
    sinks = [stock.vector_sink_c() for _ in range(3)]
    for i, x in enumerate(inputs):
        top.connect(stock.vector_source_c(x.tolist(), False, 1, (tags or {}).get(i, [])), (emulator, i))
    for j, sink in enumerate(sinks):
        top.connect((emulator, j), sink)
    top.run()
    return np.array([sink.data() for sink in sinks], np.complex64), sinks


def random_updates(rng, n):
    for tx, rx, at in [(tx, rx, at) for tx in range(2) for rx in range(3) for at in (0, *rng.integers(1, n, 3))]:
        taps = np.zeros(N_TAPS, complex)
        taps[rng.choice(N_TAPS, 5)] = noise(rng, 5)
        yield LinkUpdate(tx=tx, rx=rx, at_sample=int(at), taps=taps, ramp_samples=int(rng.integers(2) * 3000))


def test_the_block_equals_the_reference_at_every_sample():
    rng = np.random.default_rng(1)
    x, updates = noise(rng, 2, 80_000), list(random_updates(rng, 80_000))
    emulator = made()
    emulator.set_noise_power(2, 0.01)
    for update in updates:
        emulator.set_taps(update.tx, update.rx, update.taps, update.at_sample, update.ramp_samples)
    wanted = emulate(x, updates, 3, noise_power=(0, 0, 0.01), seed=5)
    for turn in range(2):  # a flowgraph that starts again counts from 0
        if turn:
            emulator.clear()
            for update in updates:
                emulator.set_taps(update.tx, update.rx, update.taps, update.at_sample, update.ramp_samples)
        got, _ = play(emulator, x)
        assert np.abs(got - wanted).max() < 2e-6 * np.abs(wanted).max()
    status = pmt.to_python(emulator.status())
    assert status["samples"] == 80_000 and status["late_updates"] == 0 and "512 bins" in status["plan"]
    assert emulator.active_links() == 6


def test_messages_change_taps_at_their_sample_and_malformed_ones_are_refused():
    emulator = made()
    for message in (
        {"tx": 0, "rx": 1, "offset": 777, "taps": np.array([0, 2], np.complex64)},
        {"tx": 9, "rx": 1, "taps": [1]},
        7,
    ):
        emulator._take(pmt.to_pmt(message))
    got, _ = play(emulator, np.ones((2, 2000), np.complex64))
    np.testing.assert_allclose(got[1], np.r_[np.zeros(777), np.full(1223, 2)], atol=1e-5)
    assert emulator.refused_updates() == 2


def test_stream_tags_reach_every_receiver_once_and_others_follow_their_node():
    tags = {i: [tag(5, "rx_rate", 1e6), tag(9, f"of{i}", i)] for i in range(2)}
    _, sinks = play(made(), np.zeros((2, 50), np.complex64), tags)
    keys = [sorted((t.offset, pmt.symbol_to_string(t.key)) for t in sink.tags()) for sink in sinks]
    assert keys == [[(5, "rx_rate"), (9, "of0")], [(5, "rx_rate"), (9, "of1")], [(5, "rx_rate")]]


@pytest.mark.parametrize("goes_on", [True, False])
def test_a_device_that_vanishes_in_mid_stream_loses_no_sample_where_the_processor_may_go_on(monkeypatch, goes_on):
    rng = np.random.default_rng(2)
    x, updates = noise(rng, 2, 6000), list(random_updates(rng, 6000))
    real, calls = gpu_network.DeviceNetwork._run, []

    def run(network, *arguments):
        calls.append(1)
        if len(calls) == 3:
            raise DeviceFault("--device cuda: the card has failed or is gone: by a test")
        return real(network, *arguments)

    monkeypatch.setattr(gpu_network.DeviceNetwork, "_run", run)
    network = made(goes_on=goes_on)._network
    for update in updates:
        delays = np.flatnonzero(update.taps)
        network.set_sparse_taps(update.tx, update.rx, delays, update.taps[delays], update.at_sample, update.ramp_samples)
    past = np.concatenate([np.zeros((2, N_TAPS - 1)), x], axis=1)

    def processed():
        return np.concatenate([network.process(past[:, a : a + 1500 + N_TAPS - 1]) for a in range(0, 6000, 1500)], axis=1)

    if not goes_on:
        with pytest.raises(DeviceFault, match="gone"):
            processed()
        return
    wanted = emulate(x, updates, 3)
    assert np.abs(processed() - wanted).max() < 2e-6 * np.abs(wanted).max()


@pytest.mark.parametrize("device", ["numpy", "auto"])
def test_a_scenario_between_ports_is_the_same_on_a_device(tmp_path, monkeypatch, capsys, device):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setitem(sys.modules, "cupy", None)
    open_device.cache_clear()
    link = sc.LinkTaps(delay_s=np.array([[3e-6], [1e-6]]), gain=np.array([[1], [0.5j]]))
    scenario = sc.Scenario(name="s", nodes=("a", "b"), links={("a", "b"): link}, time_s=[0, 2e-3])
    x = noise(np.random.default_rng(3), 5000)
    recording.write(tmp_path / "x", x, sample_rate_hz=1e6)
    heard = []
    for name in ("cpu", device):
        ports = [Port.parse(f"a:tx=file:{tmp_path / 'x'}"), Port.parse(f"b:rx=file:{tmp_path / name}")]
        emulation = Emulation(scenario, ports, 1e6, noise_power=0.1, seed=3, device=name)
        emulation.run()
        for _, block, _ in emulation._peers:
            if hasattr(block, "finish"):
                block.finish(None)
        heard.append(recording.read(tmp_path / name).samples)
    assert len(heard[1]) == len(heard[0]) == 5000 and np.abs(heard[1] - heard[0]).max() < 1e-5
    assert ("going on with the processor" in capsys.readouterr().err) == (device == "auto")


@pytest.mark.parametrize(("card_s", "processor_s", "taken"), [(1e-8, 1e-7, "cuda"), (1e-7, 1e-8, "cpu")])
def test_the_cheaper_of_card_and_processor_is_taken_and_said_and_measured_once(monkeypatch, tmp_path, card_s, processor_s, taken):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    scenario = sc.Scenario(name="s", nodes=("a",), links={})
    form = Form(n_inputs=1, n_outputs=1, n_taps=512)
    monkeypatch.setattr(devices, "planned", lambda *_: Choice(form=form, seconds=1e-9, error_db=-130.0, tried=1))
    monkeypatch.setattr(devices, "open_device", lambda card: open_device("numpy"))
    monkeypatch.setattr(devices, "_card_s", lambda *_: card_s)
    monkeypatch.setattr(devices, "_processor_s", lambda *_: processor_s)
    told = []
    assert devices.chosen("auto", scenario, 1e6, "fp32", 2, told.append) == taken
    assert len(told) == 1 and "the card takes" in told[0] and ("on the processor" in told[0]) == (taken == "cpu")
    for name in ("_card_s", "_processor_s"):
        monkeypatch.setattr(devices, name, lambda *_: pytest.fail("measured again"))
    assert devices.chosen("auto", scenario, 1e6, "fp32", 2, told.append) == taken


def test_both_are_measured_with_the_network_that_is_asked_for():
    task = Task(n_inputs=2, n_outputs=3, n_taps=64, life_samples=2000)
    assert 0 < devices._processor_s(task, 1) < 1e-3
    assert 0 < devices._card_s(Form(n_inputs=2, n_outputs=3, n_taps=64, n_bins=512), "numpy", task) < 1e-2
