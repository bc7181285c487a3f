# SPDX-License-Identifier: GPL-3.0-or-later
"""A scenario on the channel emulator: chosen transmitters in, chosen receivers out."""

import itertools
from dataclasses import replace

import numpy as np
import pmt

from ..core.errors import CastError
from ..emulation.gpu.network import DeviceNetwork
from ..emulation.gpu.scenario import device_network, send_update
from ..emulation.reference import INTERPOLATOR_BAND, filter_length, has_taps_between_samples, scenario_updates
from ..scenario import Scenario
from ..signals import on_air
from .cast_python import channel_emulator, emulator_kernel


def emulated_network(
    scenario: Scenario, transmitters: list[str], receivers: list[str], sample_rate_hz: float, n_threads: int = 0
) -> channel_emulator:
    """A `channel_emulator` with the links of the scenario among these nodes, base loss included. Raises CastError."""
    emulator = channel_emulator(
        len(transmitters), len(receivers), filter_length(sample_rate_hz), sample_rate_hz, n_threads, scenario.name
    )
    play_on(emulator, scenario, transmitters, receivers, sample_rate_hz)
    return emulator


def play_on(
    emulator: channel_emulator, scenario: Scenario, transmitters: list[str], receivers: list[str], sample_rate_hz: float
) -> None:
    """Have the emulator play the scenario from its beginning, from the next sample on, and nothing of what it played before.

    Taps between samples are interpolated; every link is then late by the `scenario_bulk_delay` of the whole scenario, whichever
    nodes are chosen.
    """
    emulator.set_horizon(0)  # nothing passes until its first taps are there
    emulator.clear()
    begin = pmt.to_python(emulator.status())["samples"]
    for update in scenario_updates(scenario, sample_rate_hz, links=set(itertools.product(transmitters, receivers))):
        tx, rx = transmitters.index(scenario.nodes[update.tx]), receivers.index(scenario.nodes[update.rx])
        send_update(emulator, replace(update, tx=tx, rx=rx), begin)
    emulator.set_horizon(None)


def set_links(emulator: channel_emulator, links: dict) -> None:
    """Give the emulator these links, {(tx, rx): taps}, taps[d] at a delay of d samples, and no other from the next sample on."""
    n_inputs, n_outputs = emulator.input_signature().max_streams(), emulator.output_signature().max_streams()
    for tx, rx in links:
        if not (0 <= tx < n_inputs and 0 <= rx < n_outputs):
            raise CastError(f"links: got ({tx}, {rx}), has {n_inputs} transmitters and {n_outputs} receivers, counted from 0")
    for link in np.ndindex(n_inputs, n_outputs):
        emulator.set_taps(*link, list(links.get(link, [])))


def set_noise(emulator: channel_emulator, power: float) -> None:
    """Every receiver's noise power from now on, in units of the samples squared."""
    for receiver in range(emulator.output_signature().max_streams()):
        emulator.set_noise_power(receiver, power)


def heard(scenario: Scenario, receiver: str, sent: dict[str, dict | None]) -> dict:
    """What a recording of `receiver` says of itself when `sent`, node to the entry of its waveform, is on the air."""
    there = {node: entry for node, entry in sent.items() if (node, receiver) in scenario.links}
    return {"cast:receiver": receiver, **on_air.fields(there)}


def usable_band(scenario: Scenario, sample_rate_hz: float) -> dict:
    """What a recording says of the share of its band that is right, where taps are interpolated."""
    return {"cast:band": INTERPOLATOR_BAND} if has_taps_between_samples(scenario, sample_rate_hz) else {}


def scenario_kernel(
    scenario: Scenario,
    sample_rate_hz: float,
    until_s: float,
    *,
    seed: int = 0,
    receivers: list[int] | None = None,
    cycle: bool = False,
    device: str = "cpu",
    precision: str = "fp32",
) -> emulator_kernel | DeviceNetwork:
    """The emulator without a scheduler, from and to every node, with all that a scenario plays until `until_s` queued.

    Only links to `receivers` (numbers of nodes; all without it) are. With `cycle` it begins again whenever it ends. `device`
    is cpu, or one on which the network is then. Raises DeviceFault.
    """
    nodes = len(scenario.nodes)
    if device == "cpu":
        kernel = emulator_kernel(nodes, nodes, filter_length(sample_rate_hz), seed=seed)
    else:
        kernel = device_network(device, scenario, sample_rate_hz, precision=precision, seed=seed)
    heard = range(nodes) if receivers is None else receivers
    links = set(itertools.product(scenario.nodes, (scenario.nodes[rx] for rx in heard)))
    for update in scenario_updates(scenario, sample_rate_hz, until_s=until_s, links=links, cycle=cycle):
        send_update(kernel, update)
    return kernel


def play(scenario: Scenario, inputs: np.ndarray, sample_rate_hz: float, noise_power: float, seed: int) -> np.ndarray:
    """What every node receives of `inputs`, (nodes, samples) complex64 both, from the scenario's beginning on."""
    kernel = scenario_kernel(scenario, sample_rate_hz, inputs.shape[1] / sample_rate_hz, seed=seed)
    for node in range(len(scenario.nodes)):
        kernel.set_noise_power(node, noise_power)
    return kernel.process(inputs)
