# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings through a scenario, by the emulator in NumPy or on a graphics card: for notebooks."""

from collections.abc import Mapping

import numpy as np

from ..core.errors import CastError
from ..core.units import power_from_db
from ..scenario import Scenario
from ..signals.recording import Recording
from .reference import emulate, scenario_bulk_delay, scenario_updates


def emulate_network(
    scenario: Scenario,
    sent: Mapping[str, Recording],
    *,
    noise_power_db: float = -np.inf,
    seed: int = 0,
    device: str = "cpu",
    precision: str = "fp32",
) -> dict[str, Recording]:
    """What every node hears of `sent` (node → Recording, all of one rate) from the scenario's beginning on: node → Recording.

    `noise_power_db` is every receiver's, dB re 1 (samples squared). Delays between samples are interpolated; the delay that
    this costs is in the metadata (`cast:bulk_delay_samples`). `device` is cpu (NumPy in double precision, for a few 100,000
    samples), cuda (a graphics card, within `precision`: fp32 or tf32), or auto: cuda where there is a card. Raises CastError for
    unknown nodes, rates that differ, and a card that is asked for and not there.
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
    heard = None
    if device != "cpu":
        heard = _on_device(device, scenario, inputs, updates, rate_hz, powers, seed, precision)
    if heard is None:
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


def _on_device(device, scenario, inputs, updates, rate_hz, powers, seed, precision):
    """What is heard, by a card; None where there is none and `device` is auto."""
    from .gpu.faults import DeviceFault
    from .gpu.scenario import device_network, send_update

    try:
        network = device_network("cuda" if device == "auto" else device, scenario, rate_hz, precision=precision, seed=seed)
        for update in updates:
            send_update(network, update)
        for node, power in enumerate(powers):
            network.set_noise_power(node, power)
        past = np.zeros((inputs.shape[0], network.form.n_taps - 1))
        return network.process(np.concatenate([past, inputs], axis=1))
    except DeviceFault:
        if device != "auto":
            raise
        return None
