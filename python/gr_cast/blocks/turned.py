# SPDX-License-Identifier: GPL-3.0-or-later
"""A carrier offset on a stream, exact to the last bit of a sample however long it runs."""

import numpy as np
from gnuradio import gr

TABLE = 4096  # samples that are turned at once


class Turned(gr.sync_block):
    """Turns a stream by `offset_hz`. GNU Radio's rotator accumulates its phase in float32: over milliseconds it is off by some
    mHz and leaves ripples that a sounder sees at −145 dB."""

    def __init__(self, offset_hz: float, sample_rate_hz: float):
        gr.sync_block.__init__(self, "cast_turned", [np.complex64], [np.complex64])
        self._cycles = offset_hz / sample_rate_hz
        self._within = np.exp(2j * np.pi * self._cycles * np.arange(TABLE))

    def work(self, input_items, output_items):
        samples, turned = input_items[0], output_items[0]
        first = self.nitems_written(0)
        for begin in range(0, len(turned), TABLE):
            part = samples[begin : begin + TABLE]
            phase = np.exp(2j * np.pi * ((first + begin) * self._cycles % 1.0))
            turned[begin : begin + len(part)] = part * (phase * self._within[: len(part)])
        return len(turned)
