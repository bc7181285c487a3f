# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings through a scenario, by the emulator in NumPy: for notebooks, where a few 100,000 samples are sent."""

from collections.abc import Mapping

import numpy as np

from ..core.errors import CastError
from ..core.units import power_from_db
from ..scenario import Scenario
from ..signals.recording import Recording
from .reference import emulate, scenario_bulk_delay, scenario_updates


def emulate_network(
    scenario: Scenario, sent: Mapping[str, Recording], *, noise_power_db: float = -np.inf, seed: int = 0
) -> dict[str, Recording]:
    """What every node hears of `sent` (node → Recording, all of one rate) from the scenario's beginning on: node → Recording.

    `noise_power_db` is every receiver's, dB re 1 (samples squared). Delays between samples are interpolated; the delay that
    this costs is in the metadata (`cast:bulk_delay_samples`). Raises CastError for unknown nodes and rates that differ.
    """
    unknown = [node for node in sent if node not in scenario.nodes]
    if unknown or not sent:
        raise CastError(
            f"{scenario.name}: sent: got {', '.join(unknown) or 'nothing'}, the scenario has {', '.join(scenario.nodes)}"
        )
    rates = {recorded.sample_rate_hz for recorded in sent.values()}
    if len(rates) > 1 or None in rates:
        raise CastError(f"sent: sample rates: got {', '.join(map(str, rates))} Hz, needs one")
    rate_hz = rates.pop()
    inputs = np.zeros((len(scenario.nodes), max(len(recorded.samples) for recorded in sent.values())), complex)
    for node, recorded in sent.items():
        inputs[scenario.nodes.index(node), : len(recorded.samples)] = recorded.samples
    updates = scenario_updates(scenario, rate_hz, until_s=inputs.shape[1] / rate_hz)
    powers = [float(power_from_db(noise_power_db))] * len(scenario.nodes)
    heard = emulate(inputs, updates, len(scenario.nodes), noise_power=powers, seed=seed)
    about = {"cast:scenario": scenario.name, "cast:seed": seed, "cast:bulk_delay_samples": scenario_bulk_delay(scenario, rate_hz)}
    if len(sent) == 1:
        about["cast:transmitter"] = next(iter(sent))
    return {
        node: Recording(
            samples=samples.astype(np.complex64),
            sample_rate_hz=rate_hz,
            center_frequency_hz=scenario.center_frequency_hz,
            metadata=about | {"cast:receiver": node},
        )
        for node, samples in zip(scenario.nodes, heard, strict=True)
    }
