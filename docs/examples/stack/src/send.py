# SPDX-License-Identifier: GPL-3.0-or-later
"""Node that sends: flows in CAST_TRAFFIC to samples in CAST_TX."""

import os

import air
import modem
import numpy as np

MODE = modem.MODES["16qam1/2"]
SETTLE = 40  # samples of silence before the first frame

samples = np.zeros(2 * round(float(os.environ["CAST_DURATION_S"]) * modem.SAMPLE_RATE_HZ / 2), complex)
for second, payload in air.payloads("from"):
    frame = modem.modulated(payload, MODE)
    begin = SETTLE + round(second * modem.SAMPLE_RATE_HZ)
    samples[begin : begin + len(frame)] = frame[: len(samples) - begin]
(air.GAIN * air.doubled(samples)).astype("<c8").tofile(os.environ["CAST_TX"])
