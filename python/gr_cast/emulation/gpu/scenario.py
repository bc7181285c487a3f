# SPDX-License-Identifier: GPL-3.0-or-later
"""A scenario on a device: the network that plays it, in the form that is fastest there."""

import functools

import numpy as np

from ...scenario import Scenario
from ..reference import LinkUpdate, filter_length, scenario_bulk_delay
from .arrays import ArrayOps
from .device import open_device
from .network import DeviceNetwork
from .planner import Choice, Task, choose


def scenario_task(scenario: Scenario, sample_rate_hz: float, precision: str = "fp32") -> Task:
    """What a scenario asks of a device at this rate: its taps, interpolated between samples, and how long they last."""
    between = scenario_bulk_delay(scenario, sample_rate_hz) > 0
    widest = max((taps.gain.shape[1] for taps in scenario.links.values()), default=1)
    steps = np.diff(scenario.time_s)
    life_s = float(steps.min()) if steps.size and not scenario.is_static else 1.0
    n_taps = filter_length(sample_rate_hz)
    return Task(
        n_inputs=len(scenario.nodes),
        n_outputs=len(scenario.nodes),
        n_taps=n_taps,
        taps_per_link=min(n_taps, widest * (28 if between else 1)),
        life_samples=max(1, round(life_s * sample_rate_hz)),
        precision=precision,
    )


@functools.cache
def _planned(ops: ArrayOps, task: Task) -> Choice:
    return choose(ops, task)


def planned(device: str, scenario: Scenario, sample_rate_hz: float, precision: str = "fp32") -> Choice:
    """How this scenario is computed on `device` (cuda or numpy). Raises DeviceFault where it cannot be."""
    return _planned(open_device(device), scenario_task(scenario, sample_rate_hz, precision))


def device_network(
    device: str, scenario: Scenario, sample_rate_hz: float, *, precision: str = "fp32", seed: int = 0
) -> DeviceNetwork:
    """The network of a scenario's nodes, without an update yet, as `planned`. Raises DeviceFault."""
    return DeviceNetwork(open_device(device), planned(device, scenario, sample_rate_hz, precision).form, seed)


def send_update(network, update: LinkUpdate, begin: int = 0) -> None:
    """Hand a network, on a device or an emulator of the processor, an update whose sample 0 is sample `begin` of the streams."""
    offset = None if update.at_sample == 0 else begin + update.at_sample
    delays = np.flatnonzero(update.taps)
    network.set_sparse_taps(update.tx, update.rx, delays.tolist(), update.taps[delays].tolist(), offset, update.ramp_samples)
    if update.base_loss_db is not None:
        network.set_base_loss(update.tx, update.rx, update.base_loss_db, offset)
