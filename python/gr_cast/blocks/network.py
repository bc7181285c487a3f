# SPDX-License-Identifier: GPL-3.0-or-later
"""A scenario on the channel emulator: chosen transmitters in, chosen receivers out."""

import numpy as np

from ..emulate import filter_length, scenario_updates
from ..errors import CastError
from ..scenario import Scenario, link_name, played_gain
from .cast_python import channel_emulator, emulator_kernel

_SAMPLE_TOLERANCE = 1e-6  # delays this near to a whole sample are on it


def emulated_network(
    scenario: Scenario, transmitters: list[str], receivers: list[str], sample_rate_hz: float, n_threads: int = 0
) -> channel_emulator:
    """A `channel_emulator` with the links of the scenario among these nodes, base loss included.

    Delays must fall on whole samples: CastError names the link and the nearest ones otherwise.
    """
    links = {
        (tx, rx): scenario.links[(tx, rx)] for tx in transmitters for rx in receivers if (tx, rx) in scenario.links
    }
    last = max((int(np.ceil(taps.delay_s.max() * sample_rate_hz)) for taps in links.values()), default=0)
    emulator = channel_emulator(
        len(transmitters), len(receivers), n_taps=last + 1, sample_rate_hz=sample_rate_hz, n_threads=n_threads, name=scenario.name
    )
    for (tx, rx), taps in links.items():
        gain = played_gain(scenario, (tx, rx))
        delays = np.rint(taps.delay_s * sample_rate_hz).astype(int)
        off = np.abs(taps.delay_s * sample_rate_hz - delays) * (taps.gain != 0)
        if off.max() > _SAMPLE_TOLERANCE:
            row, tap = np.unravel_index(np.argmax(off), off.shape)
            raise CastError(
                f"{scenario.name}: link {link_name((tx, rx))}: tap {tap + 1}: delay {taps.delay_s[row, tap]:.6g} s is "
                f"{taps.delay_s[row, tap] * sample_rate_hz:.4f} samples at {sample_rate_hz:g} Hz; choose another rate"
            )
        for step in range(len(gain)):
            start = int(np.rint(scenario.time_s[step] * sample_rate_hz))
            emulator.set_sparse_taps(
                transmitters.index(tx), receivers.index(rx), delays[step].tolist(), gain[step].tolist(), start
            )
    return emulator


def scenario_kernel(
    scenario: Scenario, sample_rate_hz: float, until_s: float, *, seed: int = 0, receivers: list[int] | None = None
) -> emulator_kernel:
    """The emulator without a scheduler, from and to every node, with all that a scenario plays until `until_s` queued.

    Only links to `receivers` (numbers of nodes; all without it) are.
    """
    nodes = len(scenario.nodes)
    kernel = emulator_kernel(nodes, nodes, filter_length(sample_rate_hz), seed=seed)
    for update in scenario_updates(scenario, sample_rate_hz, until_s=until_s):
        if receivers is not None and update.rx not in receivers:
            continue
        delays = np.flatnonzero(update.taps)
        link = (update.tx, update.rx)
        kernel.set_sparse_taps(*link, delays, update.taps[delays], update.at_sample, update.ramp_samples)
        if update.base_loss_db is not None:
            kernel.set_base_loss(*link, update.base_loss_db, update.at_sample)
    return kernel


def play(scenario: Scenario, inputs: np.ndarray, sample_rate_hz: float, noise_power: float, seed: int) -> np.ndarray:
    """What every node receives of `inputs`, (nodes, samples) complex64 both, from the scenario's beginning on."""
    kernel = scenario_kernel(scenario, sample_rate_hz, inputs.shape[1] / sample_rate_hz, seed=seed)
    for node in range(len(scenario.nodes)):
        kernel.set_noise_power(node, noise_power)
    return kernel.process(inputs)
