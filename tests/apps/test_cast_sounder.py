# SPDX-License-Identifier: GPL-3.0-or-later
import json
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from gr_cast.scenario import load
from gr_cast.signals import codes, recording

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "apps" / "cast_sounder.py"


def sounder(*arguments, **environment):
    return subprocess.run(
        [PROGRAM, *map(str, arguments)], capture_output=True, text=True, timeout=120, env=os.environ | environment
    )


def done(*arguments, **environment):
    told = sounder(*arguments, **environment)
    assert told.returncode == 0, told.stderr
    return told.stdout


def air(code, delay, count, gain=0.5):
    return (gain * np.tile(np.roll(code, delay), count)).astype(np.complex64)


def test_the_default_run_sounds_the_four_taps_and_leaves_everything(tmp_path):
    shown = done("--output", tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    taps = load("four_tap").links[("1", "2")]
    assert [tap["delay_s"] for tap in result["taps"]] == pytest.approx(taps.delay_s[0], abs=1e-10)
    modelled_db = 20 * np.log10(np.abs(taps.gain[0]))
    assert [tap["gain_db"] for tap in result["taps"]] == pytest.approx(modelled_db, abs=0.05)
    assert {"delay_s", "gain_db", "phase_rad", "delay_std_s", "gain_std_db", "phase_std_rad"} <= set(result["taps"][0])
    assert {"path_loss_db", "noise_floor_db", "carrier_offset_hz", "frames", "warnings"} <= set(result)
    assert (result["frames"], result["frames_missing"]) == (1500, 0)
    assert result["warnings"] == [] and "warning" not in shown  # of its own defaults
    assert "SD of the weakest tap over the frames" in shown and "the paper: 0.17 dB" in shown
    assert (tmp_path / "out" / "cir.png").read_bytes().startswith(b"\x89PNG")
    assert len((tmp_path / "out" / "frames.csv").read_text().splitlines()) == 1501


def test_a_carrier_offset_leaves_no_taps_behind_and_no_channel_that_moves(tmp_path):
    shown = done("run", "--offset", "30e3", "--output", tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert len(result["taps"]) == 4 and not result["moving"] and "moves" not in shown
    assert result["carrier_offset_hz"] == pytest.approx(30e3, abs=5 * result["carrier_offset_std_hz"])


def test_what_a_car_turns_is_its_doppler_and_no_carrier_offset(tmp_path):
    taps = "{delay_s: 1.0e-6, gain_db: -70, doppler_hz: 110}, {delay_s: 3.0e-6, gain_db: -85, doppler_hz: -60}"
    (tmp_path / "car.yaml").write_text(f"cast_scenario: 1\nnodes: 2\nduration_s: 1\nall_links: {{taps: [{taps}]}}\n")
    done("run", "--scenario", tmp_path / "car.yaml", "--rate", "10e6", "--frames", 2000, "--output", tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert result["moving"] and result["carrier_offset_hz"] == 0 and result["carrier_offset_known"]
    assert [tap["delay_s"] for tap in result["taps"]] == pytest.approx([1e-6, 3e-6], abs=1e-9)
    assert [tap["doppler_hz"] for tap in result["taps"]] == pytest.approx([110, -60], abs=3)
    assert min(tap["gain_db"] for tap in result["taps"]) > result["smallest_detectable_gain_db"]


def test_a_recording_says_what_is_needed_to_redo_its_result(tmp_path):
    done("run", "--frames", 50, "--output", tmp_path / "one")
    again = done("process", tmp_path / "one" / "recordings" / "tx1_rx2", "--output", tmp_path / "two", "--average", 1)
    first, second = (json.loads((tmp_path / name / "result.json").read_text()) for name in ("one", "two"))
    assert first["taps"] == second["taps"], again
    meta = json.loads((tmp_path / "one" / "recordings" / "tx1_rx2.sigmf-meta").read_text())["global"]
    assert meta["cast:waveform"] == {"code": "glfsr", "degree": 9, "samples_per_chip": 1}
    assert meta["cast:scenario"] == "four_tap" and meta["cast:transmitter"] == "1" and "core:sha512" in meta


@pytest.mark.parametrize("raw_format", ["cf32", "ci16"])
def test_raw_samples_are_sounded_with_their_rate(tmp_path, raw_format):
    samples = air(codes.glfsr(8), 31, 40)
    recording.to_raw(samples, recording.RAW_FORMATS[raw_format]).tofile(tmp_path / "x.bin")
    done("process", tmp_path / "x.bin", "--format", raw_format, "--rate", "1e6", "--code", "glfsr:8", "--output", tmp_path / "o")
    (tap,) = json.loads((tmp_path / "o" / "result.json").read_text())["taps"]
    assert tap["delay_s"] == pytest.approx(31e-6, abs=1e-9)
    assert tap["gain_db"] == pytest.approx(20 * np.log10(0.5), abs=1e-3)


def test_a_rate_fills_in_for_metadata_without_one(tmp_path):
    recording.write(tmp_path / "x", air(codes.glfsr(8), 31, 40), sample_rate_hz=1e6)
    meta = json.loads((tmp_path / "x.sigmf-meta").read_text())
    del meta["global"]["core:sample_rate"]
    (tmp_path / "x.sigmf-meta").write_text(json.dumps(meta))
    assert "sample rate: missing" in sounder("process", tmp_path / "x", "--code", "glfsr:8", "--output", tmp_path / "o").stderr
    done("process", tmp_path / "x", "--code", "glfsr:8", "--rate", "2e6", "--output", tmp_path / "o")
    (tap,) = json.loads((tmp_path / "o" / "result.json").read_text())["taps"]
    assert tap["delay_s"] == pytest.approx(31 / 2e6, abs=1e-9)


def test_a_waveform_file_serves_as_the_code(tmp_path):
    recording.write(tmp_path / "wave", codes.zadoff_chu(139, 5), sample_rate_hz=1e6)
    recording.write(tmp_path / "heard", air(codes.zadoff_chu(139, 5), 17, 30), sample_rate_hz=1e6)
    done("process", tmp_path / "heard", "--code", f"file:{tmp_path / 'wave'}", "--output", tmp_path / "o")
    (tap,) = json.loads((tmp_path / "o" / "result.json").read_text())["taps"]
    assert tap["delay_s"] == pytest.approx(17e-6, abs=1e-9)


def test_calibrated_base_loss_comes_off_the_heat_map(tmp_path):
    """Ten nodes, 0 dB, each link behind a base loss of its own, as on Colosseum: 57.55 dB, SD 1.23 dB."""
    random = np.random.default_rng(2)
    nodes = [str(node) for node in range(1, 11)]
    losses = {(a, b): round(random.normal(57.55, 1.23), 3) for a in nodes for b in nodes if a != b}
    links = "\n".join(
        f"  - {{tx: {a}, rx: {b}, base_loss_db: {v}, taps: [{{delay_s: 0, gain_db: 0}}]}}" for (a, b), v in losses.items()
    )
    (tmp_path / "ten.yaml").write_text(f"cast_scenario: 1\nname: ten\nnodes: 10\nlinks:\n{links}\n")
    where = {"CAST_CALIBRATIONS": str(tmp_path / "store")}
    done("run", "--scenario", tmp_path / "ten.yaml", "--all-links", "--frames", 60, "--rate", "10e6", "--output", tmp_path / "a")
    heat = json.loads((tmp_path / "a" / "heatmap.json").read_text())
    for (a, b), loss in losses.items():
        assert heat["path_loss_db"][heat["nodes"].index(a)][heat["nodes"].index(b)] == pytest.approx(loss, abs=0.1)
    records = sorted((tmp_path / "a" / "recordings").glob("*.sigmf-meta"))
    assert len(records) == 90
    for version in (1, 2):
        assert f"v{version}.json" in done("calibrate", *records, "--name", "ten", "--output", tmp_path / "a", **where)
    done("heatmap", *records, "--base-loss", "ten@1", "--output", tmp_path / "b", **where)
    heat = json.loads((tmp_path / "b" / "heatmap.json").read_text())
    assert np.abs(np.array([v for row in heat["path_loss_db"] for v in row if v is not None])).max() < 0.1


def test_a_calibrated_delay_comes_off_where_both_ends_began_at_one_second(tmp_path):
    """A cable of 17 µs, and paths behind it; one of no length comes out 10 ns early: that is no path of a whole period."""
    code, where = codes.glfsr(8), {"CAST_CALIBRATIONS": str(tmp_path / "store")}
    late = np.exp(2j * np.pi * np.fft.fftfreq(len(code)) * 0.01)
    early = np.fft.ifft(np.fft.fft(code) * late)

    def heard(name, axis, code, delay):
        about = {"cast:transmitter": "a", "cast:receiver": "b", "cast:time_axis": axis, "cast:start_at_s": 1_800_000_000}
        recording.write(tmp_path / name, air(code, delay, 40), sample_rate_hz=1e6, fields=about)
        return tmp_path / name

    def flight(path, *more):
        shown = done("process", path, "--code", "glfsr:8", "--output", tmp_path / "o", *more, **where)
        result = json.loads((tmp_path / "o" / "result.json").read_text())
        (tap,) = result["taps"]
        assert ("time of flight" in shown) == (result["time_axis"] == "utc")
        return tap["time_of_flight_s"]

    for name, axis in (("cable", "utc"), ("other", "device")):
        shown = done("calibrate", heard(name, axis, code, 17), "--code", "glfsr:8", "--name", name, "--output", tmp_path, **where)
        assert ("base delay 17.0000 µs" in shown) == (axis == "utc")
    assert flight(heard("x", "utc", code, 29)) == pytest.approx(29e-6, abs=1e-9)
    assert flight(tmp_path / "x", "--base-loss", "cable") == pytest.approx(12e-6, abs=1e-9)
    assert flight(tmp_path / "x", "--base-loss", "other") == pytest.approx(29e-6, abs=1e-9)
    assert flight(heard("y", "utc", early, 17), "--base-loss", "cable") == pytest.approx(-10e-9, abs=1e-9)
    assert flight(heard("z", "device", code, 29), "--base-loss", "cable") is None


def test_codes_reproduces_the_papers_comparison(tmp_path):
    done("codes", "--output", tmp_path)
    rows = {row["name"]: row for row in json.loads((tmp_path / "codes.json").read_text())}
    for name, length in [("glfsr:8", 255), ("gold_paper", 255), ("ga128", 128), ("ls", 256), ("gold:511", 511)]:
        assert rows[name]["peak_spacing_s"] == pytest.approx(length / 1e6)
    for name in ("glfsr:8", "gold_paper", "ga128", "ls", "gold:127"):
        assert rows[name]["alone_sidelobe_db"] == pytest.approx(rows[name]["periodic_sidelobe_db"], abs=0.01)
    assert rows["ga128+gb128"]["alone_sidelobe_db"] is None  # none is no number


def test_a_foreign_python_first_on_the_path_does_not_matter(tmp_path):
    fake = tmp_path / "python3"
    fake.write_text("#!/bin/sh\nexit 77\n")
    fake.chmod(0o755)
    done("codes", "--output", tmp_path / "o", PATH=f"{tmp_path}:/usr/bin:/bin", PYTHONPATH="")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["process", "absent"], ["absent", "no such file"]),
        (["process", "x", "--code", "barker:13"], ["barker", "glfsr"]),
        (["process", "x", "--code", "glfsr:99"], ["degree", "99", "1 to 24"]),
        (["process", "x", "--code", "glfsr:eight"], ["integers"]),
        (["process", "x", "--code", "file:absent"], ["absent", "no such file"]),
        (["process", "x"], ["--code", "does not name its waveform"]),
        (["process", "x", "--code", "glfsr:8", "--rate", "2e6"], ["--rate", "2e+06", "1e+06"]),
        (["process", "x", "--code", "glfsr:8", "--base-loss", "nowhere"], ["no calibration", "nowhere"]),
        (["process", "x", "--code", "glfsr:8", "--base-loss", "nan"], ["base loss", "finite"]),
        (["process", "x", "--code", "glfsr:8", "--average", "-1"], ["average", "-1"]),
        (["process", "x", "--code", "glfsr:12"], ["no whole period"]),
        (["process", "x", "--code", "glfsr:8", "--false-alarm-rate", "0"], ["false alarm rate"]),
        (["process", "nan", "--code", "glfsr:8"], ["NaN", "index 7"]),
        (["process", "cut", "--code", "glfsr:8"], ["truncated"]),
        (["process", "empty.bin", "--format", "cf32", "--rate", "1e6", "--code", "glfsr:8"], ["no samples"]),
        (["process", "x.sigmf-data", "--format", "cf32", "--code", "glfsr:8"], ["SigMF"]),
        (["process", "empty.bin", "--format", "cf32", "--code", "glfsr:8"], ["--rate"]),
        (["run", "--scenario", "nowhere"], ["nowhere", "four_tap"]),
        (["run", "--scenario", "90002"], ["tap"]),
        (["run", "--link", "1>9"], ["1>9", "1>2"]),
        (["run", "--frames", "0"], ["--frames", "0"]),
        (["run", "--average", "-3"], ["average", "-3"]),
        (["run", "--max-spread", "nan"], ["max-spread", "nan"]),
        (["run", "--seed", "-1"], ["--seed", "-1"]),
        (["process", "x", "--code", "glfsr:1"], ["no bandwidth"]),
        (["heatmap", "x", "--code", "glfsr:8"], ["cast:transmitter"]),
        (["rx", "--rate", "-1"], ["rate", "-1"]),
        (["tx", "--frequency", "1Hz"], ["frequency", "10e6"]),
        (["tx", "--amplitude", "3"], ["--amplitude", "3"]),
        (["rx", "--duration", "1"], ["No devices found", "--args addr=192.168.40.2"]),
        (["rx", "--duration", "1", "--args", "192.0.2.1"], ["No devices found", "--args addr=192.0.2.1"]),
        (["tx", "--duration", "1"], ["No devices found"]),
        (["devices"], ["no USRP"]),
        (["bogus"], ["bogus"]),
    ],
)
def test_bad_input_is_one_clear_error_and_status_2(tmp_path, arguments, words):
    recording.write(tmp_path / "x", air(codes.glfsr(8), 3, 10), sample_rate_hz=1e6)
    bad = air(codes.glfsr(8), 3, 10)
    bad[7] = np.nan
    recording.write(tmp_path / "nan", bad, sample_rate_hz=1e6)
    recording.write(tmp_path / "cut", air(codes.glfsr(8), 3, 10), sample_rate_hz=1e6)
    recording.data_path(tmp_path / "cut").write_bytes(b"1234567")
    (tmp_path / "empty.bin").write_bytes(b"")
    told = subprocess.run(
        [PROGRAM, *arguments], capture_output=True, text=True, timeout=60, cwd=tmp_path,
        env=os.environ | {"XDG_DATA_HOME": str(tmp_path / "home")},
    )  # fmt: skip
    assert told.returncode == 2, told.stdout + told.stderr
    assert all(word in told.stderr for word in words), told.stderr
    assert "Traceback" not in told.stderr
    assert not list(tmp_path.rglob("result.json")), "nothing half-written"


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_is_killed_midway_leaves_a_readable_recording(tmp_path, how):
    running = subprocess.Popen(
        [PROGRAM, "run", "--frames", "100000000", "--output", tmp_path],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    data = tmp_path / "recordings" / "tx1_rx2.sigmf-data"
    deadline = time.monotonic() + 60
    while not (data.exists() and data.stat().st_size > 10_000_000):
        assert time.monotonic() < deadline and running.poll() is None
        time.sleep(0.02)
    running.send_signal(how)
    _, told = running.communicate(timeout=60)
    if how != signal.SIGKILL:
        assert running.returncode == 130 and "stopped early" in told
    read = recording.read(tmp_path / "recordings" / "tx1_rx2", count=511 * 1000)
    assert len(read.samples) == 511_000 and read.metadata["cast:scenario"] == "four_tap"


def test_noise_of_different_links_is_independent(tmp_path):
    """Of white noises of n samples no two correlate by more than a few 1/√n, whoever shares a transmitter or a receiver."""
    links = "all_links: {taps: [{delay_s: 0, gain_db: -100}]}"
    (tmp_path / "quiet.yaml").write_text(f"cast_scenario: 1\nname: quiet\nnodes: 3\nbase_loss_db: 100\n{links}\n")
    done("run", "--scenario", tmp_path / "quiet.yaml", "--all-links", "--frames", 20, "--rate", "1e6", "--output", tmp_path / "o")
    heard = [recording.read(path).samples for path in sorted((tmp_path / "o" / "recordings").glob("*.sigmf-meta"))]
    noise = np.array([(x - x.mean()) / np.linalg.norm(x - x.mean()) for x in heard])
    alike = np.abs(noise.conj() @ noise.T)
    assert len(heard) == 6 and alike[~np.eye(6, dtype=bool)].max() < 6 / np.sqrt(noise.shape[1])


def test_all_links_of_a_scenario_are_collected_into_one_campaign(tmp_path):
    taps = "all_links: {taps: [{delay_s: 0.2e-6, gain_db: -3}, {delay_s: 0.5e-6, gain_db: -9, phase_rad: 1}]}"
    (tmp_path / "three.yaml").write_text(f"cast_scenario: 1\nnodes: 3\nbase_loss_db: 50\n{taps}\n")
    about = ("--scenario", tmp_path / "three.yaml", "--all-links", "--frames", 20, "--rate", "50e6", "--output", tmp_path / "o")
    done("run", *about)
    results = sorted((tmp_path / "o" / "results").glob("*.json"))
    shown = done("collect", *results, "--output", tmp_path / "monday.npz", "--frequencies", 16)
    assert "6 links, 1 instants, 16 frequencies, 6 of 6 responses heard" in shown
    with np.load(tmp_path / "monday.npz") as made:
        f_hz = made["frequency_hz"]
        expected = 10 ** (-53 / 20) * np.exp(-2j * np.pi * f_hz * 0.2e-6)
        expected = expected + 10 ** (-59 / 20) * np.exp(1j - 2j * np.pi * f_hz * 0.5e-6)
        np.testing.assert_allclose(made["response"], np.broadcast_to(expected, (6, 1, 16)), atol=3e-5)
        assert np.ptp(f_hz) == pytest.approx(50e6 * 15 / 16) and (made["noise_power"] > 0).all()
    told = sounder("collect", results[0], results[0], tmp_path / "none", "--output", tmp_path / "bad.npz")
    assert told.returncode == 2 and len(told.stderr.splitlines()) == 1 and "none" in told.stderr
    assert not (tmp_path / "bad.npz").exists()
