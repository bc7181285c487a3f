# SPDX-License-Identifier: GPL-3.0-or-later
"""The traffic program with real MGEN between namespaces, over a wire and over the emulated radio; what it refuses and keeps."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from gr_cast.comparing import series
from gr_cast.core.errors import CastError
from gr_cast.experiments.traffic import namespaces

PROGRAM = Path(__file__).resolve().parents[2] / "apps/cast_traffic.py"
POISSON = """\
cast_traffic: 1
duration_s: 4
flows:
  - {from: 1, to: 2, pattern: poisson, rate_pps: 50, size_bytes: 64}
"""


@pytest.fixture(scope="session")
def namespaces_allowed():
    if not any((Path(folder) / "mgen").exists() for folder in os.environ["PATH"].split(":")):
        pytest.skip("NO MGEN: apt install mgen")
    if os.geteuid() != 0:
        pytest.skip("NO RIGHTS: namespaces and TUN devices are tested as root")
    tried = subprocess.run(["unshare", "--net", "true"], capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"NO NETWORK NAMESPACES here: {tried.stderr.strip()}")


@pytest.fixture(scope="session")
def tun_allowed(namespaces_allowed):
    try:
        os.close(os.open("/dev/net/tun", os.O_RDWR))
    except OSError as error:
        pytest.skip(f"NO TUN DEVICES here: /dev/net/tun: {error.strerror}")


def run(*arguments, **options):
    command = [sys.executable, str(PROGRAM), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False, **options)


def figures(folder):
    return json.loads((folder / "traffic.json").read_text())


def test_packets_over_a_wire_all_arrive(tmp_path, namespaces_allowed):
    done = run("wire", "--output", tmp_path, "--duration", 3)
    assert done.returncode == 0, done.stderr
    rows = {row["flow"]: row for row in figures(tmp_path)["flows"]}
    assert all(row["loss"] == 0 and row["received"] == row["sent"] for row in rows.values())
    assert rows["periodic"]["sent"] == pytest.approx(60, abs=2)
    assert rows["poisson"]["sent"] == pytest.approx(150, abs=5 * np.sqrt(150))
    assert (tmp_path / "traffic.png").read_bytes().startswith(b"\x89PNG")
    arrived = series.read(tmp_path / "wire/throughput_bps_flow2.csv")
    assert arrived.value.mean() == pytest.approx(20 * 256 * 8, rel=0.1)


def test_a_poisson_flow_crosses_a_good_radio_whole_and_a_bad_one_not(tmp_path, tun_allowed):
    (tmp_path / "p.yaml").write_text(POISSON)
    done = run("radio", tmp_path / "p.yaml", "--output", tmp_path / "out", "--lower", 0, 12.5, 30)
    assert done.returncode == 0, done.stderr
    good, middling, bad = figures(tmp_path / "out")["flows"]
    assert good["sent"] == pytest.approx(200, abs=5 * np.sqrt(200))
    assert good["received"] == good["sent"]
    assert good["received"] / good["sent"] > middling["received"] / middling["sent"] > 0
    assert bad["received"] == 0
    assert figures(tmp_path / "out")["over"].startswith("802.11a")


def test_what_was_logged_before_mgen_died_is_kept(tmp_path, namespaces_allowed):
    with subprocess.Popen(
        [sys.executable, str(PROGRAM), "wire", "--output", str(tmp_path), "--duration", "60"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        receiver = tmp_path / "wire/2.log"
        end = time.monotonic() + 60
        while not (receiver.exists() and "RECV" in receiver.read_text()):
            assert time.monotonic() < end
            time.sleep(0.1)
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        mgen = [pid for pid in children if b"2.mgn" in Path(f"/proc/{pid}/cmdline").read_bytes()]
        os.kill(int(mgen[0]), signal.SIGKILL)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "error: mgen of node 2: ended after" in errors
    found = figures(tmp_path)
    assert found["complete"] is False
    assert found["flows"][0]["received"] > 0


def test_scripts_are_written_and_logs_read_without_rights(tmp_path):
    done = run("scripts", "--output", tmp_path)
    assert done.returncode == 0
    assert "POISSON [50 128]" in (tmp_path / "1.mgn").read_text()
    done = run("evaluate", "--logs", tmp_path, "--output", tmp_path)
    assert done.returncode == 2
    assert "1.log: no such file" in done.stderr


def test_a_machine_without_mgen_or_rights_is_told_so(tmp_path):
    done = run("wire", "--output", tmp_path / "out", env=os.environ | {"PATH": "/nowhere"})
    assert (done.returncode, done.stderr) == (2, "error: mgen: not installed (Debian: apt install mgen)\n")
    assert not (tmp_path / "out").exists()


def test_a_process_that_may_not_make_namespaces_is_told_so(tmp_path, namespaces_allowed):
    without = ["setpriv", "--bounding-set", "-sys_admin", "--inh-caps", "-sys_admin"]
    done = subprocess.run(
        [*without, sys.executable, str(PROGRAM), "wire", "--output", str(tmp_path / "out")],
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "needs root with CAP_SYS_ADMIN" in done.stderr


def test_a_missing_or_forbidden_tun_device_is_told(namespaces_allowed, monkeypatch, tmp_path):
    node = namespaces.Namespace("n", "10.45.0.1")
    try:
        monkeypatch.setattr(namespaces, "_TUN", str(tmp_path / "tun"))
        with pytest.raises(CastError, match="No such file or directory: modprobe tun"):
            node.open_tun()
        (tmp_path / "tun").touch()
        with pytest.raises(CastError, match="cannot make a device"):
            node.open_tun()
    finally:
        node.close()


@pytest.mark.parametrize(
    "arguments", [("wire", "nowhere.yaml"), ("radio", "--rate", "1e9"), ("radio", "--mode", "fast"), ("radio", "--lower", "nan"),
                  ("wire", "--duration", "-1"), ("radio", "--scenario", "nowhere")],
)  # fmt: skip
def test_bad_arguments_leave_a_line_and_nothing_written(tmp_path, arguments):
    done = run(*arguments, "--output", tmp_path / "out")
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert not (tmp_path / "out").exists()
