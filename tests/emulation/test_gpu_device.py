# SPDX-License-Identifier: GPL-3.0-or-later
"""A card that is not there, does not fit, fills up or vanishes is one line; the processor goes on only where it is asked."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from gr_cast import emulate
from gr_cast import scenario as sc
from gr_cast.emulation.gpu import planner
from gr_cast.emulation.gpu.arrays import ArrayOps
from gr_cast.emulation.gpu.device import open_device
from gr_cast.emulation.gpu.faults import DeviceFault
from gr_cast.emulation.gpu.form import DELAY_TYPE, Form
from gr_cast.emulation.gpu.links import Table
from gr_cast.emulation.gpu.network import DeviceNetwork
from gr_cast.emulation.gpu.scenario import _planned
from gr_cast.emulation.gpu.stream import Stream
from gr_cast.signals.recording import Recording

sys.path.append(str(Path(__file__).resolve().parent))
import fake_cupy
from fake_cupy import CUDARuntimeError, OutOfMemoryError

PRECISIONS = {"fp32": -120, "fp16": -65, "split": -120, "tf32": -120}  # the stand-in's tf32 is exact
FAULTS = {
    "no driver": ({"getDeviceCount": (CUDARuntimeError("cudaErrorInsufficientDriver: too old"), 0)}, "no driver of NVIDIA"),
    "no card": ({"getDeviceCount": (CUDARuntimeError("cudaErrorNoDevice: none"), 0)}, "no card"),
    "out of memory": ({"empty": (OutOfMemoryError("Out of memory allocating 9 bytes"), 3)}, "memory is full"),
    "gone": ({"launch": (CUDARuntimeError("cudaErrorDevicesUnavailable: gone"), 2)}, "failed or is gone"),
    "library": ({"launch": (RuntimeError("CuPy failed to load libnvrtc.so.12: OSError"), 0)}, "a library of CUDA is missing"),
    "wrong CUDA": ({"launch": (CUDARuntimeError("CUDA_ERROR_NO_BINARY: NoKernelImage"), 0)}, "not for this card"),
}


@pytest.fixture(autouse=True)
def fresh(monkeypatch, tmp_path):
    """No device is open, nothing was measured before, and little is tried."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(planner, "candidates", lambda task, tiles: [form(task)])
    for cached in (open_device, _planned):
        cached.cache_clear()
    yield
    for cached in (open_device, _planned):
        cached.cache_clear()


def form(task, **more):
    return Form(n_inputs=task.n_inputs, n_outputs=task.n_outputs, n_taps=task.n_taps, n_bins=1024, **more)


@pytest.fixture
def heard():
    """heard(device): what node b hears of a recording, alone and through the scenario."""
    link = sc.LinkTaps(delay_s=np.array([[0, 3e-6], [2e-6, 0]]), gain=np.array([[1, 0.5], [2j, 0]]))
    scenario = sc.Scenario(name="s", nodes=("a", "b"), links={("a", "b"): link}, time_s=[0, 1e-3], base_loss_db=20)
    rng = np.random.default_rng(1)
    samples = (rng.standard_normal(2500) + 1j * rng.standard_normal(2500)).astype(np.complex64)
    sent = Recording(samples=samples, sample_rate_hz=1e6)
    return lambda device, **about: emulate(scenario, {"a": sent}, device=device, **about)["b"].samples


def need_compiler():
    if shutil.which("g++") is None:
        pytest.skip("NO G++: CuPy is not stood in for")


def test_a_missing_cupy_is_named_with_what_to_type(monkeypatch, heard):
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(DeviceFault, match="CuPy is not in this Python: pip install cupy-cuda1"):
        heard("cuda")
    np.testing.assert_array_equal(heard("auto"), heard("cpu"))


@pytest.mark.parametrize("fault", FAULTS)
def test_a_card_that_fails_is_one_line_and_the_processor_goes_on_only_if_asked(monkeypatch, heard, fault):
    need_compiler()
    planted, words = FAULTS[fault]
    fake_cupy.install(monkeypatch, planted)
    with pytest.raises(DeviceFault, match=words) as caught:
        heard("cuda")
    assert len(caught.value.faults) == 1 and "\n" not in caught.value.faults[0]
    np.testing.assert_array_equal(heard("auto"), heard("cpu"))


def test_what_a_node_hears_by_the_card_is_what_it_hears_by_the_processor(monkeypatch, heard):
    need_compiler()
    fake_cupy.install(monkeypatch)
    for about in ({}, {"noise_power_db": -10.0, "seed": 3}):
        by_card, by_processor = (heard(device, **about) for device in ("cuda", "cpu"))
        assert np.abs(by_card - by_processor).max() < 1e-6 * np.abs(by_processor).max()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_products_by_cublas_are_those_of_the_definition(monkeypatch, precision):
    need_compiler()
    fake_cupy.install(monkeypatch)
    task = planner.Task(n_inputs=3, n_outputs=2, n_taps=100, life_samples=1500, int16=True)
    _, db = planner.measure(open_device("cuda"), form(task, precision=precision), task)
    assert db < PRECISIONS[precision]


def test_what_was_measured_is_kept_and_a_wrong_form_is_never_chosen(monkeypatch):
    task = planner.Task(n_inputs=2, n_outputs=2, n_taps=50, life_samples=2000, precision="tf32", int16=True)
    forms = [form(task, precision=p) for p in ("fp16", "tf32")]
    monkeypatch.setattr(planner, "candidates", lambda task, tiles: forms)
    ops, told = open_device("numpy"), []
    monkeypatch.setattr(
        planner, "measure", lambda ops, form, task: {"fp16": (1e-9, -20.0), "tf32": (1e-8, -70.0)}[form.precision]
    )
    choice = planner.choose(ops, task, told.append)
    assert choice.form.precision == "tf32" and any("limit -65 dB: left out" in line for line in told)
    monkeypatch.setattr(planner, "measure", lambda *_: pytest.fail("measured again"))
    assert planner.choose(ops, task) == choice
    planner.wisdom_path().write_text("{ broken")
    monkeypatch.setattr(planner, "measure", lambda *_: (1e-9, -70.0))
    assert planner.choose(ops, task).form.precision == "fp16"


def test_a_form_that_a_card_cannot_do_is_left_out(monkeypatch):
    task = planner.Task(n_inputs=2, n_outputs=2, n_taps=50, life_samples=2000)
    monkeypatch.setattr(planner, "candidates", lambda task, tiles: [form(task), form(task, method="direct")])
    real = DeviceNetwork.run

    def run(network, *arguments):
        if network.form.method == "direct":
            raise OutOfMemoryError("Out of memory allocating 9 bytes")
        return real(network, *arguments)

    monkeypatch.setattr(DeviceNetwork, "run", run)
    choice = planner.choose(open_device("numpy"), task)
    assert choice.form.method == "overlap-save" and choice.tried == 1 and choice.error_db < -95


@pytest.mark.parametrize("device", ["numpy", "cuda"])
def test_a_stream_of_chunks_is_the_network_on_all_of_them(monkeypatch, device):
    if device == "cuda":
        need_compiler()
        fake_cupy.install(monkeypatch)
    shape = dict(n_inputs=3, n_outputs=2, n_taps=100, n_bins=512, precision="split")
    rng, chunk, n = np.random.default_rng(8), 700, 9 * 700
    x = rng.integers(-9000, 9000, (3, 99 + n, 2), dtype=np.int16)
    x[:, :99] = 0
    ops, tables, links = open_device(device), [], (2, 3, 4)
    for k in range(8):
        made = ops.pinned if k % 2 else np.empty  # some are sent from where they lie
        delays, gains = made(links, DELAY_TYPE), made(links, np.complex64)
        delays[...], gains[...] = rng.integers(0, 100, links), rng.standard_normal(links) + 1j * rng.standard_normal(links)
        tables.append(Table(delays=delays, gains=gains))

    def network(ops):
        made = DeviceNetwork(ops, Form(**shape))
        made.set_samples(int16_in=True, int16_out=True, output_full_scale=4.0)
        for k, table in enumerate(tables):
            made.set_network(k * 777, table)
        return made

    wanted = network(ArrayOps()).run(x[:, :99], x[:, 99:])
    stream, got = Stream(network(ops), chunk), []
    for k in range(9):
        while stream.under_way == stream.depth:
            got.append(stream.wait().copy())
        stream.take()[...] = x[:, 99 + k * chunk : 99 + (k + 1) * chunk]
        stream.push()
    while stream.under_way:
        got.append(stream.wait().copy())
        assert stream.took_s() > 0
    got = np.concatenate(got, axis=1)
    assert np.abs(got.astype(int) - wanted).max() <= 1  # a step of 32768, where the two round another way
