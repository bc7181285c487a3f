# SPDX-License-Identifier: GPL-3.0-or-later
"""What is written of a sounding says what was measured, with as many digits as it has."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.signals.recording import Recording
from gr_cast.sounding import result
from gr_cast.sounding.carrier import NO_OFFSET, CarrierOffset
from gr_cast.sounding.cir import Taps
from gr_cast.sounding.doppler import Doppler
from gr_cast.sounding.sound import LinkBudget, Sounding, SoundingOptions

RATE_HZ = 2e6
GAIN = np.array([[0.5j], [-0.1]])


def taps(gain=GAIN):
    return Taps(
        delay_samples=np.array([3.0, 10.5]), gain=gain, delay_std_samples=np.array([0.002, 0.04]),
        gain_std=np.array([1e-3, 2e-3]), phase_std_rad=np.array([2e-3, 0.02]), noise_variance=1e-4, smallest_power=1e-5,
    )  # fmt: skip


FRAMES = np.array([[0.5j, -0.1], [0.6j, -0.2], [0.4j, 0.1], [9.0, 9.0]])


def sounding(**changes):
    plain = Sounding(
        sample_rate_hz=RATE_HZ, taps=taps(), doppler=(Doppler(mean=1e-5, std=2e-7, spread=3e-6), None),
        offset=CarrierOffset(cycles_per_sample=1e-3, std_cycles_per_sample=1e-6, found=True, searched=0.01),
        noise_power=1e-4, period_samples=255, periods_per_frame=2, frame_time_s=np.arange(4) * 255e-6,
        frame_gain=FRAMES, frame_power=np.array([0.26, 0.4, -0.1, 1.0]), frame_detected=np.array([True, True, True, False]),
        response=np.zeros(255, complex), residual_response=np.zeros(255, complex), response_noise_power=1e-7, response_start=0,
        path_gain_db=-5.8, path_gain_std_db=0.03, tap_sum_db=-5.85, path_loss_db=35.8, smallest_path_gain_db=-50.0,
        residual_db=-30.0, gaps=((0.5, 7),), jumps=((0.25, -3),), warnings=("one", "two"),
    )  # fmt: skip
    return replace(plain, **changes)


def test_the_document_holds_every_number_in_seconds_hertz_and_decibels():
    told = result.as_document(sounding(), {"note": "x"})
    first, second = told["taps"]
    assert first == {
        "delay_s": 1.5e-6, "gain_db": pytest.approx(20 * np.log10(0.5)), "phase_rad": pytest.approx(np.pi / 2),
        "delay_std_s": pytest.approx(1e-9), "gain_std_db": pytest.approx(20 / np.log(10) * 1e-3 / 0.5), "phase_std_rad": 2e-3,
        "doppler_hz": pytest.approx(20.0), "doppler_std_hz": pytest.approx(0.4), "doppler_spread_hz": pytest.approx(6.0),
    }  # fmt: skip
    assert (second["delay_s"], second["phase_rad"]) == (5.25e-6, pytest.approx(np.pi))
    assert second["doppler_hz"] is second["doppler_std_hz"] is second["doppler_spread_hz"] is None
    plain = {
        "cast_sounding": 1, "note": "x", "sample_rate_hz": RATE_HZ, "period_samples": 255, "periods_per_frame": 2,
        "moving": False, "blocks": 1, "frames": 4, "frames_missing": 1, "path_gain_db": -5.8,
        "path_gain_std_db": 0.03, "tap_sum_db": -5.85,
        "path_loss_db": 35.8, "smallest_detectable_gain_db": -50.0, "noise_floor_db": pytest.approx(-40.0),
        "carrier_offset_hz": pytest.approx(2000.0), "carrier_offset_std_hz": pytest.approx(2.0), "carrier_offset_known": False,
        "residual_db": -30.0, "gaps": [{"time_s": 0.5, "lost_samples": 7}],
        "code_jumps": [{"time_s": 0.25, "later_samples": -3}], "warnings": ["one", "two"],
    }  # fmt: skip
    assert {key: told[key] for key in plain} == plain
    levels = 20 * np.log10([0.5, 0.6, 0.4]), 20 * np.log10([0.1, 0.2, 0.1])
    assert told["frame_std_db"] == {
        "strongest": pytest.approx(np.std(levels[0], ddof=1)), "weakest": pytest.approx(np.std(levels[1], ddof=1)),
    }  # fmt: skip
    json.dumps(told)


def test_what_was_not_found_is_null():
    told = result.as_document(sounding(offset=NO_OFFSET, noise_power=0.0), {})
    assert told["carrier_offset_hz"] is told["carrier_offset_std_hz"] is None and told["noise_floor_db"] == -300
    for detected in ([True, True, False, False], [False] * 4):
        assert result.as_document(sounding(frame_detected=np.array(detected)), {})["frame_std_db"] is None
    none = replace(taps(), **{name: np.empty(0) for name in ("delay_samples", "delay_std_samples", "gain_std", "phase_std_rad")},
                   gain=np.empty((0, 1)))  # fmt: skip
    silent = sounding(taps=none, frame_gain=np.empty((4, 0)), doppler=(), path_gain_db=None, frame_detected=np.ones(4, bool))
    assert result.as_document(silent, {})["taps"] == [] and result.as_document(silent, {})["frame_std_db"] is None
    assert "(none)" in result.as_table(result.as_document(silent, {}))


def test_a_gain_of_several_blocks_moves():
    told = result.as_document(sounding(taps=taps(np.array([[0.5j, 0.5], [0.1, 0.1j]]))), {})
    assert (told["moving"], told["blocks"]) == (True, 2)
    table = result.as_table(told).split("\n")
    assert table[0].split() == "delay (µs) gain (dB) phase (rad) Doppler (Hz)".split()
    assert table[1].endswith("20.00 ± 0.40, spread 6") and "Doppler" not in table[2]
    assert "channel               moves: sounded in 2 blocks, every tap with its Doppler" in table
    assert any(line.startswith("carrier offset") and "Doppler of the strongest path included" in line for line in table)
    steady = told | {"taps": [told["taps"][0] | {"doppler_spread_hz": 0.0}]}
    assert result.as_table(steady).split("\n")[1].endswith("20.00 ± 0.40")


def rows(document):
    return {line[:22].strip(): line[22:] for line in result.as_table(document).split("\n")}


def test_the_table_says_everything_with_its_error():
    told = result.as_document(sounding(), {})
    lines = result.as_table(told).split("\n")
    assert lines[0].split() == "delay (µs) gain (dB) phase (rad)".split()
    assert lines[1].split() == "1.5000 ± 0.0010 -6.021 ± 0.017 1.5708 ± 0.0020".split()
    assert lines[-2:] == ["warning: one", "warning: two"]
    assert rows(told) == rows(told) | {
        "path gain": "-5.800 ± 0.030 dB", "sum of |tap|²": "-5.85 dB", "path loss": "35.80 dB", "smallest gain seen": "-50.00 dB",
        "noise floor": "-40.00 dB of full scale per sample", "carrier offset": "2000.0 ± 2.0 Hz",
        "frames": "4, of which 1 missing",
    }  # fmt: skip
    assert "channel" not in rows(told)


def test_the_sum_of_taps_is_printed_where_it_is_another_figure():
    told = result.as_document(sounding(), {})
    assert "sum of |tap|²" not in rows(told | {"tap_sum_db": -5.801}) and "sum of |tap|²" in rows(told | {"tap_sum_db": -5.81})
    assert "sum of |tap|²" not in rows(told | {"path_gain_db": None})
    assert rows(told | {"path_gain_db": None, "path_gain_std_db": None})["path gain"] == "–"


def test_a_carrier_that_is_known_was_told_and_has_no_error():
    told = result.as_document(sounding(), {}) | {"carrier_offset_known": True}
    assert rows(told)["carrier offset"] == "2000.00 Hz, as told"
    assert rows(told | {"moving": True})["carrier offset"] == "2000.00 Hz, as told"
    gone = result.as_document(sounding(offset=NO_OFFSET), {}) | {"moving": True}
    assert rows(gone)["carrier offset"] == "–"


def test_flights_stand_in_the_place_of_delays_where_they_are_known():
    told = result.as_document(sounding(), {})
    flown = told | {"taps": [tap | {"time_of_flight_s": tap["delay_s"] - 1e-6} for tap in told["taps"]]}
    lines = result.as_table(flown).split("\n")
    assert lines[0].split()[:4] == "time of flight (µs)".split() and lines[1].split()[0] == "0.5000"
    unknown = told | {"taps": [tap | {"time_of_flight_s": None} for tap in told["taps"]]}
    assert result.as_table(unknown) == result.as_table(told)


def test_frames_are_lines_with_every_tap_and_empty_where_missing():
    head, *lines = csv.reader(io.StringIO(result.frames_csv(sounding())))
    assert head == ["time_s", "detected", "path_gain_db", "tap0_gain_db", "tap0_phase_rad", "tap1_gain_db", "tap1_phase_rad"]
    assert len(lines) == 4 and lines[3] == ["0.000765000", "0", "", "", "", "", ""]
    assert lines[1][:2] == ["0.000255000", "1"]
    wanted = [10 * np.log10(0.4), 20 * np.log10(0.6), np.pi / 2, 20 * np.log10(0.2), np.pi]
    assert [float(cell) for cell in lines[1][2:]] == pytest.approx(wanted, abs=1e-4)
    assert lines[2][2] == "nan"  # noise took more than there was
    gains = result.frame_gain_db(sounding())
    assert gains[:2] == pytest.approx(10 * np.log10([0.26, 0.4])) and np.isnan(gains[2:]).all()
    assert np.isnan(result.frame_gain_db(sounding(frame_power=np.zeros(4)))).all()  # no power is no level


def test_what_is_written_is_read_back_from_the_first_tap_on(tmp_path):
    folder = result.output_folder(tmp_path / "a" / "b")
    result.write_sounding(folder, sounding(), result.as_document(sounding(), {}))
    assert (folder / "frames.csv").read_text() == result.frames_csv(sounding())
    for path in (folder, folder / "result.json"):
        found, floor_db = result.read_taps(path)
        assert [tap["delay_s"] for tap in found] == pytest.approx([0, 3.75e-6]) and floor_db == pytest.approx(-40)
        assert [tap["gain_db"] for tap in found] == pytest.approx([20 * np.log10(0.5), -20])
        assert set(found[0]) == {"delay_s", "gain_db", "phase_rad"}
    with pytest.raises(CastError, match="output: is a file, needs a folder"):
        result.output_folder(folder / "result.json")
    assert result.output_folder(folder) == folder


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cast_sounding": 2}, "cast_sounding: got 2"),
        ({"taps": []}, "taps: got none: the sounding heard no signal"),
        ({"taps": [{"delay_s": 0.0, "gain_db": "x", "phase_rad": 0.0}]}, r"taps\[0\].gain_db"),
        ({"taps": [3]}, r"taps\[0\]"),
        ({"noise_floor_db": None}, "noise_floor_db: got null"),
    ],
)
def test_what_is_no_sounding_is_refused_with_its_place(tmp_path, changes, says):
    path = tmp_path / "result.json"
    path.write_text(json.dumps(result.as_document(sounding(), {}) | changes))
    with pytest.raises(CastError, match=says):
        result.read_taps(path)
    with pytest.raises(CastError, match="a sounding is a folder with a result.json"):
        result.read_taps(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("metadata", "name", "begins_s", "ends"),
    [
        ({}, "plain", 0.0, (None, None)),
        ({"cast:start_at_s": 7.0}, "tx1_rx2", 7.0, ("1", "2")),
        ({"cast:scenario_at_s": 3.0, "cast:start_at_s": 7.0}, "plain", 3.0, (None, None)),
        ({"cast:start_at_s": "soon", "cast:transmitter": "a", "cast:receiver": "b"}, "plain", 0.0, ("a", "b")),
    ],
)
def test_about_a_recording_its_link_beginning_band_and_set_up_are_told(metadata, name, begins_s, ends):
    file = Recording(samples=np.zeros(1, np.complex64), sample_rate_hz=100e6, metadata=metadata)
    budget = LinkBudget(tx_power_dbm=10, tx_gain_db=5, rx_gain_db=20, rx_full_scale_dbm=-10, base_loss_db=3)
    options = SoundingOptions(band=0.8, budget=budget)
    told = result.about_recording(file, name, {"samples_per_chip": 2}, options)
    assert told == {
        "transmitter": ends[0], "receiver": ends[1], "begins_s": begins_s, "band_hz": pytest.approx(40e6),
        "set_up_db": 10 + 5 - (-10 - 20) - 3,
    }  # fmt: skip
    plain = Recording(samples=np.zeros(1, np.complex64), sample_rate_hz=None)
    assert result.about_recording(plain, "x", {}, SoundingOptions())["band_hz"] == 0
    assert result.about_recording(file, "x", {}, SoundingOptions())["band_hz"] == 100e6
