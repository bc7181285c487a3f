# SPDX-License-Identifier: GPL-3.0-or-later
"""In the place of the hierarchy that `grcc` makes of wifi_phy_hier.grc. A payload `die` ends it as a crash does."""

import os

import numpy as np
import pmt
from gnuradio import gr
from gr_cast.blocks.modem import OfdmModem

KEPT = 40_000  # samples: more than any frame here


def _frame_of(message) -> bytes:
    return bytes(pmt.u8vector_elements(pmt.cdr(message)))


class Transmitter(gr.sync_block):
    """`mac_in` to samples of another level, with `packet_len` on the first of a frame."""

    def __init__(self, ofdm):
        gr.sync_block.__init__(self, "transmitter", None, [np.complex64])
        self._modem, self._rest, self._tagged = ofdm, np.zeros(0, np.complex64), True
        self.message_port_register_in(pmt.intern("mac_in"))
        self.set_msg_handler(pmt.intern("mac_in"), self._send)

    def _send(self, message):
        self._rest, self._tagged = 0.1 * self._modem.modulate(_frame_of(message)), False

    def work(self, input_items, output_items):
        if not self._tagged:
            length = pmt.from_long(len(self._rest))
            self.add_item_tag(0, self.nitems_written(0), pmt.intern("packet_len"), length)
            self._tagged = True
        count = min(len(self._rest), len(output_items[0]))
        output_items[0][:count] = self._rest[:count]
        self._rest = self._rest[count:]
        return count


class Receiver(gr.sync_block):
    """Samples to `mac_out`."""

    def __init__(self, ofdm):
        gr.sync_block.__init__(self, "receiver", [np.complex64], None)
        self._modem, self._heard, self._begin, self._newest = ofdm, np.zeros(0, np.complex64), 0, -1
        self.message_port_register_out(pmt.intern("mac_out"))

    def work(self, input_items, output_items):
        self._heard = np.append(self._heard, input_items[0])
        for packet in self._modem.demodulate(self._heard):
            start = self._begin + packet.start_sample
            if start <= self._newest + 300:
                continue
            self._newest = start
            if packet.payload.endswith(b"die"):
                os.abort()
            frame = pmt.init_u8vector(len(packet.payload), list(packet.payload))
            self.message_port_pub(pmt.intern("mac_out"), pmt.cons(pmt.PMT_NIL, frame))
        drop = max(0, len(self._heard) - KEPT)
        self._heard, self._begin = self._heard[drop:], self._begin + drop
        return len(input_items[0])


class wifi_phy_hier(gr.hier_block2):
    def __init__(self, bandwidth, chan_est, encoding, frequency, sensitivity):
        one = gr.io_signature(1, 1, gr.sizeof_gr_complex)
        gr.hier_block2.__init__(self, "wifi_phy_hier", one, one)
        print("MAPPER: encoding:", encoding, flush=True)
        ofdm = OfdmModem({0: "bpsk1/2", 2: "qpsk1/2", 4: "16qam1/2"}[encoding])
        self.message_port_register_hier_in("mac_in")
        self.message_port_register_hier_out("mac_out")
        self._blocks = Transmitter(ofdm), Receiver(ofdm)
        self.connect(self._blocks[0], self)
        self.connect(self, self._blocks[1])
        self.msg_connect(self, "mac_in", self._blocks[0], "mac_in")
        self.msg_connect(self._blocks[1], "mac_out", self, "mac_out")
