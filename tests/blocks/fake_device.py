# SPDX-License-Identifier: GPL-3.0-or-later
"""A radio behind gr-uhd's own interface: device clock, PPS, timed commands, a transmit queue, and faults on request.

Blocks of one device (same arguments) share its clock, and its receiver hears what its transmitter sends, or else a code.
As a program: `fake_device.py FAULTS cast_sounder rx …` runs a program of apps/ on it, FAULTS being JSON of `Faults`.
"""

import importlib
import json
import sys
import threading
import time
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

if __name__ == "__main__":  # a signal is its program's from the first: what is being loaded may swallow Python's own interrupt
    ROOT = Path(__file__).resolve().parents[2]
    sys.path[:0] = [str(ROOT / "build" / "python"), str(ROOT / "apps")]
    importlib.import_module("gr_cast.core.interrupts").end_quietly()

import numpy as np
import pmt
from gnuradio import gr, uhd

NAP_S = 0.01
QUEUE_S = 0.25  # of samples that a transmitter takes in advance
PACKET = 2000  # samples that a receiver hands over at most


@dataclass
class Faults:
    """When what goes wrong, in samples of the stream; None: never."""

    rx_silent_after: int | None = None  # nothing comes any more
    rx_dies_after: int | None = None  # libuhd throws
    rx_overrun_every: int | None = None  # so many samples, then `rx_lost` are lost
    rx_lost: int = 500
    tx_silent_after: int | None = None  # nothing is taken any more
    tx_dies_after: int | None = None
    tx_underrun_at: tuple = ()  # the queue runs dry before these samples, for `tx_dry_s`
    tx_dry_s: float = 0.0123457
    no_pulse: bool = False
    unlocked: bool = False
    gain_db: float | None = None  # what the device does in place of what it is told
    rate_hz: float | None = None
    starts_late: bool = False  # the clock is already past what is asked for: a late command


class Device:
    """The clock and the air of one radio."""

    def __init__(self, faults: Faults, code: np.ndarray):
        self.faults, self.code = faults, code
        self.bursts = []  # (device time of its first sample as a Fraction, samples), as they left
        self.events = []  # (kind, device time)
        self.calls = []
        self.set_to(0.0)
        self._next_pulse_s = None
        self.lock = threading.Lock()

    def set_to(self, seconds: float) -> None:
        self._offset_s = seconds - time.time()

    @property
    def now_s(self) -> float:
        if self._next_pulse_s and time.time() >= self._next_pulse_s[0]:  # a pulse comes when UTC's second does
            pulse, value = self._next_pulse_s
            self._offset_s, self._next_pulse_s = value - pulse, None
        return time.time() + self._offset_s

    def at_next_pulse(self, seconds: float) -> None:
        if not self.faults.no_pulse:
            self._next_pulse_s = (int(time.time()) + 1, seconds)

    @property
    def last_pulse_s(self) -> float:
        return self.now_s - time.time() % 1 if not self.faults.no_pulse else 0.0


class _Radio(gr.sync_block):
    devices: dict[str, Device] = {}
    faults = Faults()
    code = np.ones(1)

    def _plug(self, device_args: str) -> None:
        if "absent" in device_args:
            raise RuntimeError("LookupError: KeyError: No devices found for ----->\nDevice Address:")
        made = _Radio.devices.setdefault(device_args, Device(_Radio.faults, np.asarray(_Radio.code, np.complex64)))
        self.device, self.state, self.begin_s = made, {}, None

    def __getattr__(self, name):
        if name.startswith("set_") and "state" in self.__dict__:
            return lambda *values: self._set(name.removeprefix("set_"), values)
        return gr.sync_block.__getattr__(self, name)

    def _set(self, name, values):
        self.device.calls.append((type(self).__name__, name, *values))
        self.state[name] = values[0]

    def get_samp_rate(self):
        return self.device.faults.rate_hz or self.state["samp_rate"]

    def get_center_freq(self, channel):
        return self.state["center_freq"]

    def get_gain(self, channel):
        return self.state["gain"] if self.device.faults.gain_db is None else self.device.faults.gain_db

    def get_mboard_sensor(self, name, board):
        if name == "gps_time":
            return uhd.sensor_value(name, int(time.time()), "s", "%d")
        return uhd.sensor_value(name, not self.device.faults.unlocked, "locked", "unlocked")

    def get_time_now(self, board):
        return uhd.time_spec(self.device.now_s)

    def get_time_last_pps(self, board):
        return uhd.time_spec(self.device.last_pulse_s)

    def set_time_now(self, spec):
        self.device.set_to(spec.get_real_secs())

    def set_time_next_pps(self, spec):
        self.device.at_next_pulse(spec.get_real_secs())

    def set_start_time(self, spec):
        self.begin_s = Fraction(spec.get_full_secs()) + Fraction(spec.get_frac_secs())
        self._set("start_time", (float(self.begin_s),))

    @property
    def rate(self) -> Fraction:
        return Fraction(self.state["samp_rate"])


class UsrpSource(_Radio):
    def __init__(self, device_args, stream_args):
        item = np.complex64 if stream_args.cpu_format == "fc32" else np.dtype((np.int16, 2))
        gr.sync_block.__init__(self, "usrp_source", None, [item])
        self._plug(device_args)
        self.is_sc16, self.lost, self.is_late = stream_args.cpu_format == "sc16", 0, False

    def start(self):
        now_s = self.device.now_s
        self.is_late = self.device.faults.starts_late or self.begin_s is not None and self.begin_s < now_s
        self.begin_s = Fraction(now_s + 0.01) if self.begin_s is None else self.begin_s
        return True

    def work(self, input_items, output_items):
        out, faults, number = output_items[0], self.device.faults, self.nitems_written(0)
        if faults.rx_dies_after is not None and number >= faults.rx_dies_after:
            raise RuntimeError("EnvironmentError: IOError: recv failed, the radio does not answer")
        end = min(n for n in (faults.rx_silent_after, faults.rx_dies_after, number + PACKET) if n is not None)
        if faults.rx_overrun_every:
            end = min(end, (number // faults.rx_overrun_every + 1) * faults.rx_overrun_every)
        came = int((Fraction(self.device.now_s) - self.begin_s) * self.rate) - self.lost  # samples that the antenna has heard
        count = min(len(out), end - number, came - number)
        if self.is_late or count <= 0:
            time.sleep(NAP_S)
            return 0
        is_new = number == 0
        if faults.rx_overrun_every and number and number % faults.rx_overrun_every == 0:
            self.lost += faults.rx_lost
            is_new = True
        first_s = self.begin_s + (number + self.lost) / self.rate
        if is_new:
            whole = int(first_s)
            stamp = pmt.make_tuple(pmt.from_uint64(whole), pmt.from_double(float(first_s - whole)))
            self.add_item_tag(0, number, pmt.intern("rx_time"), stamp)
        heard = self._heard(first_s, count)
        out[:count] = np.rint(heard.view(np.float32).reshape(-1, 2) * 32768) if self.is_sc16 else heard
        return count

    def _heard(self, first_s: Fraction, count: int) -> np.ndarray:
        code = self.device.code
        index = round(first_s * self.rate)  # a code that began at the clock's 0
        return (0.5 * code[(index + np.arange(count)) % len(code)]).astype(np.complex64)


class UsrpSink(_Radio):
    def __init__(self, device_args, stream_args, tag=""):
        gr.sync_block.__init__(self, "usrp_sink", [np.complex64], None)
        self._plug(device_args)
        self.message_port_register_out(pmt.intern("async_msgs"))
        self.next_s, self.end_s = (
            None,
            Fraction(0),
        )  # when the next sample leaves, None: between bursts; when the last one has left
        self.dried = set()

    def work(self, input_items, output_items):
        taken, faults, number = input_items[0], self.device.faults, self.nitems_read(0)
        if faults.tx_dies_after is not None and number >= faults.tx_dies_after:
            raise RuntimeError("EnvironmentError: IOError: send failed, the radio does not answer")
        now_s = Fraction(self.device.now_s)
        if faults.tx_silent_after is not None and number >= faults.tx_silent_after:
            time.sleep(NAP_S)
            return 0
        if self.next_s is not None and self.next_s - now_s > QUEUE_S:  # the queue is full
            time.sleep(NAP_S)
            return 0
        begin_s, count, ends = None, min(len(taken), int(QUEUE_S * self.rate) // 4 + 1), False
        for tag in self.get_tags_in_window(0, 0, count):
            at, name = tag.offset - number, pmt.symbol_to_string(tag.key)
            if name in ("tx_time", "tx_sob") and at > 0:
                count = min(count, at)
            elif name == "tx_time":
                begin_s = Fraction(pmt.to_uint64(pmt.tuple_ref(tag.value, 0))) + Fraction(
                    pmt.to_double(pmt.tuple_ref(tag.value, 1))
                )
            elif name == "tx_eob" and at < count:
                count, ends = at + 1, True
        for limit in (faults.tx_dies_after, faults.tx_silent_after):
            count = count if limit is None else min(count, limit - number)
        dry = [n for n in faults.tx_underrun_at if n not in self.dried and n < number + count]
        if dry and dry[0] > number:
            count, ends = dry[0] - number, False
        elif dry:
            self.dried.add(dry[0])
            self.next_s += Fraction(round(faults.tx_dry_s * self.rate)) / self.rate
            self._tell("underflow", self.next_s)
        self._leave(taken[:count].copy(), now_s, begin_s)
        if ends:
            self.next_s = None
        return count

    def _leave(self, samples, now_s: Fraction, begin_s: Fraction | None) -> None:
        if begin_s is None and self.next_s is None:
            begin_s = self.begin_s if self.begin_s is not None else now_s
            self.begin_s = None
        if begin_s is not None:
            if begin_s < self.end_s or self.device.faults.starts_late:
                self._tell("time_error", begin_s)
                begin_s = max(self.end_s, now_s)
            self.next_s = begin_s
        if self.next_s < now_s:  # a host too slow for a test is no fault of the radio's: its clock waits
            self.device.set_to(float(self.next_s))
        self.device.bursts.append((self.next_s, samples))
        self.next_s += len(samples) / self.rate
        self.end_s = self.next_s

    def _tell(self, code: str, when_s: Fraction) -> None:
        self.device.events.append((code, float(when_s)))
        about = pmt.dict_add(pmt.make_dict(), pmt.intern("event_code"), pmt.list1(pmt.intern(code)))
        stamp = pmt.cons(pmt.from_long(int(when_s)), pmt.from_double(float(when_s - int(when_s))))
        about = pmt.dict_add(about, pmt.intern("time_spec"), stamp)
        about = pmt.dict_add(about, pmt.intern("channel"), pmt.from_uint64(0))
        self.message_port_pub(pmt.intern("async_msgs"), pmt.cons(pmt.intern("uhd_async_msg"), about))


def plug_in(code=(1.0,), **faults) -> dict[str, Device]:
    """Replace gr-uhd's blocks. Returns the devices by their arguments, as programs make them."""
    uhd.usrp_sink, uhd.usrp_source = UsrpSink, UsrpSource
    _Radio.devices, _Radio.faults, _Radio.code = {}, Faults(**faults), code
    return _Radio.devices


if __name__ == "__main__":
    program = importlib.import_module(sys.argv[2])
    from gr_cast.signals import codes

    plug_in(codes.glfsr(8), **json.loads(sys.argv[1]))
    program._program.run(lambda: program.main(sys.argv[3:]))
