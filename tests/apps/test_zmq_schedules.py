# SPDX-License-Identifier: GPL-3.0-or-later
"""ZeroMQ peers that come, go and hang in any order: never a deadlock, and every sample follows from the one before."""

import os
import random
import socket
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import zmq

N_SCHEDULES = int(os.environ.get("CAST_SCHEDULES", 60))  # 200 and more by hand
ROOT = Path(__file__).resolve().parents[2]
SCENARIO = """\
cast_scenario: 1
name: crossed
nodes: [a, b]
links:
  - {tx: a, rx: b, taps: [{delay_s: 0.0, gain_db: 0.0}]}
  - {tx: b, rx: a, taps: [{delay_s: 0.0, gain_db: 0.0}]}
"""


def free_address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp://127.0.0.1:{probe.getsockname()[1]}"


class Peer:
    """A radio as srsRAN's: a REP socket that answers with its next samples, a REQ socket that asks for what it hears."""

    def __init__(self, sends_at: str, hears_at: str, seed: int):
        self.ahead: int | None = None  # in lock step: never sends further than so far beyond what it heard
        self.sends_at, self.hears_at = sends_at, hears_at
        self.random = random.Random(seed)
        self.sent = 0  # the next sample's value
        self.heard: list[np.ndarray] = []
        self.lives = 0
        self._stop = threading.Event()
        self._thread = None

    def live(self) -> None:
        self.lives += 1
        self._stop.clear()
        self._thread = threading.Thread(target=self._live, daemon=True)
        self._thread.start()

    def die(self) -> None:
        self._stop.set()
        self._thread.join(10)
        assert not self._thread.is_alive()

    def n_heard(self) -> int:
        return sum(map(len, self.heard))

    def _live(self) -> None:
        context = zmq.Context()
        reply, request = context.socket(zmq.REP), context.socket(zmq.REQ)
        for one in (reply, request):
            one.setsockopt(zmq.LINGER, 0)
        while True:
            try:
                reply.bind(self.sends_at)
                break
            except zmq.ZMQError:  # the dead one's port is not free yet
                time.sleep(0.01)
        request.connect(self.hears_at)
        request.send(b"\xff")
        asked = False
        poller = zmq.Poller()
        poller.register(reply, zmq.POLLIN)
        poller.register(request, zmq.POLLIN)
        while not self._stop.is_set():
            ready = dict(poller.poll(5))
            if reply in ready:
                reply.recv()
                asked = True
            if asked and (self.ahead is None or self.sent < self.n_heard() + self.ahead):
                asked = False
                n = self.random.choice([1, 7, 300, 2000])
                reply.send(np.arange(self.sent, self.sent + n, dtype=np.complex64).tobytes())
                self.sent = (self.sent + n) % 2**20
            if request in ready:
                self.heard.append(np.frombuffer(request.recv(), np.complex64).real)
                if self.random.random() < 0.02:
                    time.sleep(0.005)
                request.send(b"\xff")
        context.destroy(linger=0)


@pytest.fixture
def emulated(tmp_path):
    path = tmp_path / "crossed.yaml"
    path.write_text(SCENARIO)
    at = {name: free_address() for name in ("a:tx", "a:rx", "b:tx", "b:rx")}
    ports = [part for name, address in at.items() for part in ("--port", f"{name}=zmq:{address}")]
    command = [ROOT / "apps" / "cast_emulator.py", "run", path, "--rate", "1e6", *ports]
    process = subprocess.Popen(
        list(map(str, command)), env=dict(os.environ), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    yield process, Peer(at["a:tx"], at["a:rx"], 1), Peer(at["b:tx"], at["b:rx"], 2)
    process.kill()
    process.wait()


@pytest.mark.xfail(strict=False, reason="OPEN FAULT: the emulator aborts in about one of 60 schedules of kills and restarts")
def test_no_deadlock_and_no_wrong_sample_in_random_schedules(emulated):
    process, *peers = emulated
    choose = random.Random(3)
    for peer in peers:
        peer.live()
    for schedule in range(N_SCHEDULES):
        for _ in range(choose.randint(1, 3)):
            peer = choose.choice(peers)
            peer.die()
            time.sleep(choose.choice([0, 0, 0.001, 0.02]))
            peer.live()
        before = [peer.n_heard() for peer in peers]
        limit = time.monotonic() + 20
        while any(peer.n_heard() < n + 500 for peer, n in zip(peers, before, strict=True)):
            assert time.monotonic() < limit and process.poll() is None, f"schedule {schedule}: no samples"
            time.sleep(0.001)
    for peer in peers:
        peer.die()
    deaths = sum(peer.lives for peer in peers)
    for peer in peers:
        steps = np.diff(np.concatenate(peer.heard))
        turns = np.count_nonzero(steps == 1 - 2**20)
        # A death loses what was on its way, once at either end; nothing is ever repeated or out of order.
        assert np.count_nonzero(steps != 1) - turns <= 2 * deaths
        lost = steps[(steps != 1) & (steps != 1 - 2**20)]
        assert np.all((lost > 0) | (lost < -(2**19)))


def test_stacks_in_lock_step_keep_each_other_going(emulated):
    process, *peers = emulated
    for peer in peers:
        peer.ahead = 100  # fewer samples than any buffer holds: whoever waits for a full one waits for ever
        peer.live()
    limit = time.monotonic() + 60
    while any(peer.n_heard() < 50_000 for peer in peers):
        assert time.monotonic() < limit and process.poll() is None
        time.sleep(0.01)
    for peer in peers:
        peer.die()
        assert np.all(np.diff(np.concatenate(peer.heard)) == 1)
