# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios that are not there: stand-ins for gr-uhd's blocks that record every call.

As a program: `fake_usrp.py cast_sounder rx …` runs a program of apps/ on them.
"""

import importlib
import json
import sys
from pathlib import Path
from time import sleep
from time import time as now

import numpy as np
import pmt
from gnuradio import blocks, gr, uhd

DELAY_SAMPLES = 5
GAP_EVERY, LOST = 100_000, 777  # samples between two overflows, and lost in each
START_S = (7, 0.25)  # device time of the first sample


class Air(gr.sync_block):
    """A code at half scale, DELAY_SAMPLES late; samples get lost, told by rx_time as gr-uhd does."""

    def __init__(self, period, is_sc16, rate_hz, silent_after=None):
        gr.sync_block.__init__(self, "air", in_sig=None, out_sig=[np.dtype((np.int16, 2)) if is_sc16 else np.complex64])
        self.heard = 0.5 * np.roll(period, DELAY_SAMPLES).astype(np.complex64)
        self.is_sc16, self.rate_hz, self.silent_after = is_sc16, rate_hz, silent_after

    def work(self, input_items, output_items):
        out, sent = output_items[0], self.nitems_written(0)
        count = min(len(out), GAP_EVERY - sent % GAP_EVERY)
        if self.silent_after is not None:
            count = min(count, self.silent_after - sent)
            if not count:  # as gr-uhd's receiver when nothing comes
                sleep(0.1)
                return 0
        index = sent + sent // GAP_EVERY * LOST
        if sent % GAP_EVERY == 0:
            passed = START_S[1] + index / self.rate_hz
            time = pmt.make_tuple(pmt.from_uint64(START_S[0] + int(passed)), pmt.from_double(passed % 1))
            self.add_item_tag(0, sent, pmt.intern("rx_time"), time)
        samples = self.heard[(index + np.arange(count)) % len(self.heard)]
        if self.is_sc16:
            out[:count] = np.rint(samples.view(np.float32).reshape(-1, 2) * 32768)
        else:
            out[:count] = samples
        return count


class Radio(gr.hier_block2):
    """Records calls; getters answer what was set, or what `answers` says the device does instead."""

    calls = []
    answers = {}
    period = np.ones(1)

    def __init__(self, inputs, outputs, device_args, stream_args):
        item = 8 if stream_args.cpu_format == "fc32" else 4
        signatures = [gr.io_signature(n, n, item if n else 0) for n in (inputs, outputs)]
        gr.hier_block2.__init__(self, type(self).__name__, *signatures)
        self.state = {}
        self.calls.append(("make", device_args, stream_args.cpu_format, stream_args.otw_format, list(stream_args.channels)))

    def __getattr__(self, name):
        if name.startswith("set_"):
            return lambda *values: self._set(name, values)
        if name in ("get_samp_rate", "get_center_freq", "get_gain"):
            key = name.removeprefix("get_")
            return lambda *_: self.answers.get(key, self.state[key])
        return gr.hier_block2.__getattr__(self, name)

    def get_time_now(self, board):
        return uhd.time_spec(now())

    def get_time_last_pps(self, board):
        return uhd.time_spec(float(int(now())) if self.answers.get("pulse", True) else 0.0)

    def get_mboard_sensor(self, name, board):
        if name == "gps_time":
            return uhd.sensor_value(name, int(now()), "s", "%d")
        return uhd.sensor_value(name, self.answers.get(name, True), "locked", "unlocked")

    def _set(self, name, values):
        values = [v.get_real_secs() if isinstance(v, uhd.time_spec) else v for v in values]
        self.state[name.removeprefix("set_")] = values[0]
        self.calls.append((name, *values))


class UsrpSink(Radio):
    def __init__(self, device_args, stream_args, tag=""):
        Radio.__init__(self, 1, 0, device_args, stream_args)
        self.message_port_register_hier_out("async_msgs")
        Radio.sent = blocks.vector_sink_c()
        self.connect(self, Radio.sent)


class UsrpSource(Radio):
    def __init__(self, device_args, stream_args):
        Radio.__init__(self, 0, 1, device_args, stream_args)
        self.air = Air(
            self.period, stream_args.cpu_format == "sc16", self.answers.get("air_rate", 1e6), self.answers.get("silent_after")
        )
        self.connect(self.air, self)


def plug_in(period=(1.0,), **answers):
    """Replace gr-uhd's blocks; the air carries this code period. Returns the list of recorded calls."""
    uhd.usrp_sink, uhd.usrp_source = UsrpSink, UsrpSource
    Radio.calls, Radio.answers, Radio.period = [], answers, np.asarray(period)
    return Radio.calls


if __name__ == "__main__":
    root = Path(__file__).resolve().parents[2]
    sys.path[:0] = [str(root / "build" / "python"), str(root / "apps")]
    program = importlib.import_module(sys.argv[1])
    from gr_cast.signals import codes

    calls = plug_in(codes.glfsr(8))
    try:
        program._program.run(lambda: program.main(sys.argv[2:]))
    finally:
        print("CALLS", json.dumps(calls), file=sys.stderr)
