# SPDX-License-Identifier: GPL-3.0-or-later
"""A site's program over radios with a clock of their own: nodes send and record from one second on, and nothing lost passes."""

import os
import sys
from fractions import Fraction
from pathlib import Path

import cast_pipeline
import numpy as np
import pytest
from gnuradio import uhd
from gr_cast import scenario as sc
from gr_cast.blocks import site_radios
from gr_cast.core.errors import CastError
from gr_cast.pipeline import air, site
from gr_cast.signals import codes

sys.path.append(str(Path(__file__).parent))
import fake_device

RATE = 200e3
CODE = codes.glfsr(8)
RNG = np.random.default_rng(4)
SENT = (RNG.uniform(-1, 1, 6000) + 1j * RNG.uniform(-1, 1, 6000)).astype(np.complex64) / 2
DEVICES = {"1": "addr=1,tx_gain=15,rx_gain=3,tx_antenna=TX/RX", "2": "addr=2,rx_gain=20"}
BAND = site_radios.Band(sample_rate_hz=RATE, center_frequency_hz=1e9)


@pytest.fixture
def radios(monkeypatch):
    """Plugs fake devices in for one test; call it with their faults."""
    monkeypatch.setattr(uhd, "usrp_sink", None)
    monkeypatch.setattr(uhd, "usrp_source", None)
    monkeypatch.setattr(site_radios, "SET_UP_S", 2)
    return lambda **faults: fake_device.plug_in(CODE, **faults)


def test_what_is_sent_leaves_and_what_is_heard_begins_at_one_second_of_utc(radios, tmp_path):
    """The fake air sends a code from the clock's 0 on: its phase in the recording tells when that began."""
    devices = radios()
    site_radios.play_and_record({"1": SENT}, ["2"], DEVICES, BAND, tmp_path)
    begin, first = devices["addr=1"].bursts[0]
    assert begin == int(begin)
    assert np.array_equal(np.concatenate([samples for _, samples in devices["addr=1"].bursts]), SENT)
    heard = np.fromfile(tmp_path / "rx_2.cf32", "<c8")
    index = int(begin * Fraction(RATE)) + np.arange(len(SENT))
    assert np.array_equal(heard, (0.5 * CODE[index % 255]).astype(np.complex64))
    assert [path.name for path in tmp_path.iterdir()] == ["rx_2.cf32"]
    told = {call[:3] for device in devices.values() for call in device.calls if call[1] in ("gain", "antenna")}
    assert told == {("UsrpSink", "gain", 15.0), ("UsrpSink", "antenna", "TX/RX"), ("UsrpSource", "gain", 20.0)}


def test_a_lost_sample_at_either_end_is_no_recording_to_judge_a_commit_by(radios, tmp_path):
    radios(rx_overrun_every=2500, tx_underrun_at=(3000,))
    with pytest.raises(CastError) as refused:
        site_radios.play_and_record({"1": SENT}, ["2"], DEVICES, BAND, tmp_path)
    assert [fault.split(",")[0] for fault in refused.value.faults] == ["node 1: 1 underrun", "node 2: 2 gaps"]
    assert not (tmp_path / "rx_2.cf32").exists()


def test_an_inventory_of_radios_is_played_as_it_stands(tmp_path, monkeypatch):
    """As `run` calls it: the inventory's program, in a process of its own, finds every node's device arguments."""
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    (tmp_path / "arena.yaml").write_text(
        f"cast_site: 1\nprogram: /usr/bin/python3 {fake_device.__file__} {{}} cast_pipeline radios --amplitude 1\n"
        "nodes:\n  '1': {interface: eth2, device: addr=1}\n  '2': {interface: eth2, device: addr=2}\n"
    )
    room = sc.Scenario(nodes=("1", "2"), links={}, name="room", center_frequency_hz=1e9)
    heard = air.carried(site.read(tmp_path / "arena.yaml"), room, {"1": SENT}, ["2"], RATE, 1, tmp_path, 60.0)
    assert len(heard["2"]) == len(SENT) and set(np.abs(heard["2"])) == {0.5}


def test_device_arguments_that_cannot_be_are_told_all_at_once_with_their_nodes():
    devices = {"1": "addr=1,tx_gain=200", "2": "addr=2,rx_gain=much"}
    with pytest.raises(CastError) as refused:
        site_radios.settings(devices, [("1", "tx"), ("2", "rx")], BAND)
    assert [*refused.value.faults] == [
        "node 1: tx: gain: got 200.0 dB, needs 0 to 90 dB", "node 2: rx: gain: got 'much', needs a number"
    ]  # fmt: skip


def test_called_by_hand_it_says_who_calls_it(monkeypatch):
    for name in air.TOLD:
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(CastError, match="CAST_TRANSMITTERS, .*: not set: an inventory's program is called by cast_pipeline run"):
        cast_pipeline.main(["radios"])
