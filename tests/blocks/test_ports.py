# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios at the emulator's ports, by recorded calls: no device is there in a test."""

import numpy as np
import pytest
from gnuradio import blocks as stock
from gnuradio import gr, uhd
from gr_cast.blocks.emulation import Emulation
from gr_cast.blocks.ports import Port
from gr_cast.blocks.usrp import RadioSettings
from gr_cast.scenario import LinkTaps, Scenario


class FakeRadio(gr.hier_block2):
    """Records every call; sends ones for a while, or swallows what it is given."""

    def __init__(self, sends: bool, device_args: str, calls: list):
        item = gr.io_signature(1, 1, gr.sizeof_gr_complex)
        nothing = gr.io_signature(0, 0, 0)
        super().__init__("fake_radio", nothing if sends else item, item if sends else nothing)
        self.calls = calls
        self.device_args = device_args
        if sends:
            self.inner = stock.vector_source_c([1] * 5000)
            self.connect(self.inner, self)
        else:
            self.message_port_register_hier_out("async_msgs")
            self.inner = stock.vector_sink_c()
            self.connect(self, self.inner)

    def get_samp_rate(self):
        return 1e6

    def get_center_freq(self, channel):
        return 1e9

    def get_gain(self, channel):
        return 10.0

    def get_time_now(self, board):
        return uhd.time_spec(1.0)

    def __getattr__(self, name):
        if name.startswith("set_"):
            return lambda *arguments: self.calls.append((self.device_args, name, *arguments[:1]))
        return gr.hier_block2.__getattr__(self, name)


@pytest.fixture
def radios(monkeypatch):
    calls, made = [], []

    def fake(sends):
        def make(device_args, stream):
            made.append(FakeRadio(sends, device_args, calls))
            return made[-1]

        return make

    monkeypatch.setattr(uhd, "usrp_source", fake(True))
    monkeypatch.setattr(uhd, "usrp_sink", fake(False))
    return calls, made


def test_radio_ports_are_set_up_and_carry_the_emulated_samples(radios):
    calls, made = radios
    link = LinkTaps(delay_s=[[2e-6]], gain=[[0.5]])
    scenario = Scenario(name="s", nodes=("a", "b"), links={("a", "b"): link})
    ports = [Port.parse("a:tx=uhd:addr=192.168.40.2"), Port.parse("b:rx=uhd:addr=192.168.40.3")]
    settings = {
        (port.node, port.direction): RadioSettings(
            sample_rate_hz=1e6, center_frequency_hz=1e9, gain_db=10, device_args=port.where
        )
        for port in ports
    }
    top = Emulation(scenario, ports, 1e6, settings=settings)
    top.run()
    for args in ("addr=192.168.40.2", "addr=192.168.40.3"):
        mine = [call[1:] for call in calls if call[0] == args]
        assert {("set_samp_rate", 1e6), ("set_center_freq", 1e9), ("set_gain", 10)} <= set(mine)
        assert ("set_clock_source", "internal") in mine
    heard = np.array(made[1].inner.data())
    assert np.array_equal(heard, np.r_[0, 0, np.full(4998, 0.5)])
