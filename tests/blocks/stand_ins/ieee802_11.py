# SPDX-License-Identifier: GPL-3.0-or-later
"""In the place of gr-ieee802-11, as it was seen to behave: ports, tags and what it prints."""

import pmt
from gnuradio import gr

HEADER = bytes.fromhex("08000000424242424242232323232323ffffffffffffb000")
Equalizer = Encoding = int


class mac(gr.basic_block):
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
