# SPDX-License-Identifier: GPL-3.0-or-later
"""The program: table, pictures and JSON of every case; what was recorded stays; refusals."""

import json
import signal
import subprocess
import time
from pathlib import Path

import cast_jamming
import pytest
from gr_cast import scenario as sc
from gr_cast.comparing import series
from gr_cast.core.errors import CastError
from gr_cast.experiments import hall, left_out, loss

PROGRAM = Path(__file__).resolve().parents[2] / "apps" / "cast_jamming.py"
SMALL = ["--duration", "30", "--frames-per-second", "4", "--payload", "60"]


def jam(*arguments):
    return cast_jamming.main([str(argument) for argument in arguments])


def test_one_command_gives_table_pictures_and_json(tmp_path, capsys):
    cases = ["static-none", "static-wideband", "mobile-narrowband"]
    assert jam("run", *SMALL, *[a for case in cases for a in ("--case", case)], "--output", tmp_path) == 0
    document = json.loads((tmp_path / "jamming.json").read_text())
    assert document["complete"] and "gr-fec" in document["modem"]
    none, wide, mobile = document["cases"]
    assert [case["name"] for case in document["cases"]] == cases
    assert none["a"]["frames_delivered"] == none["a"]["frames"] == 120 and none["a"]["throughput_loss_percent"] is None
    assert wide["a"]["sinr_db"]["quiet"] == pytest.approx(26, abs=0.5)
    assert wide["a"]["sinr_db"]["jammed"] == pytest.approx(1, abs=0.5)
    assert wide["a"]["throughput_loss_percent"] > 90
    assert wide["a"]["interval_of_harm_s"] == pytest.approx([10, 20], abs=0.2)
    assert wide["similarity"]["sinr_db"]["rho"] > 0.99
    assert mobile["a"]["sinr_loss_db"] > 3 and mobile["paper"]["rho_sinr"] == 0.993
    for name in ("jamming.png", "spectrogram.png"):
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG"
    recorded = series.read(tmp_path / "static-wideband" / "a.csv", "sinr_db")
    assert recorded.value.size == 30 and recorded.value[15] < 2
    assert "the paper" in capsys.readouterr().out


def test_a_run_over_a_scenario_of_ones_own_takes_its_nodes(tmp_path):
    sc.save(tmp_path / "mine.yaml", hall.scenario("static", taps=4))
    nodes = ["--scenario", tmp_path / "mine.yaml", "--case", "scenario-narrowband"]
    assert jam("run", *SMALL, *nodes, "--output", tmp_path / "out") == 0
    (case,) = json.loads((tmp_path / "out" / "jamming.json").read_text())["cases"]
    assert case["a"]["sinr_db"]["jammed"] == pytest.approx(6, abs=0.7) and "similarity" not in case
    with pytest.raises(CastError, match="no link ap>rx"):
        jam("run", *SMALL, *nodes, "--nodes", "ap", "rx", "jammer", "--output", tmp_path / "none")


def test_what_was_computed_until_an_interrupt_stays(tmp_path):
    run = subprocess.Popen(
        [PROGRAM, "run", "--case", "static-none", "--frames-per-second", "100", "--output", tmp_path / "out"],
        stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    until = time.monotonic() + 60
    while time.monotonic() < until and "radio time" not in run.stderr.readline():
        pass
    time.sleep(3.0)  # for some frames; without a terminal the next line of progress comes after a minute
    run.send_signal(signal.SIGINT)
    out, _ = run.communicate(timeout=60)
    assert run.returncode == 130 and "interrupted" in out
    document = json.loads((tmp_path / "out" / "jamming.json").read_text())
    assert not document["complete"] and document["cases"][0]["a"]["frames"] >= 5
    frames = (tmp_path / "out" / "static-none" / "a-frames.csv").read_text().splitlines()
    assert len(frames) == 1 + document["cases"][0]["a"]["frames"]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["--modem", "gr-ieee802-11"], "gr-ieee802-11 cannot be loaded"),
        (["--mode", "64qam"], "mode: got '64qam'"),
        (["--case", "static-loud"], "--case: got 'static-loud'"),
        (["--case", "scenario-wideband"], "needs --scenario"),
        (["--case", "static-wideband", "--sinr", "30"], "a jammer adds power"),
        (["--payload", "2"], "--payload"),
        (["--frames-per-second", "5000"], "limit .* the saturated link"),
        (["--duration", "0"], "frames"),
        (["--scenario", "absent.yaml"], "absent.yaml"),
    ],
)
def test_what_cannot_be_done_is_refused_before_anything_is_written(arguments, words, tmp_path):
    with pytest.raises(CastError, match=words):
        jam("run", *arguments, "--output", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_sweep_gives_loss_and_measured_sinr_of_every_curve(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(loss, "SINR_DB", (-5.0, 30.0))
    assert jam("sweep", "--frames", 4, "--payload", 100, "--output", tmp_path) == 0
    document = json.loads((tmp_path / "sweep.json").read_text())
    assert len(document["points"]) == 2 * len(loss.CURVES) and document["largest_sinr_error_db"] < 1
    assert {point["loss"] for point in document["points"] if point["sinr_set_db"] == 30} == {0.0}
    assert (tmp_path / "sweep.png").read_bytes()[:4] == b"\x89PNG"
    assert "packet loss at SINR" in capsys.readouterr().out


def test_a_wall_left_out_is_hidden_from_similarity_and_named_by_the_diagnosis(tmp_path, monkeypatch):
    monkeypatch.setattr(left_out, "FRAME_BYTES", 200)
    assert jam("leave-out", "wall:north", "--duration", 24, "--output", tmp_path) == 0
    document = json.loads((tmp_path / "left_out.json").read_text())
    assert document["similarity"]["sinr_db"]["rho"] > 0.99
    assert document["verdict"] == "identified"
    (effect,) = document["effects"]
    assert (effect["family"], effect["owner"]["name"]) == ("extra_path", "tx>rx")
    whole, less = (hall.scenario("static", without=out).links[("tx", "rx")] for out in ((), ("north",)))
    (missing_s,) = set(whole.delay_s[0]) - set(less.delay_s[0])
    delay_s = effect["parameters"]["delay_s"]
    assert delay_s["value"] == pytest.approx(missing_s, abs=4 * delay_s["std"]) and delay_s["std"] < 1e-9


@pytest.mark.parametrize("what", ["roof", "wall:up", "wall"])
def test_what_cannot_be_left_out_is_refused(what, tmp_path):
    with pytest.raises(CastError, match="needs harmonic or wall:NAME with north"):
        jam("leave-out", what, "--output", tmp_path / "out")
    assert not (tmp_path / "out").exists()
