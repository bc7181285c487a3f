# SPDX-License-Identifier: GPL-3.0-or-later
"""A scenario of any number of taps as one of four per link on the 10 ns grid."""

from dataclasses import replace

import numpy as np

from .create.approximate import TAPS, least_squares, loss
from .model import GRID_STEP_S, LinkTaps, Scenario


def reduced(scenario: Scenario, bandwidth_hz: float) -> tuple[Scenario, dict[tuple[str, str], float]]:
    """The scenario with its links of more than four taps fitted by four each, over `bandwidth_hz` and with one support for all
    instants, and what they lose: the largest NMSE over the instants, in dB."""
    links, nmse_db, known = dict(scenario.links), {}, {}
    for key, taps in scenario.links.items():
        if (taps.gain != 0).sum(axis=1).max() <= TAPS:
            continue
        same = id(taps)  # two directions that are one channel
        if same not in known:
            support, gain = least_squares(taps.delay_s, taps.gain, bandwidth_hz)
            delay_s = np.broadcast_to(support * GRID_STEP_S, gain.shape)
            lost = loss(taps.delay_s, taps.gain, delay_s, gain, bandwidth_hz)
            known[same] = LinkTaps(delay_s=delay_s, gain=gain), float(lost.nmse_db.max())
        links[key], nmse_db[key] = known[same]
    return replace(scenario, links=links), nmse_db
