# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scenario explains of a recording, and what it does not: noise and everything that a site adds."""

import numpy as np
from scipy import fft as sp_fft

from ..core.units import db_from_amplitude, db_from_power
from ..emulation.reference import fir_taps, scenario_bulk_delay
from ..scenario import Scenario, played_gain

LEAST_DB = -300.0


def explained(scenario: Scenario, sent: dict[str, np.ndarray], rx: str, heard: np.ndarray, rate_hz: float) -> tuple[float, float]:
    """(dB left, dB of gain) of a recording (n,): its power that the scenario's first instant leaves over its whole power, and
    the gain with which the loudest transmitter arrives, over what the scenario says.

    One delay of whole samples and one gain per transmitter are free, for no site knows them. Least squares.
    """
    used = {tx: samples for tx, samples in sent.items() if (tx, rx) in scenario.links}
    bulk = scenario_bulk_delay(scenario, rate_hz)
    size = sp_fft.next_fast_len(len(heard) + max(len(samples) for samples in used.values()))
    spectrum = sp_fft.fft(heard.astype(complex), size)
    told = []
    for tx, samples in used.items():
        key = (tx, rx)
        taps = fir_taps(scenario.links[key].delay_s[0] * rate_hz, played_gain(scenario, key)[0], bulk)
        told.append(sp_fft.ifft(sp_fft.fft(samples.astype(complex), size) * sp_fft.fft(taps, size)))
    match = np.abs(sp_fft.ifft(spectrum * np.conj(sp_fft.fft(sum(told)))))
    late = int(np.argmax(match))
    columns = np.stack([np.roll(one, late)[: len(heard)] for one in told], axis=1)
    gain, *_ = np.linalg.lstsq(columns, heard.astype(complex), rcond=None)
    left, power = np.mean(np.abs(heard - columns @ gain) ** 2), np.mean(np.abs(heard) ** 2)
    loudest = int(np.argmax(np.abs(gain) ** 2 * np.sum(np.abs(columns) ** 2, axis=0)))
    return max(float(db_from_power(left / max(power, 1e-300))), LEAST_DB), max(float(db_from_amplitude(gain[loudest])), LEAST_DB)
