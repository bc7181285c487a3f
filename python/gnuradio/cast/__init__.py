# SPDX-License-Identifier: GPL-3.0-or-later
"""The blocks of gr-cast where GNU Radio's users look for them: `from gnuradio import cast`."""

from gr_cast.blocks import *  # noqa: F403
from gr_cast.blocks.network import set_links, set_noise
from gr_cast.blocks.scenario_emulator import ScenarioEmulator as scenario_emulator
from gr_cast.blocks.twin import twin_receiver

__all__ = [  # noqa: F405
    "bpsk_correlator",
    "channel_emulator",
    "glfsr_source",
    "scenario_emulator",
    "set_links",
    "set_noise",
    "twin_receiver",
    "zmq_replier",
    "zmq_requester",
    "zmq_subscriber",
]
