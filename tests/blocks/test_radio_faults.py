# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios with a clock, a queue and faults: every fault ends in time with one line, and with what was received until then."""

import json
import signal
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path

import cast_emulator
import cast_sounder
import numpy as np
import pmt
import pytest
from gnuradio import blocks, gr, uhd
from gr_cast.blocks import emulation, running
from gr_cast.blocks.transmission import Lead
from gr_cast.core.errors import CastError
from gr_cast.signals import codes, recording

sys.path.append(str(Path(__file__).parent))
import fake_device

RATE = 200e3
CODE = codes.glfsr(8)
STILL_S = 0.6
RADIO = f"--rate {RATE:g} --frequency 1e9 --args addr=1".split()


@pytest.fixture
def radio(monkeypatch):
    """Plugs a fake device in for one test; call it with its faults."""
    monkeypatch.setattr(uhd, "usrp_sink", None)
    monkeypatch.setattr(uhd, "usrp_source", None)
    monkeypatch.setattr(running, "STILL_S", STILL_S)
    monkeypatch.setattr(emulation, "STILL_S", STILL_S)
    return lambda **faults: fake_device.plug_in(CODE, **faults)


def air(device, after_s=-np.inf):
    """(n,) numbers of samples on the device's clock, and the samples that left then."""
    index = [np.rint(float(at * Fraction(RATE))) + np.arange(len(sent)) for at, sent in device.bursts if at >= after_s]
    return np.concatenate(index), np.concatenate([sent for at, sent in device.bursts if at >= after_s])


def ended(command, within_s):
    """What a program ended in: its status, or the lines of its error."""
    begin = time.monotonic()
    try:
        return cast_sounder.main(command)
    except CastError as error:
        return error.faults
    finally:
        assert time.monotonic() - begin < within_s


# Receiving


@pytest.mark.parametrize(("fault", "count"), [("rx_silent_after", 0), ("rx_silent_after", 9000), ("rx_dies_after", 9000)])
@pytest.mark.parametrize("duration", [["--duration", "1"], []])
def test_a_receiver_that_falls_silent_or_dies_ends_in_one_line_and_what_came_is_readable(radio, tmp_path, fault, count, duration):
    radio(**{fault: count})
    (line,) = ended(["rx", *duration, "--output", str(tmp_path / "x"), *RADIO], 1 + 5)
    assert f"{count} samples passed" in line
    if count:
        assert len(recording.read(tmp_path / "x" / "recording").samples) == count
    else:
        assert not list(tmp_path.rglob("*.sigmf-*"))


def test_a_late_command_is_told_like_silence(radio, tmp_path):
    radio(starts_late=True)
    (line,) = ended(["rx", "--duration", "0.1", "--output", str(tmp_path / "x"), *RADIO], 5)
    assert "0 samples passed" in line


def test_overruns_end_in_the_recording_and_in_the_exit_status(radio, tmp_path, capsys):
    radio(rx_overrun_every=20_000, rx_lost=511)
    assert cast_sounder.main(["rx", "--duration", "0.35", "--record-only", "--output", str(tmp_path), *RADIO]) == 3
    read = recording.read(tmp_path / "recording")
    assert read.gaps == [(20_000, 511), (40_000, 511), (60_000, 511)] and len(read.samples) == 70_000
    assert capsys.readouterr().err == "lost: radio: 3 gaps, 1533 samples\n"


# Transmitting


def send(*more):
    return ["tx", "--code", "glfsr:8", "--amplitude", "0.5", *more, *RADIO]


def test_without_a_fault_every_sample_leaves_in_its_place_and_nothing_is_told(radio, tmp_path, capsys):
    devices = radio()
    assert cast_sounder.main(send("--duration", "0.4", "--log", str(tmp_path / "tx.json"))) == 0
    (device,) = devices.values()
    index, sent = air(device)
    assert np.array_equal(np.diff(index), np.ones(79_999)) and np.array_equal(sent, np.resize(0.5 * CODE, 80_000))
    log = json.loads((tmp_path / "tx.json").read_text())
    assert log["start_s"] * RATE == pytest.approx(index[0], abs=1e-3)
    assert (log["samples"], log["events"], log["restarts"]) == (80_000, [], 0)
    assert not device.events and not capsys.readouterr().err


def test_underruns_are_counted_with_their_times_in_the_log_and_the_exit_status(radio, tmp_path, capsys):
    devices = radio(tx_underrun_at=(20_000, 50_001))
    assert cast_sounder.main(send("--duration", "0.4", "--log", str(tmp_path / "tx.json"))) == 3
    (device,) = devices.values()
    log = json.loads((tmp_path / "tx.json").read_text())
    told = [(event["kind"], sum(event["device_time_s"])) for event in log["events"]]
    assert told == [("underrun", pytest.approx(when, abs=1e-9)) for _, when in device.events] and len(told) == 2
    assert "lost: radio: 2 underruns, the first at" in capsys.readouterr().err
    # What leaves after an underrun is out of the code's phase: that is why it has to be told.
    index, sent = air(device)
    assert not np.array_equal(sent, 0.5 * CODE[(index - index[0]).astype(int) % 255])


@pytest.mark.parametrize("at", [(20_000,), (20_000, 90_003)])
def test_an_aligned_restart_goes_on_in_the_phase_of_the_first_sample(radio, tmp_path, at):
    devices = radio(tx_underrun_at=at)
    assert cast_sounder.main(send("--duration", "1.5", "--restart-aligned", "--log", str(tmp_path / "tx.json"))) == 3
    (device,) = devices.values()
    log = json.loads((tmp_path / "tx.json").read_text())
    assert log["restarts"] == len(at) and log["samples"] == 300_000
    index, sent = air(device)
    assert np.all(np.diff(index) > 0), "no sample leaves before the one before it"
    begin = index[0]
    in_phase = sent == 0.5 * CODE[(index - begin).astype(int) % 255]
    # From the last restart on, as before the first underrun: all is as if the code had never ended.
    assert in_phase[:20_000].all() and in_phase[-100_000:].all()
    # Only what had been queued behind an underrun leaves out of phase.
    assert (~in_phase).sum() < len(at) * 1.5 * (1 << 15)


def test_a_transmitter_that_takes_nothing_any_more_ends_in_one_line(radio, tmp_path):
    for fault in ("tx_silent_after", "tx_dies_after"):
        radio(**{fault: 20_000})
        (line,) = ended(send("--duration", "1", "--log", str(tmp_path / "tx.json")), 1 + 5)
        assert line.startswith("radio: ")
        assert json.loads((tmp_path / "tx.json").read_text())["samples"] >= 20_000


def test_a_transmitter_whose_start_has_passed_is_told(radio, capsys):
    radio(starts_late=True)
    assert cast_sounder.main(send("--duration", "0.1")) == 3
    assert "1 late packet, the first at" in capsys.readouterr().err


def test_what_the_transmitter_tells_ends_in_the_metadata_of_the_recording(radio, tmp_path):
    radio(tx_underrun_at=(20_000,))
    log = tmp_path / "tx.json"
    assert cast_sounder.main(send("--duration", "0.2", "--log", str(log))) == 3
    receive = ["rx", "--duration", "0.1", "--record-only", "--tx-log", str(log), *RADIO, "--output"]
    assert cast_sounder.main([*receive, str(tmp_path / "x")]) == 3
    kept = recording.read(tmp_path / "x" / "recording").metadata["cast:transmit_events"]
    assert kept == json.loads(log.read_text())["events"] and kept[0]["kind"] == "underrun"
    log.write_text('{"cast_transmission": 1, "time_axis": "utc", "events": [{"kind": "hiccup", "device_time_s": [1, "x"]}]}')
    with pytest.raises(CastError) as refused:
        cast_sounder.main([*receive, str(tmp_path / "y")])
    assert len(refused.value.faults) == 2 and all(line.startswith(f"{log}: events[0]") for line in refused.value.faults)
    assert len(recording.read(tmp_path / "y" / "recording").samples) == 20_000


# One axis of time


def test_both_ends_that_start_at_one_second_measure_the_time_of_flight(radio, tmp_path):
    """Two devices whose clocks begin anywhere: the code that one sends from second S on comes 0 s late to the other's count."""
    devices, at = radio(), int(time.time()) + 4
    timed = f"--rate {RATE:g} --frequency 1e9 --clock-source external --time-source external --start-at {at}".split()
    assert cast_sounder.main(["tx", "--code", "glfsr:8", "--duration", "0.05", "--args", "addr=1", *timed]) == 0
    first, _ = air(devices["addr=1"])
    assert first[0] == at * RATE
    timed[-1] = str(at := int(time.time()) + 4)
    stem = tmp_path / "recording"
    assert (
        cast_sounder.main(["rx", "--record-only", "--duration", "0.05", "--args", "addr=2", "--output", str(tmp_path), *timed])
        == 0
    )
    read = recording.read(stem)
    assert read.captures[0]["cast:device_time_s"] == [at, 0.0] and read.metadata["cast:time_axis"] == "utc"


@pytest.mark.parametrize(
    ("faults", "words"),
    [({"no_pulse": True}, "no pulse comes"), ({"unlocked": True}, "does not lock"), ({"gain_db": 3.0}, "the device can do 3 dB"),
     ({"rate_hz": 250e3}, "the device can do 250000 Hz")],
)  # fmt: skip
def test_a_device_that_does_other_than_told_is_refused_in_one_line(radio, tmp_path, faults, words):
    radio(**faults)
    timed = f"--clock-source external --time-source external --start-at {int(time.time()) + 10}".split()
    (line,) = ended(["rx", "--duration", "0.1", "--output", str(tmp_path / "x"), *RADIO, *timed], 5)
    assert words in line and not list(tmp_path.rglob("*.sigmf-*"))


# The emulator's ports

SCENARIO = "cast_scenario: 1\nnodes: [a, b]\nlinks:\n  - {tx: a, rx: b, taps: [{delay_s: 0.0, gain_db: 0.0}]}\n"


@pytest.fixture
def emulate(tmp_path):
    """emulate(*ports, …): the status that a run between these ports ends with, or the lines of its error."""
    (tmp_path / "s.yaml").write_text(SCENARIO)

    def run(*ports, more=(), frequency=("--frequency", "1e9")):
        told = [word for port in ports for word in ("--port", port)]
        try:
            return cast_emulator.main(["run", str(tmp_path / "s.yaml"), "--rate", f"{RATE:g}", *frequency, *told, *more])
        except CastError as error:
            return error.faults

    return run


@pytest.fixture
def ramp(tmp_path):
    """A recording of 60,000 samples that differ from each other."""
    samples = np.exp(2j * np.pi * np.arange(60_000) ** 2 / 131_071).astype(np.complex64)
    recording.write(tmp_path / "sent", samples, sample_rate_hz=RATE)
    return f"a:tx=file:{tmp_path / 'sent'}", samples


def test_the_emulator_fills_its_transmit_queue_before_it_starts(radio, emulate, ramp):
    devices = radio()
    port, samples = ramp
    assert emulate(port, "b:rx=uhd:addr=1") == 0
    index, sent = air(devices["addr=1"])
    assert np.array_equal(np.diff(index), np.ones(len(samples) - 1)), "without a break"
    np.testing.assert_allclose(sent, samples, atol=1e-6)
    assert not devices["addr=1"].events


def test_a_radio_begins_one_lead_after_its_first_sample_came():
    lead, sink, top = Lead(lambda: 7.25, 0.125), blocks.vector_sink_c(), gr.top_block(catch_exceptions=False)
    top.connect(blocks.vector_source_c(range(20_000)), lead, sink)
    top.run()
    begins = [(tag.offset, pmt.to_python(tag.value)) for tag in sink.tags() if pmt.symbol_to_string(tag.key) == "tx_time"]
    assert begins == [(0, (7, 0.375))] and np.array_equal(sink.data(), np.arange(20_000))


def test_a_timed_start_leaves_the_queue_one_lead_to_fill(radio, emulate):
    """What a comes to the one radio at t leaves the other at t + 50 ms, to the sample."""
    devices, at = radio(rx_silent_after=60_000), int(time.time()) + 5
    timed = ["--clock-source", "external", "--time-source", "external", "--start-at", str(at)]
    (line,) = emulate("a:tx=uhd:addr=1", "b:rx=uhd:addr=2", more=timed)
    assert line == f"radio: a:tx=uhd:addr=1: 60000 samples passed, then none for {line.split()[-2]} s"
    index, sent = air(devices["addr=2"])
    assert index[0] == (at + 0.05) * RATE and np.array_equal(np.diff(index), np.ones(59_999))
    np.testing.assert_allclose(sent, 0.5 * CODE[(index - 0.05 * RATE).astype(int) % 255], atol=1e-6)


def test_every_port_has_settings_of_its_own(radio, emulate):
    devices = radio(rx_silent_after=1000)
    ports = (
        "a:tx=uhd:addr=1,gain=3,antenna=RX2,subdevice=B:0,frequency=2.4e9,master_clock_rate=200e6",
        "b:rx=uhd:gain=7.5,addr=2,antenna=TX/RX",
    )
    emulate(*ports, more=["--gain", "1", "--subdevice", "A:0"])
    told = {name: {call[1]: call[2] for call in device.calls} for name, device in devices.items()}
    assert list(told) == ["addr=1,master_clock_rate=200e6", "addr=2"], "what is not the port's own goes to UHD"
    keys = ("gain", "antenna", "subdev_spec", "center_freq")
    assert [told["addr=1,master_clock_rate=200e6"][key] for key in keys] == [3.0, "RX2", "B:0", 2.4e9]
    assert [told["addr=2"][key] for key in keys] == [7.5, "TX/RX", "A:0", 1e9]


def test_what_a_port_cannot_mean_is_refused_with_all_its_faults(radio, emulate):
    radio()
    assert emulate("a:tx=uhd:addr=1,gain=loud,start_at=noon", frequency=()) == (
        "port a:tx: gain: got 'loud', needs a number",
        "port a:tx: start_at: got 'noon', needs Unix seconds, or whole seconds with a zone: 2026-05-01T12:00:00Z",
        "port a:tx: frequency: got nothing, a radio needs its carrier in Hz: frequency=HZ, or --frequency for all",
    )
    assert emulate("a:tx=uhd:addr=1,gain=100") == ("port a:tx: gain: got 100.0 dB, needs 0 to 90 dB",)


def test_underruns_and_overruns_of_ports_are_counted_in_status_metadata_and_exit_status(radio, emulate, ramp, tmp_path, capsys):
    radio(tx_underrun_at=(20_000,))
    record = f"a:rx=file:{tmp_path / 'heard'}"
    assert emulate(ramp[0], "b:rx=uhd:addr=1", record) == 3
    said = capsys.readouterr().err
    assert "1 underruns at b:rx=uhd:addr=1" in said and "lost: b:rx=uhd:addr=1: 1 underrun, the first at" in said
    ((name, events),) = recording.read(tmp_path / "heard").metadata["cast:radio_events"].items()
    assert name == "b:rx=uhd:addr=1" and [event["kind"] for event in events] == ["underrun"]
    radio(rx_overrun_every=20_000, rx_lost=100, rx_silent_after=50_000)
    (line,) = emulate("a:tx=uhd:addr=1", f"b:rx=file:{tmp_path / 'y'}")
    assert "50000 samples passed" in line
    read = recording.read(tmp_path / "y")
    assert [e["lost_samples"] for e in read.metadata["cast:radio_events"]["a:tx=uhd:addr=1"]] == [100, 100]
    assert 49_000 <= len(read.samples) <= 50_000


@pytest.mark.parametrize(
    ("faults", "ports", "silent"),
    [({"rx_silent_after": 5000}, "a:tx=uhd:addr=1 b:rx=null", "a:tx"), ({"rx_dies_after": 5000}, "a:tx=uhd:addr=1", "a:tx"),
     ({"tx_silent_after": 5000}, "a:tx=null b:rx=uhd:addr=1", "b:rx"), ({"tx_dies_after": 5000}, "b:rx=uhd:addr=1", "b:rx")],
)  # fmt: skip
def test_a_port_whose_radio_falls_silent_or_dies_is_named_and_ends_the_run(radio, emulate, faults, ports, silent):
    radio(**faults)
    begin = time.monotonic()
    (line,) = emulate(*ports.split())
    assert line.startswith(f"radio: {silent}=uhd:addr=1: ") and time.monotonic() - begin < 5


def test_no_device_is_one_line_and_leaves_nothing(radio, emulate, tmp_path):
    radio()
    before = set(tmp_path.rglob("*"))
    (line,) = emulate("a:tx=uhd:addr=absent", f"b:rx=file:{tmp_path / 'y'}")
    assert line.startswith("device: got arguments 'addr=absent'") and "No devices found" in line
    assert ended(["rx", "--duration", "1", "--output", str(tmp_path / "z"), "--args", "addr=absent"], 5)[0] == line
    assert set(tmp_path.rglob("*")) - before <= {tmp_path / "s.yaml"}


def test_a_signal_while_a_program_on_the_fake_is_being_loaded_ends_it_in_one_word():
    """Python's own interrupt may be swallowed by what is being loaded: the program then runs for ever."""
    words = [sys.executable, fake_device.__file__, "{}", "cast_sounder", "tx", *RADIO]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as program:
        while "numpy" not in Path(f"/proc/{program.pid}/maps").read_text():  # the first that it loads
            assert program.poll() is None
        program.send_signal(signal.SIGINT)
        assert program.communicate(timeout=60)[1] == "interrupted\n" and program.returncode == 130
