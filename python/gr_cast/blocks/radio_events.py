# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes wrong in a radio while samples flow, counted and with its time on the device's clock: a transmitter's underruns and
late packets, as gr-uhd's message port tells them, and a receiver's overruns, by its time stamps."""

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pmt
from gnuradio import gr

MOST_EVENTS = 1000  # kept with their times; all are counted
_TIME = pmt.intern("rx_time")
_KINDS = {
    "underflow": "underrun",
    "underflow_in_packet": "underrun",
    "seq_error": "lost_packet",
    "seq_error_in_burst": "lost_packet",
    "time_error": "late_packet",
}


class TransmitEvents(gr.basic_block):
    """Counts what a transmitter reports. `told(kind)` is called for each, in a thread of the flowgraph's."""

    def __init__(self, top: gr.top_block, radio, told: Callable[[str], object] = lambda kind: None):
        gr.basic_block.__init__(self, "transmit_events", None, None)
        self._told, self._lock = told, threading.Lock()
        self._counts, self._events = dict.fromkeys(sorted(set(_KINDS.values())), 0), []
        self.message_port_register_in(pmt.intern("in"))
        self.set_msg_handler(pmt.intern("in"), self._take)
        top.msg_connect(radio, "async_msgs", self, "in")

    def _take(self, message) -> None:
        about = pmt.cdr(message)
        time_s = None
        if pmt.dict_has_key(about, pmt.intern("time_spec")):
            time = pmt.dict_ref(about, pmt.intern("time_spec"), pmt.PMT_NIL)
            time_s = [pmt.to_long(pmt.car(time)), pmt.to_double(pmt.cdr(time))]
        for code in pmt.to_python(pmt.dict_ref(about, pmt.intern("event_code"), pmt.PMT_NIL)) or []:
            if code not in _KINDS:  # the end of a burst
                continue
            with self._lock:
                self._counts[_KINDS[code]] += 1
                if len(self._events) < MOST_EVENTS:
                    self._events.append({"kind": _KINDS[code], "device_time_s": time_s})
            self._told(_KINDS[code])

    @property
    def counts(self) -> dict[str, int]:
        """Kind to how many: `underrun`, `late_packet`, `lost_packet`."""
        with self._lock:
            return dict(self._counts)

    @property
    def events(self) -> list[dict]:
        """The first MOST_EVENTS, each with `kind` and `device_time_s`, whole seconds and a fraction."""
        with self._lock:
            return list(self._events)


def summary(counts: dict[str, int], events: list[dict]) -> str:
    """Events in a few words, such as `3 underruns, the first at 12.250001 s of the device's clock`; empty without any."""
    words = ", ".join(f"{n} {kind.replace('_', ' ')}{'s' * (n > 1)}" for kind, n in counts.items() if n)
    first = events[0]["device_time_s"] if events else None
    return f"{words}, the first at {first[0] + first[1]:.6f} s of the device's clock" if words and first else words


def times(tags) -> Iterator[tuple[int, int, float]]:
    """Of each `rx_time` among tags: its sample, whole seconds and their fraction."""
    for tag in tags:
        if pmt.equal(tag.key, _TIME) and pmt.is_tuple(tag.value):
            yield tag.offset, pmt.to_uint64(pmt.tuple_ref(tag.value, 0)), pmt.to_double(pmt.tuple_ref(tag.value, 1))


class Gaps:
    """Samples that a receiver lost: one whose time stamp is later than the count of samples says comes after a gap."""

    def __init__(self, sample_rate_hz: float):
        self.count, self.lost_samples = 0, 0
        self._rate_hz, self._mark = sample_rate_hz, None

    def before(self, sample: int, seconds: int, fraction: float) -> int:
        """How many samples are missing before this one, stamped so; 0 for the stream's first stamp."""
        marked, whole, part = self._mark or (sample, seconds, fraction)
        self._mark = (sample, seconds, fraction)
        lost = round((seconds - whole) * self._rate_hz + (fraction - part) * self._rate_hz) - (sample - marked)
        if lost <= 0:
            return 0
        self.count += 1
        self.lost_samples += lost
        return lost


class ReceiveEvents(gr.sync_block):
    """Counts the overruns of a receiver (complex floats) beside whatever else reads it."""

    def __init__(self, top: gr.top_block, radio, sample_rate_hz: float):
        gr.sync_block.__init__(self, "receive_events", [np.complex64], None)
        self._gaps, self._events = Gaps(sample_rate_hz), []
        top.connect(radio, self)

    def work(self, input_items, output_items):
        for sample, seconds, fraction in times(self.get_tags_in_window(0, 0, len(input_items[0]))):
            lost = self._gaps.before(sample, seconds, fraction)
            if lost and len(self._events) < MOST_EVENTS:
                self._events.append({"kind": "overrun", "device_time_s": [seconds, fraction], "lost_samples": lost})
        return len(input_items[0])

    @property
    def counts(self) -> dict[str, int]:
        """`overrun` and `lost_sample` to how many."""
        return {"overrun": self._gaps.count, "lost_sample": self._gaps.lost_samples}

    @property
    def events(self) -> list[dict]:
        """The first MOST_EVENTS, each with `kind`, `lost_samples` and `device_time_s` of the first sample after them."""
        return list(self._events)
