# SPDX-License-Identifier: GPL-3.0-or-later
"""What goes to a radio's transmitter, told by tags when it begins and ends: its queue is full before its first sample leaves, and
every sample's place in time is known."""

import math
import threading
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import pmt
from gnuradio import gr

BUFFER = 1 << 13  # samples between this and the radio: GNU Radio's own size
_DONE = -1
_LONGEST_LEAD_S = 2.0


def _tag(block, sample: int, key: str, value) -> None:
    block.add_item_tag(0, sample, pmt.intern(key), value)


def _time_tuple(time_s: Fraction):
    whole = math.floor(time_s)
    return pmt.make_tuple(pmt.from_uint64(whole), pmt.from_double(float(time_s - whole)))


class Transmission(gr.sync_block):
    """A waveform, (n,) complex, repeated or sent once, in bursts that begin at stated times.

    The first begins at the second `start_at_s` of the device's clock or, without one, `lead_s` after it is asked for; `now_s()`
    reads that clock. After `restart()` the burst ends, and another begins at a whole number of the waveform's periods after the
    first: to a receiver the code goes on as if it had never ended. It ends after `n_samples`, None: never.
    """

    def __init__(
        self,
        samples: np.ndarray,
        *,
        repeat: bool,
        sample_rate_hz: float,
        now_s: Callable[[], float],
        start_at_s: int | None = None,
        n_samples: int | None = None,
        lead_s: float = 0.1,
    ):
        gr.sync_block.__init__(self, "transmission", None, [np.complex64])
        self._period = len(samples)
        self._samples = np.tile(samples, -(-BUFFER // self._period) + 1 if repeat else 1).astype(np.complex64)
        self._left = n_samples if n_samples is not None else math.inf
        if not repeat:
            self._left = min(self._left, self._period)
        self._rate_hz, self._now_s, self._lead_s = Fraction(sample_rate_hz), now_s, lead_s
        self._start_s = None if start_at_s is None else Fraction(start_at_s)
        self._first_s = self._begin_s = None  # of the first burst, and of this one
        self._began_at = 0  # this burst's first sample
        self._phase, self._begins, self._restart = 0, True, threading.Event()
        self.restarts = 0
        self.set_max_output_buffer(BUFFER)

    @property
    def start_s(self) -> float | None:
        """When the first sample leaves, on the device's clock; None until that is known."""
        return None if self._first_s is None else float(self._first_s)

    def restart(self, is_late: bool = False) -> None:
        """Begin anew in phase; with more time to spare where the last beginning came late."""
        if is_late:
            self._lead_s = min(2 * self._lead_s, _LONGEST_LEAD_S)
        self._restart.set()

    def work(self, input_items, output_items):
        out, number = output_items[0], self.nitems_written(0)
        if self._left <= 0:
            return _DONE
        if self._begins:
            self._begin(number)
        ends = self._restart.is_set() and number > 0
        count = int(min(len(out), self._left, len(self._samples) - self._phase, 1 if ends else BUFFER))
        out[:count] = self._samples[self._phase : self._phase + count]
        self._phase = (self._phase + count) % self._period
        self._left -= count
        if ends or self._left <= 0:
            _tag(self, number + count - 1, "tx_eob", pmt.PMT_T)
            self._begins = True
        return count

    def _begin(self, number: int) -> None:
        soonest_s = Fraction(self._now_s()) + Fraction(self._lead_s)
        if number == 0:
            self._first_s = self._start_s or Fraction(math.ceil(soonest_s * self._rate_hz)) / self._rate_hz
            self._begin_s = self._first_s
        else:
            queued_s = self._begin_s + (number - self._began_at) / self._rate_hz  # until then, were there no underrun
            period_s = self._period / self._rate_hz
            spare_s = max(soonest_s, queued_s + Fraction(self._lead_s)) - self._first_s
            self._begin_s = self._first_s + math.ceil(spare_s / period_s) * period_s
            self.restarts += 1
        self._began_at, self._phase, self._begins = number, 0, False
        self._restart.clear()
        _tag(self, number, "tx_sob", pmt.PMT_T)
        _tag(self, number, "tx_time", _time_tuple(self._begin_s))


class Lead(gr.sync_block):
    """Passes a stream on to a radio that is to begin `lead_s` after its first sample came: until then its queue fills."""

    def __init__(self, now_s: Callable[[], float], lead_s: float):
        gr.sync_block.__init__(self, "lead", [np.complex64], [np.complex64])
        self._now_s, self._lead_s = now_s, lead_s

    def work(self, input_items, output_items):
        if self.nitems_written(0) == 0:
            _tag(self, 0, "tx_sob", pmt.PMT_T)
            _tag(self, 0, "tx_time", _time_tuple(Fraction(self._now_s()) + Fraction(self._lead_s)))
        output_items[0][:] = input_items[0]
        return len(output_items[0])
