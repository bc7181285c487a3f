# SPDX-License-Identifier: GPL-3.0-or-later
"""The CaST container's program finds a scenario's path losses over the emulator, and its image is the same every time."""

import hashlib
import io
import json
import os
import subprocess
import sys
import tarfile
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest
import zmq
from gr_cast import scenario as sc
from gr_cast.colosseum import build, check
from gr_cast.colosseum.emulator import Channel, Emulator
from gr_cast.colosseum.sounder import radio
from gr_cast.core.errors import CastError

ROOT = Path(__file__).resolve().parents[2]
BASE_LOSS_DB = 57.55


def test_three_nodes_find_path_and_base_loss_within_half_a_decibel():
    with tempfile.TemporaryDirectory(prefix="cb", dir="/tmp") as name:  # sockets have short names
        folder = Path(name)
        radios = {node: folder / f"r{node}" for node in (1, 2, 3)}
        for path in radios.values():
            path.mkdir()
        channel = Channel(rate_hz=50e6, base_loss_db=BASE_LOSS_DB, noise_power_db=-100)
        emulator = Emulator(ROOT / "apps/cast_emulator.py", folder / "emulator", radios, channel)
        nodes = []
        try:
            emulator.wait_until_ready()
            emulator.play(90003, {1: 1, 2: 4, 3: 2}, cycle=True)  # SRN to node
            nodes = [started(folder, node, radios[node]) for node in radios]
            columns = {node: column(folder, node, process) for node, process in zip(radios, nodes, strict=True)}
        finally:
            for process in nodes:
                process.kill()
                process.wait()
            emulator.stop()
    scenario, node_of = sc.load("90003"), {1: "1", 2: "4", 3: "2"}
    for rx, losses in columns.items():
        assert len(losses) == 2
        for tx, loss_db in losses.items():
            gain = scenario.links[node_of[int(tx)], node_of[rx]].gain[0]
            assert loss_db == pytest.approx(BASE_LOSS_DB - 10 * np.log10((np.abs(gain) ** 2).sum()), abs=0.5)


class Peer(threading.Thread):
    """A radio that sends one value for ever, and knows the power of what it heard last."""

    def __init__(self, place: Path, value: float):
        super().__init__(daemon=True)
        self.place, self.sent, self.power, self.ended = (
            place,
            np.full(4096, value, np.complex64).tobytes(),
            np.inf,
            threading.Event(),
        )

    def run(self):
        context = zmq.Context()
        reply, request = context.socket(zmq.REP), context.socket(zmq.REQ)
        reply.bind(f"ipc://{self.place}/tx")
        request.connect(f"ipc://{self.place}/rx")
        poller = zmq.Poller()
        poller.register(reply, zmq.POLLIN)
        poller.register(request, zmq.POLLIN)
        request.send(b"x")
        while not self.ended.wait(0.002):
            for one in dict(poller.poll(50)):
                data = one.recv()
                if one is request:
                    self.power = float(np.mean(np.abs(np.frombuffer(data, np.complex64)) ** 2))
                one.send(self.sent if one is reply else b"x")
        context.destroy(linger=0)

    def hears(self, low: float, high: float) -> bool:
        """Whether the power comes to lie there, and is there still after a while."""
        for _ in range(600):
            if low <= self.power <= high and not self.ended.wait(0.2) and low <= self.power <= high:
                return True
            self.ended.wait(0.02)
        return False


def test_nothing_passes_before_between_and_after_scenarios():
    with tempfile.TemporaryDirectory(prefix="cb", dir="/tmp") as name:
        folder = Path(name)
        peers = {1: Peer(folder / "r1", 1.0), 2: Peer(folder / "r2", 0.0)}
        for peer in peers.values():
            peer.place.mkdir()
        channel = Channel(rate_hz=1e6, base_loss_db=20, noise_power_db=-100)
        emulator = Emulator(ROOT / "apps/cast_emulator.py", folder / "emulator", {n: p.place for n, p in peers.items()}, channel)
        try:
            emulator.wait_until_ready()
            for peer in peers.values():
                peer.start()
            for _ in range(2):
                assert peers[2].hears(0.5e-10, 2e-10)  # noise alone
                emulator.play(1009, {1: 1, 2: 2}, cycle=True)
                assert peers[2].hears(0.0099, 0.0101)  # 0 dB less the base loss
                emulator.clear()
            assert peers[2].hears(0.5e-10, 2e-10)
            emulator.play(1009, {1: 1}, cycle=True)  # an SRN that no node of the map is joined to
            assert peers[2].hears(0.5e-10, 2e-10)
        finally:
            for peer in peers.values():
                peer.ended.set()
            emulator.stop()


def started(folder: Path, node: int, place: Path) -> subprocess.Popen:
    api = folder / f"api{node}"
    (api / "logs").mkdir(parents=True)
    (api / "radio.conf").write_text(json.dumps({"cast_sounder": 1, "nodes": 3, "node": node}))
    (api / "colosseum_config.ini").write_text(
        "[RF]\ncenter_frequency = 1000000000\nrf_bandwidth = 50000000\n[RADIO]\n"
        f"device_args = driver=zmq,tx_port=ipc://{place}/tx,rx_port=ipc://{place}/rx,base_srate=50e6\n"
    )
    (api / "start").touch()
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path), "CAST_RADIO_API": str(api), "CAST_LOGS": str(api / "logs"),
        "CAST_STATE": str(api / "state"), "OPENBLAS_NUM_THREADS": "1",
    }  # fmt: skip
    with open(api / "out", "wb") as out:
        return subprocess.Popen([sys.executable, "-m", "gr_cast.colosseum.sounder"], env=environment, stdout=out, stderr=out)


def test_without_a_configuration_it_says_in_a_line_how_one_comes_there(tmp_path):
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(sys.path),
        "CAST_RADIO_API": str(tmp_path),
        "CAST_LOGS": str(tmp_path),
        "CAST_STATE": str(tmp_path / "state"),
    }
    (tmp_path / "start").touch()
    words = [sys.executable, "-m", "gr_cast.colosseum.sounder"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=60)
    (line,) = done.stderr.splitlines()
    assert done.returncode == 1 and "radio.conf: no such file: a batch job brings it" in line and "up --config FILE" in line
    assert json.loads((tmp_path / "state").read_text()) == {"STATUS": "ERROR", "INFO": line}


def column(folder: Path, node: int, process: subprocess.Popen) -> dict:
    api, ended = folder / f"api{node}", threading.Event()
    for _ in range(1200):
        if (api / "logs" / "column.json").exists():
            break
        assert process.poll() is None, (api / "out").read_text()
        ended.wait(0.1)
    return json.loads((api / "logs" / "column.json").read_text())["path_loss_db"]


def test_a_node_sends_in_its_own_slot_alone_and_records_the_middle_of_the_others():
    period = np.arange(1, 8).astype(np.complex64)
    slots = radio.Slots(own=1, total=3, count=4000, guard=500, rate_hz=1e6, carrier_hz=1e9)
    sent = np.frombuffer(radio._sent(slots, period, 0), np.complex64)[:15000]
    assert (
        not sent[:5000].any() and not sent[10000:].any() and np.array_equal(sent[5000:10000], period[np.arange(5000, 10000) % 7])
    )
    heard = {0: np.zeros(4000, np.complex64), 2: np.zeros(4000, np.complex64)}
    stream, begin = np.arange(15000).astype(np.complex64), 0
    for size in (1, 4999, 3, 6000, 3997):
        radio._keep(slots, heard, begin, stream[begin : begin + size])
        begin += size
    assert np.array_equal(heard[0], stream[500:4500]) and np.array_equal(heard[2], stream[10500:14500])


def system(path: Path, order: int) -> Path:
    """A stand-in of Debian's packages, its files in one order or the other."""
    files = {"usr/bin/python3": b"p", "usr/bin/dash": b"d", "usr/lib/x86_64-linux-gnu/blas/libblas.so.3": b"b",
             "usr/include/stdio.h": b"h", "var/cache/apt/pkg": b"c", "usr/share/doc/x": b"x"}  # fmt: skip
    with tarfile.open(path, "w") as tar:
        for link, target in (("bin", "usr/bin"), ("sbin", "usr/sbin"), ("usr/bin/sh", "dash")):
            member = tarfile.TarInfo(f"./{link}")
            member.type, member.linkname = tarfile.SYMTYPE, target
            tar.addfile(member)
        for name, data in sorted(files.items())[::order]:
            member = tarfile.TarInfo(f"./{name}")
            member.size, member.mode, member.mtime = len(data), 0o755, 1000 + order
            tar.addfile(member, io.BytesIO(data))
    return path


def test_the_same_packages_and_sources_give_the_same_image_and_its_radio_api_has_no_fault(tmp_path):
    for order in (1, -1):
        build._write(tmp_path / f"i{order}.tar.gz", system(tmp_path / "s.tar", order), ["dash 1", "python3 3"])
    digests = {hashlib.sha256((tmp_path / f"i{order}.tar.gz").read_bytes()).hexdigest() for order in (1, -1)}
    assert len(digests) == 1
    assert check.faults_of(tmp_path / "i1.tar.gz") == []
    with tarfile.open(tmp_path / "i1.tar.gz") as tar:
        names = tar.getnames()
    assert "metadata.yaml" in names and "rootfs/opt/cast/gr_cast/colosseum/sounder/__main__.py" in names
    assert not any("include" in name or "var/cache" in name for name in names)


def test_an_image_without_debians_tools_is_one_clear_line(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CastError, match="mmdebstrap: not installed"):
        build.build(tmp_path / "x.tar.gz")
    assert list(tmp_path.iterdir()) == []
