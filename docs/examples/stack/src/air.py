# SPDX-License-Identifier: GPL-3.0-or-later
"""What sender and receiver share: flows, payloads, and the step between the modem's 20 MS/s and the radio's 40 MS/s."""

import os

import numpy as np
import yaml

RATE_HZ = float(os.environ.get("CAST_SAMPLE_RATE_HZ", "40e6"))
NODE = os.environ.get("CAST_NODE", "1")
GAIN = 0.25


def payloads(key):
    """[(second, bytes)] of the flows that have this node at their end `key` (from or to)."""
    with open(os.environ["CAST_TRAFFIC"], encoding="utf-8") as file:
        flows = [flow for flow in yaml.safe_load(file)["flows"] if flow[key] == NODE]
    random = np.random.default_rng(int(os.environ["CAST_SEED"]))
    duration_s = float(os.environ["CAST_DURATION_S"])
    return [
        (k / flow["rate_pps"], random.bytes(flow["size_bytes"]))
        for flow in flows
        for k in range(int(duration_s * flow["rate_pps"]))
    ]


def doubled(x):
    """Twice the rate; the band stays."""
    spectrum = np.fft.fft(x)
    half = len(x) // 2
    return 2 * np.fft.ifft(np.concatenate([spectrum[:half], np.zeros(len(x)), spectrum[half:]]))


def halved(y):
    """Half the rate; the middle of the band stays."""
    spectrum = np.fft.fft(y)
    quarter = len(y) // 4
    return np.fft.ifft(np.concatenate([spectrum[:quarter], spectrum[-quarter:]])) / 2
