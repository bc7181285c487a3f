# SPDX-License-Identifier: GPL-3.0-or-later
"""srsRAN's configuration files and logs. No srsRAN is here: files of its documented form, and iperf3 where it is installed."""

import configparser
import shutil
import subprocess
import time

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.core.processes import Processes
from gr_cast.experiments.cellular import stack, stack_run
from gr_cast.experiments.cellular.downlink import Cell
from gr_cast.experiments.cellular.stack_clock import Clock
from ports import free_port

RR = "cell_list =\n(\n  {\n    // rf_port = 0;\n    cell_id = 0x01;\n    tac = 0x0007;\n    pci = 1;\n  }\n);\n"
UE = """\
time;cc;earfcn;pci;rsrp;pl;cfo;pci_neigh;rsrp_neigh;cfo_neigh;dl_mcs;dl_snr;dl_turbo;dl_brate;dl_bler;ul_ta;distance_km;is_attached
16;0;4294967295;0;0.0;0.0;0.0;n/a;n/a;n/a;0.0;0.0;0.0;0.0;0.0;0.0;0.0;0.0
516;0;3350;1;0.0;0.0;0.0;n/a;n/a;n/a;0.0;0.0;0.0;0.0;0.0;0.0;0.0;0.0
516;0;3350;1;0.0;0.0;0.0;n/a;n/a;n/a;0.0;0.0;0.0;0.0;0.0;0.0;0.0;0.0
1000;0;3350;1;-71;62;0.37;n/a;n/a;n/a;27;23.5;0.5;4.98e+06;0;0;0.2;1.0
1000;1;3350;2;-71;62;0.37;n/a;n/a;n/a;3;2.5;0.5;1e+05;0;0;0.2;1.0
2000;0;3350;1;-75;66;0.37;n/a;n/a;n/a;20;18.0;0.5;5.02e+06;0;0;0.2;1.0
2500;0;3350;1;0.0;0.0;0.0;n/a;n/a;n/a;0.0;0.0;0.0;0.0;0.0;0.0;0.0;1.0
3000;0;3350;1;-75;66;0.37;n/a;n/a;n/a;20;1"""
ENB = "time;nof_ue;dl_brate;ul_brate\n0;0;0.0;0.0\n1;3;1.5e+07;2.2e+05\n2;3;1.4e+07;2.0e+05\n#eof\n"


@pytest.fixture
def templates(tmp_path):
    folder = tmp_path / "templates"
    folder.mkdir()
    for name in ("sib.conf", "rb.conf"):
        (folder / name).write_text(f"{name}\n")
    (folder / "rr.conf").write_text(RR)
    return folder


def test_every_radio_has_its_sockets_and_every_station_its_identity(templates, tmp_path):
    cells = [Cell(station="c10", terminals=("s1", "m1")), Cell(station="c25", terminals=("s5",))]
    members = stack.write_configuration(cells, 50, templates, tmp_path / "out", tmp_path / "s")
    assert [(m.node, m.program) for m in members] == [
        ("c10", "srsenb"), ("c25", "srsenb"), ("s1", "srsue"), ("m1", "srsue"), ("s5", "srsue"),
    ]  # fmt: skip
    assert len({address for m in members for address in (m.sends, m.receives)}) == 10
    seen = []
    for member in members:
        config = configparser.ConfigParser()
        config.read(member.config)
        assert f"tx_port={member.sends},rx_port={member.receives}" in config["rf"]["device_args"]
        assert "base_srate=11520000" in config["rf"]["device_args"]
        assert config["expert" if member.program == "srsenb" else "general"]["metrics_csv_filename"] == str(member.metrics)
        if member.program == "srsenb":
            seen.append((config["enb"]["enb_id"], config["enb"]["s1c_bind_addr"]))
    assert len(set(seen)) == 2
    assert "pci = 2;" in (tmp_path / "out/rr_c25.conf").read_text()
    assert "cell_id = 0x02;" in (tmp_path / "out/rr_c25.conf").read_text()
    assert (tmp_path / "out/rr_c10.conf").read_text() == RR
    users = [line.split(",") for line in (tmp_path / "out/user_db.csv").read_text().splitlines()]
    assert [user[-1] for user in users] == ["172.16.0.2", "172.16.0.3", "172.16.0.4"]
    assert all(len(user) == 10 and len(user[2]) == 15 for user in users)


def test_missing_or_strange_templates_are_named(templates, tmp_path):
    cells = [Cell(station="a", terminals=("b",))]
    (templates / "rr.conf").write_text("nothing\n")
    with pytest.raises(CastError, match="cell_id: not found"):
        stack.write_configuration(cells, 50, templates, tmp_path / "out", tmp_path)
    (templates / "sib.conf").unlink()
    with pytest.raises(CastError, match=r"sib\.conf: no such file"):
        stack.write_configuration(cells, 50, templates, tmp_path / "out", tmp_path)
    with pytest.raises(CastError, match="got 7"):
        stack.write_configuration(cells, 7, templates, tmp_path / "out", tmp_path)


def test_metrics_are_read_in_seconds_decibels_and_bits_while_the_terminal_hears_its_cell(tmp_path):
    (tmp_path / "ue.csv").write_text(UE)
    (tmp_path / "enb.csv").write_text(ENB)
    found = stack.read_terminal_metrics(tmp_path / "ue.csv")
    np.testing.assert_array_equal(found["sinr_db"].time_s, [1, 2])
    np.testing.assert_array_equal(found["sinr_db"].value, [23.5, 18])
    np.testing.assert_array_equal(found["dl_bps"].value, [4.98e6, 5.02e6])
    found = stack.read_station_metrics(tmp_path / "enb.csv")
    np.testing.assert_array_equal(found["dl_bps"].time_s, [0, 1, 2])
    np.testing.assert_array_equal(found["ul_bps"].value, [0, 2.2e5, 2e5])
    (tmp_path / "bad.csv").write_text("a;b\n1;2\n")
    with pytest.raises(CastError, match="no column time, dl_snr"):
        stack.read_terminal_metrics(tmp_path / "bad.csv")
    before = "".join(line for line in UE.splitlines(True) if not line.startswith(("1000", "2000", "2500")))
    (tmp_path / "never.csv").write_text(before)
    with pytest.raises(CastError, match="0 lines of metrics while it was attached, needs 2"):
        stack.read_terminal_metrics(tmp_path / "never.csv")
    with pytest.raises(CastError, match="wrote no metrics"):
        stack.read_station_metrics(tmp_path / "none.csv")


def test_a_line_of_metrics_is_laid_to_the_scenarios_time_at_which_it_came(tmp_path):
    """By a terminal that loses a twentieth of a second with each line, as srsUE does on a busy machine."""
    member = stack.Member(
        node="u", program="srsue", config=tmp_path / "u.conf", sends="", receives="", metrics=tmp_path / "u.csv"
    )
    clock = Clock([member])
    clock.look(0.0, 0.0)
    assert np.isnan(clock.scenario_s("u", [1.0])).all()  # no file yet
    lines = ["time;dl_snr"]
    for wall_s in np.arange(0.2, 60.0, 0.2):  # from 10 s on the scenario plays at a quarter of the wall's pace
        if len(lines) - 1 < int((wall_s - 3) / 1.05):  # a terminal that was started at 3 s
            lines.append(f"{1000 * len(lines)};20")
        member.metrics.write_text("\n".join(lines) + "\n2")  # the next is being written
        if not 30 < wall_s < 35:  # nobody looked
            clock.look(wall_s, max(wall_s - 10, 0) / 4)
    number = np.array([5, 10, 27, 50])
    assert clock.scenario_s("u", number) == pytest.approx(np.maximum(3 + 1.05 * number - 10, 0) / 4, abs=0.06)
    assert np.isnan(clock.scenario_s("u", [0.5, len(lines)])).all()
    clock = Clock([member])
    clock.look(60.0, 14.0)  # what is there already came nobody knows when
    member.metrics.write_text("time;dl_snr\n90000;20\n")
    clock.look(60.1, 14.2)
    # In the midst of both looks, and as old as a tenth of each subframe's is on average: the sum over k of 0.1 · 0.9^k · k ms.
    age_s = sum(0.1 * 0.9**k * k * 1e-3 for k in range(1000))
    assert clock.scenario_s("u", [90.0]) == pytest.approx(14.1 - age_s, abs=1e-9)


def test_a_file_of_the_real_iperf3_is_read(tmp_path):
    if shutil.which("iperf3") is None:
        pytest.skip("NO IPERF3: apt install iperf3")
    words = ["--udp", "--bitrate", "4M", "--time", "3", "--interval", "1", "--json", "--get-server-output"]
    port = str(free_port())
    with subprocess.Popen(["iperf3", "-s", "-1", "-p", port], stdout=subprocess.DEVNULL) as server:
        time.sleep(1)
        done = subprocess.run(
            ["iperf3", "--client", "127.0.0.1", "-p", port, *words], capture_output=True, timeout=60, check=False
        )
        server.terminate()
    (tmp_path / "udp.json").write_bytes(done.stdout)
    series = stack.read_iperf3(tmp_path / "udp.json")
    assert series.value.size >= 3
    assert series.value[:3].mean() == pytest.approx(4e6, rel=0.1)
    (tmp_path / "none.json").write_text('{"error": "unable to connect"}')
    with pytest.raises(CastError, match="unable to connect"):
        stack.read_iperf3(tmp_path / "none.json")
    (tmp_path / "cut.json").write_text('{"start": ')
    with pytest.raises(CastError, match="not JSON"):
        stack.read_iperf3(tmp_path / "cut.json")


def test_traffic_that_ends_between_two_looks_is_through(tmp_path, monkeypatch):
    plan = stack_run.Plan(members=[], folder=tmp_path, protocol="tcp", offered_bps=1e6, duration_s=0.5)
    with Processes(tmp_path) as processes:
        processes.start("iperf3 s1", ["true"])
        time.sleep(0.2)
        has_ended, answers = processes.has_ended, iter([False])
        monkeypatch.setattr(processes, "has_ended", lambda name: next(answers, True) and has_ended(name))
        stack_run._wait_for_traffic(plan, processes, ["iperf3 s1"], 0.0, lambda line: None)


def test_traffic_over_a_link_that_carries_nothing_any_more_ends_in_a_line(tmp_path, monkeypatch):
    monkeypatch.setattr(stack_run, "ANSWER_S", 0.5)
    plan = stack_run.Plan(members=[], folder=tmp_path, protocol="tcp", offered_bps=1e6, duration_s=0.5)
    with Processes(tmp_path) as processes:
        processes.start("iperf3 s1", ["true"])
        processes.start("iperf3 s2", ["sh", "-c", "echo connecting; exec sleep 20"])
        with pytest.raises(CastError) as told:
            stack_run._wait_for_traffic(plan, processes, ["iperf3 s1", "iperf3 s2"], 0.0, lambda line: None)
    assert told.value.faults == (
        "iperf3 s2: not through 0.5 s after its 0.5 s (connecting); what was recorded until then is kept",
    )
