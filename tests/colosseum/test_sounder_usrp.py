# SPDX-License-Identifier: GPL-3.0-or-later
"""The CaST container over USRPs: UHD is a stand-in with a clock of its own, so that minutes pass in no time."""

import inspect
import sys
import threading
import types

import numpy as np
import pytest
from gr_cast.colosseum.sounder import radio
from gr_cast.core.errors import CastError

PERIOD = np.ones(7, np.complex64)
NODES, COUNT, RATE = 4, 2000, 1000.0


class Clock:
    """The time of one node's host, which passes while it waits, sends and listens; `off_s` from the truth."""

    def __init__(self, true_s, off_s):
        self.true_s, self.off_s = true_s, off_s

    def time(self):
        return self.true_s + self.off_s

    def wait(self, seconds):  # of the event that ends it
        self.true_s += seconds
        return False


class Usrp:
    """What the container calls of uhd.usrp.MultiUSRP; the air is when who sends."""

    def __init__(self, clock, air, own, rate_hz=RATE, locked=True):
        self.clock, self.air, self.own, self.rate_hz, self.locked = clock, air, own, rate_hz, locked
        self.sent, self.args = [], None

    def __call__(self, device_args):
        self.args = device_args
        return self

    def set_clock_source(self, source):
        assert source == "external"

    def set_time_source(self, source):
        assert source == "external"

    def set_rx_rate(self, rate_hz, channel):
        assert rate_hz == RATE

    def get_rx_rate(self, channel):
        return self.rate_hz

    def get_mboard_sensor(self, name, board):
        return types.SimpleNamespace(to_bool=lambda: self.locked)

    def send_waveform(self, waveform_proto, duration, freq, rate=1e6, channels=(0,), gain=10, start_time=None, streamer=None):
        self.sent.append((self.clock.true_s, self.clock.true_s + duration))
        self.clock.true_s += duration

    def recv_num_samps(self, num_samps, freq, rate=1e6, channels=(0,), gain=10, start_time=None, streamer=None):
        time_s = self.clock.true_s + np.arange(num_samps) / rate
        self.clock.true_s += num_samps / rate
        on_air = sum((n + 1) * ((time_s >= a) & (time_s < b)) for n, sent in self.air.items() for a, b in sent if n != self.own)
        return (on_air * np.ones((1, num_samps))).astype(np.complex64)


def plugged_in(monkeypatch, usrp, clock):
    monkeypatch.setitem(sys.modules, "uhd", types.SimpleNamespace(usrp=types.SimpleNamespace(MultiUSRP=usrp)))
    monkeypatch.setattr(radio, "time", clock)


def sounded(monkeypatch, begins_s, off_s, air):
    """(heard by, sent by) every node, nodes begun at true times and with host clocks `off_s` from it."""
    heard, sent = {}, {}
    for own in range(NODES):
        clock = Clock(begins_s[own], off_s[own])
        usrp = Usrp(clock, air, own)
        plugged_in(monkeypatch, usrp, clock)
        slots = radio.Slots(own=own, total=NODES, count=COUNT, guard=0, rate_hz=RATE, carrier_hz=1e9)
        heard[own] = radio.exchange("addr=192.168.40.2", slots, PERIOD, clock)
        sent[own] = usrp.sent
        assert usrp.args == "addr=192.168.40.2"
    return heard, sent


@pytest.mark.parametrize("seed", range(12))
def test_nodes_that_are_started_up_to_a_round_apart_hear_each_other_and_nobody_else(monkeypatch, seed):
    """Clocks a second off, starts up to a round apart: every record is one sender's, all of it."""
    rng = np.random.default_rng(seed)
    begins_s, off_s = 1.8e9 + rng.uniform(0, 23, NODES), rng.uniform(-0.45, 0.45, NODES)
    _, air = sounded(monkeypatch, begins_s, off_s, {})
    heard, _ = sounded(monkeypatch, begins_s, off_s, air)
    for own, found in heard.items():
        assert sorted(found) == [slot for slot in range(NODES) if slot != own]
        for slot, samples in found.items():
            assert set(samples) == {slot + 1}, (own, slot)


@pytest.mark.parametrize(
    ("about", "words"), [({"rate_hz": 900.0}, "rate: got 1000 Hz, .* can do 900 Hz"), ({"locked": False}, "does not lock")]
)
def test_a_device_that_does_otherwise_than_told_is_refused(monkeypatch, about, words):
    clock = Clock(1.8e9, 0)
    plugged_in(monkeypatch, Usrp(clock, {}, 0, **about), clock)
    slots = radio.Slots(own=0, total=2, count=10, guard=0, rate_hz=RATE, carrier_hz=1e9)
    with pytest.raises(CastError, match=words):
        radio.exchange("addr=192.168.40.2", slots, PERIOD, clock)


def test_a_radio_that_delivers_nothing_ends_in_a_line(monkeypatch):
    clock, silence = Clock(1.8e9, 0), threading.Event()
    usrp = Usrp(clock, {}, 1)
    usrp.recv_num_samps = lambda *words: silence.wait(30)
    usrp.recv_num_samps.__name__ = "recv_num_samps"
    plugged_in(monkeypatch, usrp, clock)
    monkeypatch.setattr(radio, "_EARLY_S", 0.1)
    slots = radio.Slots(own=1, total=2, count=10, guard=0, rate_hz=RATE, carrier_hz=1e9)
    with pytest.raises(CastError, match="recv_num_samps has not ended in 1.1 s: no samples pass"):
        radio.exchange("addr=192.168.40.2", slots, PERIOD, clock)
    silence.set()


def test_the_stand_in_takes_what_uhd_takes():
    uhd = pytest.importorskip("uhd", reason="NO PYTHON3-UHD: the stand-in is not held against it")
    for name in ("send_waveform", "recv_num_samps"):
        assert str(inspect.signature(getattr(uhd.usrp.MultiUSRP, name))).replace("1000000.0", "1e6") == str(
            inspect.signature(getattr(Usrp, name))
        ).replace("1000000.0", "1e6")
    for name in ("set_clock_source", "set_time_source", "set_rx_rate", "get_rx_rate", "get_mboard_sensor"):
        assert hasattr(uhd.usrp.MultiUSRP, name)
