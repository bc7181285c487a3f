# SPDX-License-Identifier: GPL-3.0-or-later
"""Any usual rate for any scenario: what is sounded is the scenario, wherever its taps lie between the samples."""

import json

import cast_emulator
import cast_sounder
import numpy as np
import pytest
from gr_cast.signals import recording

FOUR_S, FOUR_DB = [0, 1.28e-6, 2e-6, 4e-6], [-3, -20, -15, -8]


def sounded(folder, *arguments):
    cast_sounder.main([*arguments, "--output", str(folder / "sounded")])
    return json.loads((folder / "sounded/result.json").read_text())


@pytest.mark.parametrize("rate", ["20M", "30.72M", "61.44M"])
def test_the_four_taps_are_found_at_any_rate_and_nothing_else(tmp_path, rate):
    found = sounded(tmp_path, "run", "--rate", rate, "--code", "glfsr:10", "--frames", "20", "--noise", "-60")
    assert [tap["delay_s"] for tap in found["taps"]] == pytest.approx(FOUR_S, abs=1e-9)
    assert [tap["gain_db"] for tap in found["taps"]] == pytest.approx(FOUR_DB, abs=0.05)


def test_taps_within_one_sample_are_one_of_their_sum(tmp_path):
    """At 32 kS/s the four lie within an eighth of a sample: at the middle of the band they add as amplitudes."""
    found = sounded(tmp_path, "run", "--rate", "32k", "--code", "glfsr:8", "--frames", "5", "--noise", "-60")
    sum_db = 20 * np.log10(sum(10 ** (gain_db / 20) for gain_db in FOUR_DB))
    assert [tap["gain_db"] for tap in found["taps"]] == pytest.approx([sum_db], abs=0.1)


def test_an_emulated_recording_says_all_that_sounding_it_needs(tmp_path):
    """A code was on the air before the recording: from its first sample on every echo is there."""
    cast_emulator.main(["batch", "four_tap", "--transmit", "1=glfsr:9", "--rate", "50e6", "--duration", "1e-4",
                        "--noise-power-db", "-70", "--seed", "3", "--output", str(tmp_path / "air")])  # fmt: skip
    told = recording.read(tmp_path / "air/2")
    wanted = {"cast:scenario": "four_tap", "cast:transmitter": "1", "cast:receiver": "2", "cast:seed": 3,
              "cast:noise_power_db": pytest.approx(-70),
              "cast:waveform": {"code": "glfsr", "degree": 9, "samples_per_chip": 1}}  # fmt: skip
    assert wanted.items() <= told.metadata.items() and told.center_frequency_hz == 1e9 and len(told.samples) == 5000
    found = sounded(tmp_path, "process", str(tmp_path / "air/2"))
    assert [tap["delay_s"] for tap in found["taps"]] == pytest.approx(FOUR_S, abs=1e-10)


def test_two_transmitters_in_one_recording_are_both_named(tmp_path):
    """And the sounder asks which of them is to be sounded, with what to type."""
    cast_emulator.main(["batch", "1009", "--transmit", "1=glfsr:9", "--transmit", "2=gold:127", "--rate", "10M",
                        "--duration", "1e-4", "--receivers", "3", "--output", str(tmp_path)])  # fmt: skip
    sent = recording.read(tmp_path / "3").metadata["cast:transmitters"]
    assert {node: entry["code"] for node, entry in sent.items()} == {"1": "glfsr", "2": "gold"}
    with pytest.raises(
        Exception, match=r"1 \(glfsr:9\), 2 \(gold:127\) send at once: name the waveform to sound, such as --code"
    ):
        sounded(tmp_path, "process", str(tmp_path / "3"))
    assert sounded(tmp_path, "process", str(tmp_path / "3"), "--code", "glfsr:9")["taps"]


def test_a_code_without_a_rate_or_an_end_is_told_both(tmp_path):
    with pytest.raises(Exception, match=r"--rate: missing(.|\n)*--duration: missing"):
        cast_emulator.main(["batch", "four_tap", "--transmit", "1=glfsr:9", "--output", str(tmp_path / "air")])


def test_a_sounding_begins_at_the_time_that_is_asked_for(tmp_path):
    """A tap that falls by 10 dB a second, sounded at 1.5 s."""
    gains = ", ".join(str(-10 * k / 100) for k in range(201))
    (tmp_path / "falls.yaml").write_text(
        "cast_scenario: 1\nname: falls\nnodes: 2\n" + f"time_s: [{', '.join(str(k / 100) for k in range(201))}]\n"
        f'links: [{{tx: "1", rx: "2", taps: [{{delay_s: 0, gain_db: [{gains}]}}]}}]\n'
    )  # fmt: skip
    arguments = ("run", "--scenario", str(tmp_path / "falls.yaml"), "--rate", "1M", "--frames", "8", "--noise", "-60")
    assert sounded(tmp_path, *arguments, "--at", "1.5")["path_gain_db"] == pytest.approx(-15, abs=0.02)
    assert sounded(tmp_path, *arguments)["path_gain_db"] == pytest.approx(0, abs=0.02)
