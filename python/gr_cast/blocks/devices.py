# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor or card: whichever takes less time for a scenario's network, measured once on the machine, said with both figures."""

import time

import numpy as np

from ..emulation.gpu import planner
from ..emulation.gpu.device import open_device
from ..emulation.gpu.faults import DeviceFault, told
from ..emulation.gpu.links import Table
from ..emulation.gpu.network import DeviceNetwork
from ..emulation.gpu.scenario import planned, scenario_task
from ..scenario import Scenario
from .cast_python import emulator_kernel

_MOST_SAMPLES, _TURNS = 1 << 16, 3


def chosen(device: str, scenario: Scenario, sample_rate_hz: float, precision: str, n_threads: int, report) -> str:
    """cpu, or the card's name, for what a user asks: cuda is that; auto is the cheaper one, and cpu without a card. `report` gets
    the line that says what and why. Raises DeviceFault where a card is asked for that is not there."""
    if device == "cpu":
        return device
    card = "cuda" if device == "auto" else device
    try:
        choice = planned(card, scenario, sample_rate_hz, precision)
        if device != "auto":
            report(f"network: {choice.words()}")
            return card
        task = scenario_task(scenario, sample_rate_hz, precision)
        by_card = planner.remembered(["card", open_device(card).identity(), task], lambda: _card_s(choice.form, card, task))
    except DeviceFault as fault:
        if device != "auto":
            raise
        report(f"{fault}; going on with the processor")
        return "cpu"
    by_processor = planner.remembered(["processor", n_threads, task], lambda: _processor_s(task, n_threads))
    rates = f"the card takes {1e-6 / by_card:.3g} MS/s per node with its transfers, {n_threads} threads {1e-6 / by_processor:.3g}"
    report(f"network: {choice.words() if by_card < by_processor else 'on the processor'}: {rates}")
    return card if by_card < by_processor else "cpu"


def _trial(task: planner.Task):
    """Random taps and samples of the task's size."""
    rng = np.random.default_rng(1)
    shape = (task.n_outputs, task.n_inputs, task.taps_per_link)
    gains = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    table = Table(delays=np.argsort(rng.random((*shape[:2], task.n_taps)), axis=-1)[..., : task.taps_per_link], gains=gains)
    n = min(max(task.life_samples, 1024), _MOST_SAMPLES)
    x = rng.standard_normal((task.n_inputs, task.n_taps - 1 + n, 2)).astype(np.float32).view(np.complex64)[..., 0]
    return table, x, n, task.life_samples <= n


def _best_s(change, run, changes: bool, n: int) -> float:
    change()
    run()
    took = []
    for _ in range(_TURNS):
        begin = time.perf_counter()
        if changes:
            change()
        run()
        took.append(time.perf_counter() - begin)
    return min(took) / n


def _card_s(form, card: str, task: planner.Task) -> float:
    table, x, n, changes = _trial(task)
    with told():
        network = DeviceNetwork(open_device(card), form)
        return _best_s(lambda: network.set_network(None, table), lambda: network.process(x), changes, n)


def _processor_s(task: planner.Task, n_threads: int) -> float:
    table, x, n, changes = _trial(task)
    kernel = emulator_kernel(task.n_inputs, task.n_outputs, task.n_taps, n_threads)
    # Its links go by transmitter first.
    rows = [np.ascontiguousarray(part.transpose(1, 0, 2).reshape(-1, part.shape[-1])) for part in (table.delays, table.gains)]
    return _best_s(lambda: kernel.set_all(0, rows[0].astype(np.int32), rows[1]), lambda: kernel.process(x), changes, n)
