# SPDX-License-Identifier: GPL-3.0-or-later
"""Node that receives: samples in CAST_RX to figures in CAST_RESULT. With --check it decodes a frame of its own."""

import ctypes
import json
import os
import sys
from pathlib import Path

import air
import modem
import numpy as np

_library = ctypes.CDLL(str(Path(__file__).resolve().parent / "viterbi.so"))


def viterbi(soft):
    soft = np.ascontiguousarray(soft, np.float32)
    bits = np.zeros(len(soft) // 2, np.uint8)
    _library.decode(soft.ctypes.data_as(ctypes.c_void_p), len(bits), bits.ctypes.data_as(ctypes.c_void_p))
    return bits[:-6]


if sys.argv[1:] == ["--check"]:
    sent = bytes(range(40))
    samples = np.concatenate([np.zeros(50), modem.modulated(sent, modem.MODES["qpsk1/2"]), np.zeros(50)])
    sys.exit([packet.payload for packet in modem.received(samples, viterbi)] != [sent])

sent = air.payloads("to")
samples = air.halved(np.fromfile(os.environ["CAST_RX"], "<c8"))
came = {packet.payload for packet in modem.received(samples, viterbi)}
arrived = [float(payload in came) for _, payload in sent]
figures = {"loss": 1 - sum(arrived) / len(sent), "throughput_bps": 8 * sum(map(len, came)) / float(os.environ["CAST_DURATION_S"])}
series = {"arrived": {"time_s": [second for second, _ in sent], "value": arrived}}
Path(os.environ["CAST_RESULT"]).write_text(json.dumps({"metrics": figures, "series": series}))
