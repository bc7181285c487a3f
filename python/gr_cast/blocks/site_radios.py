# SPDX-License-Identifier: GPL-3.0-or-later
"""A site's nodes over their USRPs: all send and record from one second of UTC on, by a pulse that they share."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from gnuradio import blocks, gr

from ..core.errors import CastError
from ..signals.recording import data_path, meta_path
from .ports import own_words, radio_settings
from .radio_events import TransmitEvents, summary
from .recorder import SigmfRecorder
from .running import run_to_end
from .transmission import Transmission
from .usrp import RadioSettings, now_s, usrp_sink, usrp_source

SET_UP_S = 5  # of one radio: it is found and loaded, its clock is set at a pulse, and read at the next


@dataclass(frozen=True, kw_only=True)
class Band:
    """What holds for all radios of a site unless a node's device arguments say otherwise."""

    sample_rate_hz: float
    center_frequency_hz: float | None
    clock_source: str = "external"
    time_source: str = "external"


def settings(devices: dict[str, str], directions: list[tuple[str, str]], band: Band) -> dict:
    """(node, "tx" or "rx") → RadioSettings that start together, once the last is set up. Raises CastError, all faults at once."""
    start_at_s = int(time.time()) + SET_UP_S * (len(directions) + 1)
    defaults = vars(band) | {"start_at_s": start_at_s}
    made, faults = {}, []
    for node, direction in directions:
        try:
            words = own_words(devices.get(node, ""), direction)
            made[node, direction] = radio_settings(f"node {node}: {direction}", words, defaults)
        except CastError as error:
            faults += error.faults
    if faults:
        raise CastError(*faults)
    return made


class SiteRadios(gr.top_block):
    """`sent`, node → (n,) complex64, leaves by transmitters; what receivers hear, `count` samples, goes to `folder`."""

    def __init__(self, sent: dict[str, np.ndarray], made: dict[tuple[str, str], RadioSettings], count: int, folder: Path):
        super().__init__("SiteRadios", catch_exceptions=True)  # a radio that dies ends its thread, not the program
        self._recorders, self._events, self._kept = {}, {}, []
        self.start_at_s = next(iter(made.values())).start_at_s
        for (node, direction), radio in made.items():
            if direction == "tx":
                self._send(node, radio, sent[node])
            else:
                self._hear(node, radio, count, folder)

    def _send(self, node: str, radio: RadioSettings, samples: np.ndarray) -> None:
        sink = usrp_sink(radio)
        source = Transmission(
            samples, repeat=False, sample_rate_hz=radio.sample_rate_hz, now_s=lambda: now_s(sink), start_at_s=radio.start_at_s
        )
        self.connect(source, sink)
        self._events[node] = TransmitEvents(self, sink)
        self._kept += [source, sink]  # nobody else holds a block of Python

    def _hear(self, node: str, radio: RadioSettings, count: int, folder: Path) -> None:
        source, cut = usrp_source(radio), blocks.head(gr.sizeof_gr_complex, count)
        self.connect(source, cut)
        self._recorders[node] = SigmfRecorder(self, cut, folder / f"rx_{node}", sample_rate_hz=radio.sample_rate_hz)
        self._kept.append(source)

    def played(self) -> None:
        """Send and record. Raises CastError where a radio falls silent, or lost a sample: it would pass for the stack's fault."""
        try:
            run_to_end(
                self,
                lambda: sum(recorder.samples for recorder in self._recorders.values()),
                first_s=max(0.0, self.start_at_s - time.time()),
            )
        finally:
            for recorder in self._recorders.values():
                recorder.finish()
        lost = [f"node {node}: {words}" for node, told in self._events.items() if (words := summary(told.counts, told.events))]
        for node, recorder in self._recorders.items():
            if recorder.gaps.count:
                lost.append(f"node {node}: {recorder.gaps.count} gaps, {recorder.gaps.lost_samples} samples lost")
        if lost:
            raise CastError(*lost)


def play_and_record(sent: dict[str, np.ndarray], receivers: list[str], devices: dict[str, str], band: Band, folder: Path) -> None:
    """Leave `rx_NODE.cf32` of every receiver in a folder: as many samples as the longest of what is sent, from the first on."""
    directions = [(node, "tx") for node in sent] + [(node, "rx") for node in receivers]
    made = settings(devices, directions, band)
    top = SiteRadios(sent, made, max(map(len, sent.values())), folder)
    top.played()
    for node in receivers:
        stem = folder / f"rx_{node}"
        meta_path(stem).unlink()
        data_path(stem).replace(folder / f"rx_{node}.cf32")
