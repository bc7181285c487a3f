# SPDX-License-Identifier: GPL-3.0-or-later
"""A testbed by closed formulas, without any of the package: a site's program that plays and records. world.py FAULT NOISE_DB."""

import os
import sys

import numpy as np

PATHS = {0: (-3.0, 0.0), 4: (-9.0, 1.2), 16: (-15.0, -2.0)}  # room.yaml at 40 MS/s: samples → dB, rad
FAULT, NOISE_DB = sys.argv[1], float(sys.argv[2])
RATE_HZ = float(os.environ["CAST_SAMPLE_RATE_HZ"])

x = np.fromfile("tx_1.cf32", "<c8").astype(complex)
if FAULT == "amplifier":
    x = x * (1 - 0.2 * np.abs(x) ** 2)  # third order
paths = {late: path for late, path in PATHS.items() if FAULT != "path" or late != 16}
y = sum(10 ** (db / 20) * np.exp(1j * rad) * np.concatenate([np.zeros(late), x])[: len(x)] for late, (db, rad) in paths.items())
y = (
    (0.5 if FAULT == "gain" else 1) * np.exp(0.7j) * np.concatenate([np.zeros(23), y])[: len(x)]
)  # a delay and a phase that nobody knows
if FAULT == "clock":
    y = y * np.exp(2j * np.pi * 480 * np.arange(len(y)) / RATE_HZ)  # 0.2 ppm of 2.4 GHz
rng = np.random.default_rng()  # fresh in every run, as radios are
y = y + 10 ** (NOISE_DB / 20) * (rng.normal(size=len(y)) + 1j * rng.normal(size=len(y))) / np.sqrt(2)
if FAULT == "rails":
    y = np.clip(y.real, -0.7, 0.7) + 1j * np.clip(y.imag, -0.7, 0.7)  # that only a louder transmitter reaches
y.astype("<c8").tofile("rx_2.cf32")
