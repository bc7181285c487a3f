# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio's own senders, with their stream tags between the samples and without."""

import time

import numpy as np
import pmt
import pytest
from gnuradio import blocks as stock
from gnuradio import gr, zeromq
from gr_cast.blocks.cast_python import zmq_requester, zmq_subscriber

RAMP = np.arange(1, 5001).astype(np.complex64)


@pytest.fixture
def address(tmp_path):
    return f"ipc://{tmp_path / 's'}"


def sender(kind, address: str, pass_tags: bool) -> gr.top_block:
    """Sends RAMP again and again, an rx_time tag on its first sample."""
    tag = gr.tag_utils.python_to_tag((0, pmt.intern("rx_time"), pmt.make_tuple(pmt.from_uint64(7), pmt.from_double(0.5))))
    top = gr.top_block()
    source = stock.vector_source_c(RAMP.tolist(), True, 1, [tag])
    throttled = stock.throttle(gr.sizeof_gr_complex, 200e3)
    top.connect(source, throttled, kind(gr.sizeof_gr_complex, 1, address, 100, pass_tags, -1))
    return top


@pytest.mark.parametrize(
    ("port", "kind"), [(zmq_requester, zeromq.rep_sink), (zmq_subscriber, zeromq.pub_sink)], ids=["req", "pubsub"]
)
def test_nothing_is_taken_of_a_sender_of_tags_and_all_of_it_when_it_returns_without(address, port, kind, capfd):
    top, heard = gr.top_block(), stock.vector_sink_c()
    receiver = port(address)
    top.connect(receiver, heard)
    top.start()
    try:
        for pass_tags in (True, False):
            peer = sender(kind, address, pass_tags)
            peer.start()
            until = time.monotonic() + (1 if pass_tags else 20)
            while len(heard.data()) < len(RAMP) and time.monotonic() < until:
                time.sleep(0.02)
            peer.stop()
            peer.wait()
            del peer
            assert bool(heard.data()) != pass_tags
    finally:
        top.stop()
        top.wait()
    # A publisher is joined anywhere in its stream; from there on every sample is the one after the last.
    samples = np.array(heard.data()).real
    assert set(np.diff(samples)) <= {1.0, 1.0 - len(RAMP)}
    assert "Pass Tags" in "".join(capfd.readouterr())
