# SPDX-License-Identifier: GPL-3.0-or-later
"""The adapter to gr-ieee802-11 against a stand-in with that module's ports: no package has the real one."""

import sys
import types

import numpy as np
import pmt
import pytest
from gnuradio import gr
from gr_cast.blocks import modem

HEADER = bytes(range(24))


class Mac(gr.basic_block):
    """`app in` to `phy out`, with a MAC header before the payload."""

    def __init__(self, *addresses):
        gr.basic_block.__init__(self, "mac", None, None)
        assert [len(address) for address in addresses] == [6, 6, 6]
        self.message_port_register_in(pmt.intern("app in"))
        self.message_port_register_out(pmt.intern("phy out"))
        self.set_msg_handler(pmt.intern("app in"), self._send)

    def _send(self, message):
        frame = HEADER + bytes(pmt.u8vector_elements(pmt.cdr(message)))
        self.message_port_pub(pmt.intern("phy out"), pmt.cons(pmt.PMT_NIL, pmt.init_u8vector(len(frame), list(frame))))


class Transmitter(gr.sync_block):
    """`mac_in` to samples, at another level."""

    def __init__(self, ofdm):
        gr.sync_block.__init__(self, "transmitter", None, [np.complex64])
        self._modem, self._rest = ofdm, np.zeros(0, np.complex64)
        self.message_port_register_in(pmt.intern("mac_in"))
        self.set_msg_handler(pmt.intern("mac_in"), self._send)

    def _send(self, message):
        self._rest = 0.1 * self._modem.modulate(bytes(pmt.u8vector_elements(pmt.cdr(message))))

    def work(self, input_items, output_items):
        count = min(len(self._rest), len(output_items[0]))
        output_items[0][:count] = self._rest[:count]
        self._rest = self._rest[count:]
        return count


class Receiver(gr.sync_block):
    """Samples to `mac_out`."""

    def __init__(self, ofdm):
        gr.sync_block.__init__(self, "receiver", [np.complex64], None)
        self._modem, self._heard, self._told = ofdm, np.zeros(0, np.complex64), 0
        self.message_port_register_out(pmt.intern("mac_out"))

    def work(self, input_items, output_items):
        self._heard = np.append(self._heard, input_items[0])
        found = self._modem.demodulate(self._heard)
        for packet in found[self._told :]:
            frame = pmt.init_u8vector(len(packet.payload), list(packet.payload))
            self.message_port_pub(pmt.intern("mac_out"), pmt.cons(pmt.PMT_NIL, frame))
        self._told = len(found)
        return len(input_items[0])


class Phy(gr.hier_block2):
    def __init__(self, bandwidth, chan_est, encoding, frequency, sensitivity):
        one = gr.io_signature(1, 1, gr.sizeof_gr_complex)
        gr.hier_block2.__init__(self, "phy", one, one)
        ofdm = modem.OfdmModem({0: "bpsk1/2", 2: "qpsk1/2", 4: "16qam1/2"}[encoding])
        self.message_port_register_hier_in("mac_in")
        self.message_port_register_hier_out("mac_out")
        self._blocks = Transmitter(ofdm), Receiver(ofdm)
        self.connect(self._blocks[0], self)
        self.connect(self, self._blocks[1])
        self.msg_connect(self, "mac_in", self._blocks[0], "mac_in")
        self.msg_connect(self._blocks[1], "mac_out", self, "mac_out")


@pytest.fixture
def installed(monkeypatch):
    package = types.ModuleType("ieee802_11")
    package.mac, package.Equalizer, package.Encoding = Mac, int, int
    hierarchy = types.ModuleType("wifi_phy_hier")
    hierarchy.wifi_phy_hier = Phy
    monkeypatch.setitem(sys.modules, "ieee802_11", package)
    monkeypatch.setitem(sys.modules, "wifi_phy_hier", hierarchy)


def test_auto_takes_the_module_where_it_is_installed(installed):
    assert modem.open_modem("auto", "16qam1/2").name == "802.11a 16qam1/2 (gr-ieee802-11)"


def test_packets_come_back_without_the_mac_header(installed):
    plug = modem.open_modem("gr-ieee802-11", "qpsk1/2")
    payloads = [b"first", b"second" * 20]
    samples = np.concatenate([np.pad(modem.OfdmModem("qpsk1/2").modulate(HEADER + p), 500) for p in payloads])
    assert [packet.payload for packet in plug.demodulate(samples)] == payloads


def test_a_frame_has_power_one_and_the_mac_header(installed):
    samples = modem.open_modem("gr-ieee802-11", "16qam1/2").modulate(b"payload")
    assert np.mean(np.abs(samples) ** 2) == pytest.approx(1, abs=1e-3)
    (packet,) = modem.OfdmModem("16qam1/2").demodulate(np.pad(samples, 500))
    assert packet.payload == HEADER + b"payload"
