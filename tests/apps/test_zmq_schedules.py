# SPDX-License-Identifier: GPL-3.0-or-later
"""ZeroMQ peers that are killed, return and hang in any order: never a deadlock, and not one wrong sample."""

import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent))
from zmq_peers import PERIOD, Peer, gnuradio, srsran

N_SCHEDULES = int(os.environ.get("CAST_SCHEDULES", 12))  # 200 and more by hand
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


@pytest.fixture
def emulated(tmp_path):
    """The running emulator and the peers at its two nodes. It must leave in peace in the end."""
    path, told = tmp_path / "crossed.yaml", tmp_path / "told"
    path.write_text(SCENARIO)
    at = {name: free_address() for name in ("a:tx", "a:rx", "b:tx", "b:rx")}
    ports = [part for name, address in at.items() for part in ("--port", f"{name}=zmq:{address}")]
    command = [ROOT / "apps" / "cast_emulator.py", "run", path, "--rate", "1e6", *ports]
    with told.open("wb") as errors:
        process = subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL, stderr=errors)
    peers = [Peer(node, at[f"{node}:tx"], at[f"{node}:rx"], tmp_path) for node in "ab"]
    try:
        yield process, *peers
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0 and "error" not in told.read_text(), told.read_text()
    finally:
        process.kill()
        process.wait()
        for peer in peers:
            peer.die()


def wait_for_samples(process, peers, n: int, seconds: float, what: str) -> None:
    """Until every peer has heard n more."""
    goals = [peer.n_heard() + n for peer in peers]
    limit = time.monotonic() + seconds
    while any(peer.n_heard() < goal for peer, goal in zip(peers, goals, strict=True)):
        assert process.poll() is None, f"{what}: the emulator ended with status {process.returncode}"
        assert time.monotonic() < limit, f"{what}: no samples within {seconds} s"
        time.sleep(0.001)


def check_heard(peer: Peer) -> None:
    """What a peer heard: in each of its lives one gapless stream, whatever became of the sender in the meantime."""
    last_life, last_index = 0, 0
    for heard in peer.heard_lives():
        if not len(heard):
            continue
        index, life = heard.real.astype(int), heard.imag.astype(int)
        same = np.diff(life) == 0
        assert np.all(np.diff(index)[same] % PERIOD == 1), "a sample was lost, repeated or out of order"
        assert np.all(np.diff(life)[~same] > 0) and np.all(index[1:][~same] == 0), "a sender's first samples were lost"
        # Its death loses what was on its way to the hearer, but repeats nothing.
        assert life[0] > last_life or (life[0] == last_life and 0 < (index[0] - last_index) % PERIOD < PERIOD // 2)
        last_life, last_index = life[-1], index[-1]


@pytest.mark.timeout(60 + 30 * N_SCHEDULES)
def test_no_deadlock_and_no_wrong_sample_in_random_schedules(emulated):
    process, *peers = emulated
    choose = random.Random(int(os.environ.get("CAST_SEED", 1)))
    for peer in peers:
        peer.live(choose.choice([gnuradio, srsran]))
    wait_for_samples(process, peers, 500, 60, "at first")
    for schedule in range(N_SCHEDULES):
        for peer in choose.choices(peers, k=choose.randint(1, 3)):
            if choose.random() < 0.1:
                peer.pause(0.05)
                continue
            peer.die()
            time.sleep(choose.choice([0, 0, 0.001, 0.02, 0.2]))
            peer.live(choose.choice([gnuradio, srsran]))
            time.sleep(choose.choice([0, 0, 0.01, 0.1]))
        wait_for_samples(process, peers, 500, 30, f"schedule {schedule}")
    for peer in peers:
        peer.die()
        check_heard(peer)


def test_stacks_in_lock_step_keep_each_other_going(emulated):
    process, *peers = emulated
    for peer in peers:
        peer.live(srsran, 100)  # fewer samples than any buffer holds: whoever waits for a full one waits for ever
    wait_for_samples(process, peers, 50_000, 60, "lock step")
    for peer in peers:
        peer.die()
        check_heard(peer)
