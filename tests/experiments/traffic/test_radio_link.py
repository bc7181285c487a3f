# SPDX-License-Identifier: GPL-3.0-or-later
"""Packets over modem and emulator, between sockets in the place of TUN devices: no rights are needed."""

import os
import socket
import time

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.blocks.modem import open_modem
from gr_cast.blocks.radio_link import LATENCY_S, FrameSink, RadioLink
from gr_cast.core.errors import CastError

MTU = 200


def exchanged(lower_db, count=40):
    """Packets that node 1 sends and those that node 2 gets, over the four-tap scenario at 20 dB."""
    ends = {node: socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for node in ("1", "2")}
    scenario = sc.with_base_loss(sc.load("four_tap"), lower_db)
    sent = [b"\x45" + bytes([number]) + os.urandom((10, 60, MTU - 20)[number % 3]) for number in range(count)]
    got = []
    try:
        tuns = {node: pair[0].fileno() for node, pair in ends.items()}
        with RadioLink(scenario, tuns, open_modem("802.11a", "qpsk1/2"), 500e3, noise_power=0.01, mtu=MTU) as link:
            for packet in sent:
                ends["1"][1].send(packet)
            ends["1"][1].send(b"\x60" + bytes(50))  # IPv6: not carried
            end = time.monotonic() + 60
            while link.status()["frames"]["1"]["sent"] < count or not link.is_quiet:
                assert time.monotonic() < end
                time.sleep(0.05)
            ends["2"][1].settimeout(5.0 if lower_db < 20 else 1.0)
            while len(got) < count:
                try:
                    got.append(ends["2"][1].recv(2000))
                except TimeoutError:
                    break
            frames = link.status()["frames"]
    finally:
        for pair in ends.values():
            for end in pair:
                end.close()
    return sent, got, frames


def test_every_packet_crosses_a_good_channel_once_and_in_order():
    sent, got, frames = exchanged(0)
    assert got == sent
    assert frames == {"1": {"sent": len(sent), "heard": 0}, "2": {"sent": 0, "heard": len(sent)}}


def test_nothing_crosses_where_the_taps_are_below_the_noise():
    _, got, frames = exchanged(30)
    assert got == []
    assert frames["2"]["heard"] == 0


def test_a_node_that_the_scenario_does_not_have_is_refused():
    with pytest.raises(CastError, match="no node 7"):
        RadioLink(sc.load("four_tap"), {"7": 0}, open_modem("802.11a", "qpsk1/2"), 500e3, noise_power=0.01, mtu=MTU)


@pytest.mark.parametrize("latency_s", [4e-3, LATENCY_S])
def test_a_packet_is_out_as_soon_as_the_latency_that_was_asked_for_has_passed(latency_s):
    """Counted in samples behind the frame's last, wherever it begins: no clock is asked."""
    rate_hz, modem, call = 500e3, open_modem("802.11a", "qpsk1/2"), 100
    tun, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    packet = b"\x45" + bytes(range(60))
    frame = modem.modulate(packet)
    with tun, far:
        far.setblocking(False)
        for begin in (0, 3333, 9999):
            sink = FrameSink(modem, tun.fileno(), rate_hz, 4000, latency_s)
            sink.work([np.zeros(20000, np.complex64)], [])
            samples = np.concatenate([np.zeros(begin), frame, np.zeros(int(latency_s * rate_hz) + 2 * call)]).astype(np.complex64)
            got = until = None
            for at in range(0, len(samples), call):
                sink.work([samples[at : at + call]], [])
                try:
                    got, until = far.recv(2000), at + call
                    break
                except BlockingIOError:
                    continue
            assert got == packet and until <= begin + len(frame) + latency_s * rate_hz + call
