# SPDX-License-Identifier: GPL-3.0-or-later
"""The plug of gr-ieee802-11: with the module itself where it is installed, and always with a stand-in derived from it."""

import os
import re
import signal
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from gr_cast.blocks import gr_ieee802_11, modem
from gr_cast.core.errors import CastError

STAND_INS = Path(__file__).resolve().parent / "stand_ins"
HEADER = 24
HERE = all(map(find_spec, gr_ieee802_11.MODULES))


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.syspath_prepend(STAND_INS)


@pytest.fixture(params=["stand-in", "the module itself"])
def installed(request):
    if request.param == "stand-in":
        request.getfixturevalue("stand_in")
    elif not HERE:
        pytest.skip("NO GR-IEEE802-11: build it and gr-foo, run grcc on examples/wifi_phy_hier.grc, set PYTHONPATH to both")


@pytest.fixture
def plugs():
    made = []
    yield lambda *arguments: made.append(modem.open_modem(*arguments)) or made[-1]
    for plug in made:
        plug._end()


def noise(rng, count: int, snr_db: float) -> np.ndarray:
    return 10 ** (-snr_db / 20) * (rng.normal(size=(count, 2)) @ (1, 1j)) / np.sqrt(2)


def buffers_of(plug) -> int:
    """Shared memory that the process has mapped: GNU Radio's buffers."""
    return len(re.findall("SYSV|/dev/shm|vmcircbuf", Path(f"/proc/{plug._process.pid}/maps").read_text()))


def test_auto_takes_the_module_where_it_is_installed(installed, plugs):
    assert plugs("auto", "16qam1/2").name == "802.11a 16qam1/2 (gr-ieee802-11)"


def test_frames_cross_noise_in_order_and_nothing_is_heard_of_noise_alone(installed, plugs, capfd):
    plug, rng = plugs("gr-ieee802-11", "qpsk1/2"), np.random.default_rng(1)
    before = buffers_of(plug)
    for number in range(12):
        payload = b"frame %d" % number + rng.bytes(200)
        sent = np.pad(plug.modulate(payload), 500)
        assert np.mean(np.abs(sent[500:-500]) ** 2) == pytest.approx(1, rel=1e-3)
        heard = plug.demodulate(sent + noise(rng, len(sent), 25 if number % 3 else -10))
        assert [packet.payload for packet in heard] == ([payload] if number % 3 else [])
    two = [b"first", b"second" * 20]
    stretch = np.concatenate([np.pad(plug.modulate(payload), 800) for payload in two])
    assert [packet.payload for packet in plug.demodulate(stretch + noise(rng, len(stretch), 30))] == two
    assert plug.restarts == 0
    assert buffers_of(plug) == before > 0  # one flowgraph, however many frames
    assert capfd.readouterr().out == ""


def test_frames_are_those_of_the_standard(installed, plugs):
    samples = plugs("gr-ieee802-11", "16qam1/2").modulate(b"payload")
    (packet,) = modem.OfdmModem("16qam1/2").demodulate(np.pad(samples, 500))
    assert packet.payload[HEADER : HEADER + 7] == b"payload"


def test_a_crash_inside_the_module_costs_one_frame_and_is_counted(stand_in, plugs):
    plug = plugs("gr-ieee802-11", "bpsk1/2")
    sent = [np.pad(plug.modulate(payload), 500) for payload in (b"die", b"live")]
    assert plug.demodulate(sent[0]) == []
    assert plug.restarts == 1
    assert [packet.payload for packet in plug.demodulate(sent[1])] == [b"live"]
    plug._process.kill()
    assert np.array_equal(plug.modulate(b"live"), plug.modulate(b"live"))
    assert plug.restarts == 2


def test_a_module_that_hangs_is_started_anew(stand_in, plugs, monkeypatch):
    plug = plugs("gr-ieee802-11", "bpsk1/2")
    monkeypatch.setattr(gr_ieee802_11, "_PATIENCE_S", 0.5)
    os.kill(plug._process.pid, signal.SIGSTOP)
    assert plug.modulate(b"frame").size > 0
    assert plug.restarts == 1


def test_a_module_that_always_dies_ends_the_run(stand_in, plugs):
    plug = plugs("gr-ieee802-11", "bpsk1/2")
    deadly = np.pad(plug.modulate(b"die"), 500)
    with pytest.raises(CastError, match="died 4 times in a row"):
        for _ in range(4):
            plug.demodulate(deadly)


def test_where_the_module_is_missing_it_is_named(monkeypatch):
    monkeypatch.setattr(gr_ieee802_11, "MODULES", ("no_such_module",))
    with pytest.raises(CastError, match="no_such_module"):
        modem.open_modem("gr-ieee802-11", "bpsk1/2")
    assert isinstance(modem.open_modem("auto", "bpsk1/2"), modem.OfdmModem)
