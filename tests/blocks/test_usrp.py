# SPDX-License-Identifier: GPL-3.0-or-later
"""The sounder's radios by recorded calls: what an X310 is told, and what becomes of its samples."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from datetime import datetime, timezone
from pathlib import Path

import cast_sounder
import numpy as np
import pytest
from gnuradio import blocks, gr, uhd
from gr_cast.blocks import running
from gr_cast.blocks.recorder import SigmfRecorder
from gr_cast.core.errors import CastError
from gr_cast.signals import codes, recording

sys.path.append(str(Path(__file__).parent))
import fake_usrp

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "apps" / "cast_sounder.py"
RADIO = (
    "--args addr=192.168.40.2 --rate 25e6 --frequency 2.4e9 --gain 15 --subdevice B:0 --clock-source external"
    " --time-source external"
).split()


@pytest.fixture
def radio(monkeypatch):
    """Plugs fakes in for one test; call it with the code on the air and what the device answers."""
    monkeypatch.setattr(uhd, "usrp_sink", None)
    monkeypatch.setattr(uhd, "usrp_source", None)
    return fake_usrp.plug_in


def set_up(cpu_format, antenna):
    return [
        ("make", "addr=192.168.40.2", cpu_format, "sc16", [0]),
        ("set_clock_source", "external", 0),
        ("set_time_source", "external", 0),
        ("set_subdev_spec", "B:0", 0),
        ("set_samp_rate", 25e6),
        ("set_center_freq", 2.4e9, 0),
        ("set_gain", 15.0, 0),
        ("set_antenna", antenna, 0),
        ("set_time_now", 0.0),
    ]


def test_tx_sets_the_radio_up_as_told_and_sends_the_code_at_its_amplitude(radio):
    calls = radio()
    sending = "tx --antenna TX/RX --code glfsr:7 --amplitude 0.25 --duration 1e-4".split()
    assert cast_sounder.main(sending + RADIO) == 0
    assert calls == set_up("fc32", "TX/RX")
    assert np.array_equal(fake_usrp.Radio.sent.data(), np.resize(0.25 * codes.glfsr(7), 2500))


@pytest.mark.parametrize("delivered", [0, 30_000])
def test_a_radio_that_stops_delivering_ends_in_one_line_and_what_came_is_kept(radio, tmp_path, monkeypatch, delivered):
    monkeypatch.setattr(running, "STILL_S", 0.5)
    radio(codes.glfsr(8), air_rate=1e6, silent_after=delivered)
    begin = time.monotonic()
    with pytest.raises(CastError) as told:
        cast_sounder.main(f"rx --rate 1e6 --duration 0.1 --output {tmp_path}".split())
    assert time.monotonic() - begin < 5
    (line,) = told.value.faults
    assert f"{delivered} samples passed" in line and "--subdevice" in line
    if delivered:
        assert len(recording.read(tmp_path / "recording").samples) == delivered
    else:
        assert not list(tmp_path.glob("recording*")), "the name stays free"


@pytest.mark.parametrize(("chosen", "cpu_format"), [("cf32", "fc32"), ("ci16", "sc16")])
def test_rx_sets_the_radio_up_as_told_and_keeps_what_redoes_the_result(radio, tmp_path, chosen, cpu_format):
    calls = radio(codes.glfsr(8), air_rate=25e6)
    receiving = f"rx --antenna RX2 --duration 0.01 --format {chosen} --node b --transmitter a".split()
    assert cast_sounder.main([*receiving, "--output", str(tmp_path), *RADIO]) == 3, "the air loses samples"
    assert calls == set_up(cpu_format, "RX2")
    read = recording.read(tmp_path / "recording")
    assert len(read.samples) == 250_000
    assert (read.sample_rate_hz, read.center_frequency_hz) == (25e6, 2.4e9)
    kept = {key.removeprefix("cast:"): value for key, value in read.metadata.items()}
    assert kept["waveform"] == {"code": "glfsr", "degree": 8, "samples_per_chip": 1}
    assert (kept["rx_gain_db"], kept["clock_source"], kept["time_source"]) == (15.0, "external", "external")
    assert (kept["receiver"], kept["transmitter"], kept["antenna"]) == ("b", "a", "RX2")


def test_without_a_timed_start_nothing_waits_for_a_pps(radio):
    calls = radio()
    cast_sounder.main("tx --duration 1e-4".split())
    names = [name for name, *_ in calls]
    assert ("set_time_now", 0.0) in calls
    assert not {"set_time_next_pps", "set_start_time", "set_antenna", "set_subdev_spec"} & set(names)


@pytest.mark.parametrize("source", ["external", "gpsdo"])
def test_two_hosts_that_start_at_one_second_share_one_axis_of_time(radio, tmp_path, source):
    """Each sets its clock to UTC at a pulse of its own; both streams begin at the agreed second, to the sample."""
    calls, at = radio(codes.glfsr(8), air_rate=1e6), int(time.time()) + 6
    timed = f"--rate 1e6 --clock-source external --time-source {source} --start-at {at}".split()
    cast_sounder.main(["tx", "--duration", "1e-3", *timed])
    moment = datetime.fromtimestamp(at, timezone.utc).isoformat()
    cast_sounder.main(["rx", "--duration", "0.01", "--output", str(tmp_path), *timed[:-1], moment])
    pulses = [value for name, value, *_ in calls if name == "set_time_next_pps"]
    assert len(pulses) == 2 and pulses[0] < pulses[1] and all(at - 6 <= pulse < at for pulse in pulses)
    assert [value for name, value, *_ in calls if name == "set_start_time"] == [at, at]
    assert recording.read(tmp_path / "recording").metadata["cast:time_axis"] == "utc"


def test_without_a_pulse_or_with_a_second_that_is_over_nothing_is_sent(radio, capsys):
    calls = radio(pulse=False)
    timed = "tx --rate 1e6 --clock-source external --time-source external --start-at".split()
    with pytest.raises(CastError, match="no pulse comes"):
        cast_sounder.main([*timed, str(int(time.time()) + 20)])
    for second, words in ((int(time.time()) - 5, "coming 24 hours"), (int(time.time()) + 10**6, "coming 24 hours")):
        with pytest.raises(CastError, match=words):
            cast_sounder.main([*timed, str(second)])
    for wrong in ("12:00", "2026-05-01T12:00:00", "soon"):
        with pytest.raises(SystemExit):
            cast_sounder.main([*timed, wrong])
        assert f"got '{wrong}', needs Unix seconds" in capsys.readouterr().err
    with pytest.raises(CastError, match="every radio shares"):
        cast_sounder.main(["tx", "--start-at", str(int(time.time()) + 20)])
    assert "set_start_time" not in {name for name, *_ in calls}


def test_samples_that_the_radio_loses_become_captures_and_leave_the_delays_alone(radio, tmp_path):
    radio(codes.glfsr(8), air_rate=1e6)
    cast_sounder.main(f"rx --rate 1e6 --duration 0.35 --output {tmp_path}".split())
    read = recording.read(tmp_path / "recording")
    assert read.gaps == [(100_000, 777), (200_000, 777), (300_000, 777)]
    passed = [[7, 0.25], *([7, 0.25 + k * 0.100777] for k in (1, 2, 3))]
    assert [capture["cast:device_time_s"] for capture in read.captures] == [pytest.approx(t, abs=1e-9) for t in passed]
    result = json.loads((tmp_path / "result.json").read_text())
    (tap,) = result["taps"]
    assert tap["delay_s"] == pytest.approx(fake_usrp.DELAY_SAMPLES / 1e6, abs=1e-10)
    assert tap["gain_db"] == pytest.approx(20 * np.log10(0.5), abs=0.01)
    assert any("3 gaps, 2331 samples lost" in warning for warning in result["warnings"])


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ({"samp_rate": 25.6e6}, ["rate", "2.56e+07", "master clock"]),
        ({"center_freq": 2.4e9 + 50}, ["frequency", "2400000050 Hz"]),
        ({"gain": 11.5}, ["gain", "got 15 dB", "11.5 dB"]),
        ({"ref_locked": False}, ["clock source", "external", "not lock"]),
    ],
)
def test_a_device_that_does_other_than_told_is_refused(radio, tmp_path, answers, words):
    radio(codes.glfsr(8), **answers)
    with pytest.raises(CastError) as refused:
        cast_sounder.main(["rx", "--duration", "0.01", "--output", str(tmp_path), *RADIO])
    (fault,) = refused.value.faults
    assert all(word in fault for word in words), fault
    assert not list(tmp_path.iterdir()), "nothing half-written"


def test_what_uhd_throws_while_setting_up_is_one_clear_error(radio, monkeypatch):
    radio()

    def refuse(*_):
        raise RuntimeError("bad spec B:0")

    monkeypatch.setattr(fake_usrp.Radio, "set_subdev_spec", refuse, raising=False)
    with pytest.raises(CastError, match="device: .*bad spec B:0"):
        cast_sounder.main(["tx", *RADIO])


@pytest.mark.parametrize("command", ["tx", "rx", "devices"])
def test_no_device_is_one_clear_error_and_status_2(tmp_path, command):
    told = subprocess.run(
        [PROGRAM, command, "--args", "addr=192.0.2.1"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert told.returncode == 2, told.stderr
    assert len([line for line in told.stderr.splitlines() if line.startswith("error: device")]) == 1
    assert "addr=192.0.2.1" in told.stderr and "Traceback" not in told.stderr
    assert not list(tmp_path.iterdir()), "nothing half-written, no empty folder"


def start_fake(tmp_path, *arguments):
    return subprocess.Popen(
        ["/usr/bin/python3", fake_usrp.__file__, "cast_sounder", *arguments],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"MPLBACKEND": "Agg"},
    )


def wait_for(path, size, program):
    deadline = time.monotonic() + 60
    while not (path.exists() and path.stat().st_size > size):
        assert time.monotonic() < deadline and program.poll() is None, program.communicate()
        time.sleep(0.01)


@pytest.mark.parametrize("megabytes", [1, 3, 7, 20])
def test_a_receiver_that_is_killed_leaves_a_recording_with_the_gaps_until_then(tmp_path, megabytes):
    program = start_fake(tmp_path, "rx", "--output", "out", "--format", "ci16")
    wait_for(tmp_path / "out" / "recording.sigmf-data", megabytes * 1_000_000, program)
    program.kill()
    program.communicate(timeout=60)
    read = recording.read(tmp_path / "out" / "recording")
    count = len(read.samples)
    assert count >= megabytes * 250_000
    expected = [(start, 777) for start in range(100_000, count, 100_000)]
    # The newest gap may not have reached the metadata yet; all before it have.
    assert read.gaps in (expected, expected[:-1])


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_an_open_ended_recording_that_is_stopped_is_sealed_and_sounded(tmp_path, how):
    program = start_fake(tmp_path, "rx", "--output", "out")
    wait_for(tmp_path / "out" / "recording.sigmf-data", 1_000_000, program)
    program.send_signal(how)
    _, told = program.communicate(timeout=120)
    assert program.returncode == 3 and "stopped early" in told and "lost: radio: " in told, told
    assert "core:sha512" in recording.read(tmp_path / "out" / "recording").metadata
    assert (tmp_path / "out" / "result.json").is_file()


def test_a_transmitter_is_stopped_by_ctrl_c(tmp_path):
    program = start_fake(tmp_path, "tx")
    assert "sending glfsr:8" in program.stdout.readline()
    time.sleep(0.5)
    program.send_signal(signal.SIGINT)
    _, told = program.communicate(timeout=60)
    assert program.returncode == 0 and "Traceback" not in told, told


def test_a_full_disk_ends_the_recording_at_a_whole_sample(tmp_path):
    limit = 1_000_001  # bytes: amid a sample
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    top = gr.top_block(catch_exceptions=False)
    source = blocks.vector_source_c([0.5] * 1000, True)
    recorder = SigmfRecorder(top, source, tmp_path / "x", sample_rate_hz=1e6)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        top.run()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    with pytest.raises(OSError, match="File too large"):
        recorder.finish()
    read = recording.read(tmp_path / "x")
    assert 0 < len(read.samples) <= limit // 8
    assert np.all(read.samples == 0.5)


def test_what_is_no_number_is_counted_and_recorded_as_nothing(tmp_path):
    sent = np.full(70_000, 0.5 + 0.5j, np.complex64)
    sent[[40_000, 40_001, 69_999]] = complex(np.nan, 1), complex(1, np.inf), complex(-np.inf, np.nan)
    top = gr.top_block(catch_exceptions=False)
    recorder = SigmfRecorder(top, blocks.vector_source_c(sent, False), tmp_path / "x", sample_rate_hz=1e6)
    top.run()
    recorder.finish()
    read = recording.read(tmp_path / "x")
    assert recorder.not_finite == read.metadata["cast:not_finite_samples"] == 3
    assert read.metadata["cast:first_not_finite"] == 40_000
    np.testing.assert_array_equal(read.samples, np.where(np.isfinite(sent), sent, 0))


def test_a_recording_is_never_overwritten(tmp_path):
    recording.write(tmp_path / "x", np.ones(4), sample_rate_hz=1e6)
    with pytest.raises(CastError, match="nothing is overwritten"):
        SigmfRecorder(gr.top_block(), blocks.null_source(8), tmp_path / "x", sample_rate_hz=1e6)
