# SPDX-License-Identifier: GPL-3.0-or-later
"""The cellular program from the command line: what it writes, refuses, and keeps."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from gr_cast.comparing import series
from gr_cast.scenario import LinkTaps, Scenario, zarr_file

PROGRAM = Path(__file__).resolve().parents[2] / "apps/cast_cellular.py"


def run(*arguments, before=(), **options):
    command = [*before, sys.executable, str(PROGRAM), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False, **options)


def test_one_command_writes_table_picture_series_and_json(tmp_path):
    done = run("--output", tmp_path, "--duration", 1, "--blocks", 15)
    assert done.returncode == 0, done.stderr
    assert "modelled" in done.stdout
    assert (tmp_path / "cellular.png").read_bytes().startswith(b"\x89PNG")
    document = json.loads((tmp_path / "cellular.json").read_text())
    assert document["modelled"] is True
    assert document["complete"] is True
    assert {row["terminal"] for row in document["terminals"]} == {"s2", "s5", "m1"}
    assert len(document["similarity"]) == 9
    for name in document["series"]:
        assert series.read(name).value.size == 10


def test_by_default_standing_terminals_hold_what_the_papers_hold_and_the_walking_one_gains_as_it_passes(tmp_path):
    """The paper's figure: who stands holds 5 Mbit/s; the SINR of who walks rises and falls. Its ρ stand beside ours."""
    done = run("--output", tmp_path, "--step", 1.5)
    assert done.returncode == 0, done.stderr
    document = json.loads((tmp_path / "cellular.json").read_text())
    mean = {(row["run"], row["terminal"]): row["udp_bps_mean"] for row in document["terminals"]}
    assert min(mean[name, node] for name in ("place", "twin") for node in ("s2", "s5")) > 4.8e6
    walking_db = series.read(tmp_path / "place/sinr_db_m1.csv").value
    assert max(walking_db[0], walking_db[-1]) < walking_db.max() - 6 and 2 < walking_db.argmax() < 8
    assert document["similarity_in_the_paper"]["s5"] == {"sinr_db": 0.994, "udp_bps": 0.998, "tcp_bps": 0.998}
    (line,) = [line for line in done.stdout.splitlines() if line.split()[:2] == ["m1", "udp_bps"]]
    assert " 0.999 " in line


def test_by_default_two_stations_have_six_terminals_that_stand(tmp_path):
    done = run("--output", tmp_path, "--stations", 2, "--duration", 0.4, "--blocks", 6)
    assert done.returncode == 0, done.stderr
    cells = json.loads((tmp_path / "cellular.json").read_text())["cells"]
    assert [(cell["station"], len([name for name in cell["terminals"] if name[0] == "s"])) for cell in cells] == [
        ("c10", 3),
        ("c25", 3),
    ]
    assert "hold 5 ± 0.02 Mbit/s" in done.stdout


def test_a_scenario_of_the_catalogue_is_played_instead(tmp_path):
    done = run("--output", tmp_path, "--duration", 0.3, "--scenario", 1009, "--cells", "1:2,3", "--blocks", 6)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "series/sinr_db_2.csv").is_file()


def test_powers_and_noise_figures_of_a_spec_are_played_and_options_come_before_them(tmp_path):
    """By the link budget alone: SINR is power less loss less thermal noise less the noise figure."""
    link = LinkTaps(delay_s=[[0.0]], gain=[[1.0]])
    place = Scenario(name="p", nodes=("a", "b", "c"), links={("a", "b"): link, ("a", "c"): link}, base_loss_db=130.0)
    radios = {"a": {"power_dbm": 30.0}, "b": {"noise_figure_db": 3.0}, "c": {"noise_figure_db": 9.0}}
    zarr_file.write(tmp_path / "p.zarr", place, radios=radios)
    thermal_dbm = -174 + 10 * np.log10(15e3 * 128)  # over the samples of six blocks

    def sinr_db(*options):
        out = tmp_path / f"out{len(options)}"
        done = run(
            "--output", out, "--duration", 0.2, "--scenario", tmp_path / "p.zarr", "--cells", "a:b,c", "--blocks", 6, *options
        )
        assert done.returncode == 0, done.stderr
        document = json.loads((out / "cellular.json").read_text())
        return [row["sinr_db_mean"] for row in document["terminals"]], document["radio"], done.stderr

    of_spec, radio, told = sinr_db()
    occupied_db = 10 * np.log10(128 / 72)  # power goes into the occupied subcarriers alone
    assert of_spec == pytest.approx([30 - 130 - thermal_dbm - figure + occupied_db for figure in (3, 9)], abs=1.0)
    assert radio["noise_figure_db"] == {"b": 3.0, "c": 9.0} and radio["setup_loss_db"] == 0 and "the SPEC's" in told
    other, radio, _ = sinr_db("--tx-power-dbm", 24)
    assert np.array(other) - of_spec == pytest.approx(-6, abs=0.5) and radio["tx_power_dbm"] == 24


def test_a_terminal_out_of_reach_is_null_with_its_reason_and_the_rest_stays(tmp_path):
    link = "{{tx: '1', rx: '{}', base_loss_db: {}, taps: [{{delay_s: 0, gain_db: 0}}]}}"
    links = ", ".join(link.format(*about) for about in ((2, 60), (3, 400)))
    (tmp_path / "far.yaml").write_text(f"cast_scenario: 1\nnodes: 3\nlinks: [{links}]\n")
    done = run("--output", tmp_path, "--duration", 0.3, "--scenario", tmp_path / "far.yaml", "--cells", "1:2,3", "--blocks", 6)
    assert done.returncode == 0, done.stderr
    near, far = json.loads((tmp_path / "cellular.json").read_text())["terminals"]
    assert near["sinr_db_mean"] > 0 and near["reason"] is None
    assert far["sinr_db_mean"] is None and "3 of 3 instants" in far["reason"] and "3: nothing of its station" in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [("--cells", "99:1"), ("--scenario", "nowhere"), ("--blocks", "7"), ("--step", "0.5", "--duration", "0.1"),
     ("--offered", "nan"), ("--noise-figure-db", "nan")],
)  # fmt: skip
def test_bad_arguments_leave_a_line_and_nothing_written(tmp_path, arguments):
    done = run("--output", tmp_path / "out", *arguments)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert not (tmp_path / "out").exists()


def test_what_was_sounded_before_an_interrupt_stays(tmp_path):
    with subprocess.Popen(
        [sys.executable, str(PROGRAM), "--output", str(tmp_path), "--blocks", "6", "--full"],
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        end = time.monotonic() + 60
        while "s sounded" not in process.stderr.readline() and time.monotonic() < end:
            pass
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
    assert process.returncode == 130
    document = json.loads((tmp_path / "cellular.json").read_text())
    assert document["complete"] is False
    assert all(len(Path(name).read_text().splitlines()) >= 2 for name in document["series"])


STAND_INS = Path(__file__).resolve().parent / "stand_ins"
APART = ("unshare", "--net")  # the core's TUN device is no business of this machine's network


@pytest.fixture
def stand_ins(tmp_path):
    """Environment and arguments of a run with programs that speak as srsRAN's do, in the place of srsRAN."""
    missing = [program for program in ("iperf3", "mgen") if shutil.which(program) is None]
    if missing:
        pytest.skip(f"NO {' NOR '.join(missing).upper()}: apt install {' '.join(missing)}")
    try:
        os.close(os.open("/dev/net/tun", os.O_RDWR))
    except OSError as error:
        pytest.skip(f"NO TUN DEVICES here: /dev/net/tun: {error.strerror}")
    tried = subprocess.run(["unshare", "--net", "true"], capture_output=True, text=True, check=False)
    if os.geteuid() or tried.returncode:
        pytest.skip(f"NO NETWORK NAMESPACES here: not root, or {tried.stderr.strip()}")
    templates = tmp_path / "templates"
    templates.mkdir()
    for name in ("sib.conf", "rb.conf"):
        (templates / name).write_text("\n")
    (templates / "rr.conf").write_text("cell_list = ({\n cell_id = 0x01;\n pci = 1;\n})\n")
    scenario = tmp_path / "two.yaml"
    scenario.write_text(
        "cast_scenario: 1\nname: two\nnodes: [b, near, far]\nbase_loss_db: 40\nlinks:\n"
        "  - {tx: b, rx: near, taps: [{delay_s: 0, gain_db: 0}]}\n  - {tx: b, rx: far, taps: [{delay_s: 0, gain_db: -12}]}\n"
    )
    arguments = ["--stack", "srsran-4g", "--stack-config", str(templates), "--blocks", "6", "--noise-figure-db", "0"]
    arguments += ["--scenario", str(scenario), "--cells", "b:near,far", "--tx-power-dbm", "20"]
    return os.environ | {"PATH": f"{STAND_INS}:{os.environ['PATH']}"}, arguments


@pytest.mark.parametrize("protocol", ["udp", "tcp", "mgen"])
def test_a_stack_hears_the_emulated_channel_and_its_logs_become_series(tmp_path, stand_ins, protocol):
    """With the real iperf3 and the real MGEN, whose packets the stand-ins carry past the radio."""
    environment, arguments = stand_ins
    out = tmp_path / "out"
    done = run("--output", out, "--duration", 4, "--protocol", protocol, *arguments, before=APART, env=environment)
    assert done.returncode == 0, done.stderr
    assert not Path(".ctxt").exists() and (out / "stack/.ctxt").exists()  # what a terminal remembers stays beside its files
    document = json.loads((out / "cellular.json").read_text())
    assert document["modelled"] is False
    assert document["complete"] is True
    assert document["not_recorded"] == []
    assert document["real_time_factor"] > 0
    # A budget by hand: 20 dBm on six blocks, 57.55 dB of set-up and 40 dB of path, −174 dBm/Hz.
    near_db = 20 - 57.55 - 40 + 174 - 10 * np.log10(6 * 180e3)
    for row, wanted_db in zip(document["sinr"], (near_db, near_db - 12), strict=True):
        assert row["stack_db"] == pytest.approx(wanted_db, abs=0.3)
        assert row["model_db"] == pytest.approx(wanted_db, abs=0.3)
        assert np.nanmean(series.read(out / f"series/sinr_db_{row['terminal']}.csv").value) == pytest.approx(wanted_db, abs=0.3)
    assert document["power"]["b:tx"]["mean_db"] == pytest.approx(-15.23, abs=0.1)
    assert series.read(out / f"series/{protocol}_bps_far.csv").value.mean() == pytest.approx(5e6, rel=0.1)
    if protocol == "mgen":
        assert series.read(out / "series/loss_far.csv").value == pytest.approx(0)
        assert 0 < series.read(out / "series/latency_s_near.csv").value.mean() < 1
    assert (out / "cellular.png").is_file()


def test_a_terminal_that_fades_is_held_against_the_model_at_the_instants_that_it_heard(tmp_path, stand_ins):
    """Samples pass at a pace of their own, here and with the real stack, while metrics and traffic keep the wall's clock."""
    environment, arguments = stand_ins
    time_s = np.arange(0, 60.05, 0.1)
    fades = LinkTaps(delay_s=np.zeros((len(time_s), 1)), gain=10 ** (-0.5 * time_s[:, None] / 20))  # half a decibel per second
    stays = LinkTaps(delay_s=[[0.0]], gain=[[1.0]])
    links = {("b", "near"): stays, ("b", "far"): fades}
    place = Scenario(name="fading", nodes=("b", "near", "far"), links=links, time_s=time_s, base_loss_db=40)
    zarr_file.write(tmp_path / "fading.zarr", place)
    arguments[arguments.index("--scenario") + 1] = str(tmp_path / "fading.zarr")
    done = run("--output", tmp_path / "out", "--duration", 8, *arguments, before=APART, env=environment)
    assert done.returncode == 0, done.stderr
    for row in json.loads((tmp_path / "out/cellular.json").read_text())["sinr"]:
        assert row["stack_db"] == pytest.approx(row["model_db"], abs=0.3), done.stdout
        first_s, last_s = row["scenario_s"]
        assert last_s > first_s + 1
    last_db = series.read(tmp_path / "out/series/sinr_db_far.csv").value[-1]
    near_db = 20 - 57.55 - 40 + 174 - 10 * np.log10(6 * 180e3)
    assert last_s == pytest.approx((near_db - last_db) / 0.5, abs=1.5)  # the fading itself says when it was


def test_a_terminal_that_dies_ends_the_run_and_what_was_logged_stays(tmp_path, stand_ins):
    environment, arguments = stand_ins
    out = tmp_path / "out"
    command = [*APART, sys.executable, str(PROGRAM), "--output", str(out), "--duration", "60", *arguments]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment) as process:
        log, end = out / "stack/srsue_far.csv", time.monotonic() + 90
        while not (log.is_file() and len(log.read_text().splitlines()) > 9):
            assert time.monotonic() < end
            time.sleep(0.2)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        terminal = [pid for pid in children if b"srsue_near.conf" in Path(f"/proc/{pid}/cmdline").read_bytes()]
        os.kill(int(terminal[0]), signal.SIGKILL)
        _, errors = process.communicate(timeout=90)
    assert process.returncode == 2
    assert "error: srsue near: ended after" in errors
    assert json.loads((out / "cellular.json").read_text())["complete"] is False
    assert series.read(out / "series/sinr_db_far.csv").value.size >= 3


def test_an_interrupt_while_the_model_is_computed_keeps_what_the_stack_said(tmp_path, stand_ins):
    environment, arguments = stand_ins
    document = tmp_path / "out/cellular.json"
    command = [*APART, sys.executable, str(PROGRAM), "--output", str(document.parent), "--duration", "2", *arguments]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, env=environment) as process:
        end = time.monotonic() + 120
        while not document.is_file():  # until the stack is through: the model comes next, and the signal before it
            assert time.monotonic() < end
            time.sleep(0.001)
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=90)
    assert (process.returncode, errors.splitlines()[-1]) == (2, "error: interrupted before the model's SINR was there")
    kept = json.loads(document.read_text())
    assert kept["complete"] is False and kept["sinr"] == []
    assert {row["terminal"] for row in kept["means"]} == {"near", "far"}


def test_a_missing_stack_is_told_and_its_configuration_can_still_be_written(tmp_path, stand_ins):
    environment, arguments = stand_ins
    done = run("--output", tmp_path / "out", *arguments, env=environment | {"PATH": "/usr/sbin:/usr/bin"})
    if "srsenb" not in done.stderr:
        pytest.skip("srsRAN is installed here")
    assert done.returncode == 2
    assert "not installed" in done.stderr
    assert not (tmp_path / "out").exists()


def test_what_is_only_written_runs_as_it_lies(tmp_path, stand_ins):
    environment, arguments = stand_ins
    out = tmp_path / "out"
    done = run("--output", out, "--only-write", *arguments)
    assert done.returncode == 0, done.stderr
    assert f"bash {out / 'stack/run.sh'}" in done.stdout
    # Names of namespaces are the machine's own: they lie in a mount of this test alone.
    words = [
        "unshare",
        "--net",
        "--mount",
        "bash",
        "-c",
        f"mount -t tmpfs none /run && ip link set lo up && exec bash {out}/stack/run.sh",
    ]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=environment, start_new_session=True) as process:
        try:
            log, end = out / "stack/srsue_far.csv", time.monotonic() + 60
            while not (log.is_file() and len(log.read_text().splitlines()) > 9):
                assert time.monotonic() < end, {f.name: f.read_text()[-300:] for f in (out / "stack").glob("*.out")}
                time.sleep(0.2)
        finally:
            os.killpg(process.pid, signal.SIGTERM)
        assert "ping 172.16.0.1" in process.communicate(timeout=30)[0]


def test_who_does_not_attach_in_time_is_named_with_its_last_words(tmp_path, stand_ins):
    environment, arguments = stand_ins
    timed = ["--attach-timeout", "3"]
    done = run("--output", tmp_path / "out", *timed, *arguments, before=APART, env=environment | {"CAST_NEVER_ATTACH": "1"})
    assert done.returncode == 2
    assert [line for line in done.stderr.splitlines() if line.startswith("error: ")] == [
        f"error: {name}: not attached after 3 s (Attaching UE); see {tmp_path / 'out/stack'}" for name in ("near", "far")
    ]


def test_an_option_that_the_stack_does_not_know_is_told_in_its_own_words(tmp_path, stand_ins):
    environment, arguments = stand_ins
    programs = tmp_path / "programs"
    shutil.copytree(STAND_INS, programs)
    known = programs / "options/srsue.txt"
    known.write_text(known.read_text().replace("general.metrics_csv_enable\n", ""))
    environment["PATH"] = f"{programs}:{os.environ['PATH']}"
    done = run("--output", tmp_path / "out", *arguments, before=APART, env=environment)
    assert done.returncode == 2
    assert "with status 1 (unrecognised option 'general.metrics_csv_enable')" in done.stderr


def test_a_scenario_without_its_cells_is_told_a_line_that_can_be_typed(tmp_path):
    about = ("--output", tmp_path, "--scenario", "1009", "--duration", 0.2, "--blocks", 6)
    told = run(*about)
    assert told.returncode == 2 and (typed := re.search(r"1009: which nodes are stations\? .*(--cells 1:2,3,4)\n", told.stderr))
    assert run(*about, *typed[1].split()).returncode == 0
