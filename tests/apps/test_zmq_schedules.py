# SPDX-License-Identifier: GPL-3.0-or-later
"""ZeroMQ peers that are killed, return and hang in any order, and commands meanwhile: not one wrong sample, no deadlock."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zmq

sys.path.insert(0, str(Path(__file__).resolve().parent))
from ports import free_address
from zmq_peers import PERIOD, Peer, gnuradio, gnuradio_pubsub, srsran

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


@contextlib.contextmanager
def emulated(folder: Path, kind: str = "zmq", *more: str):
    """The running emulator and the peers at its two nodes. It must leave in peace in the end."""
    path, told = folder / "crossed.yaml", folder / "told"
    path.write_text(SCENARIO)
    at = {name: free_address() for name in ("a:tx", "a:rx")}
    at |= {name: f"ipc://{folder}/{name}" for name in ("b:tx", "b:rx")}
    ports = [part for name, address in at.items() for part in ("--port", f"{name}={kind}:{address}")]
    command = [ROOT / "apps" / "cast_emulator.py", "run", path, "--rate", "1e6", *ports, *more]
    with told.open("wb") as errors:
        process = subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL, stderr=errors)
    peers = [Peer(node, at[f"{node}:tx"], at[f"{node}:rx"], folder) for node in "ab"]
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


def play_schedules(process, peers, kinds, n_schedules: int) -> None:
    """Peers are killed and return, or hang for a while; after each schedule all of them hear something again."""
    choose = random.Random(int(os.environ.get("CAST_SEED", 1)))
    for peer in peers:
        peer.live(choose.choice(kinds))
    wait_for_samples(process, peers, 500, 60, "at first")
    for schedule in range(n_schedules):
        for peer in choose.choices(peers, k=choose.randint(1, 3)):
            if choose.random() < 0.1:
                peer.pause(0.05)
                continue
            peer.die()
            time.sleep(choose.choice([0, 0, 0.001, 0.02, 0.2]))
            peer.live(choose.choice(kinds))
            time.sleep(choose.choice([0, 0, 0.01, 0.1]))
        wait_for_samples(process, peers, 500, 30, f"schedule {schedule}")
    for peer in peers:
        peer.die()


@pytest.mark.timeout(60 + 30 * N_SCHEDULES)
def test_no_deadlock_and_no_wrong_sample_in_random_schedules(tmp_path):
    with emulated(tmp_path) as (process, *peers):
        play_schedules(process, peers, [gnuradio, srsran], N_SCHEDULES)
        for peer in peers:
            check_heard(peer)


def test_publishers_and_subscribers_that_return_are_heard_again(tmp_path):
    with emulated(tmp_path, "pubsub") as (process, *peers):
        play_schedules(process, peers, [gnuradio_pubsub], 4)
        for peer in peers:
            for heard in filter(len, peer.heard_lives()):
                index, life = heard.real.astype(int), heard.imag.astype(int)
                assert np.all(np.diff(life) >= 0)
                steps = np.diff(index)[np.diff(life) == 0] % PERIOD
                # Nobody waits for a subscriber: samples may be missing, never come twice or out of order.
                assert np.all((0 < steps) & (steps < PERIOD // 2))


def test_stacks_in_lock_step_keep_each_other_going(tmp_path):
    with emulated(tmp_path) as (process, *peers):
        for peer in peers:
            peer.live(srsran, 100)  # fewer samples than any buffer holds: whoever waits for a full one waits for ever
        wait_for_samples(process, peers, 50_000, 60, "lock step")
        for peer in peers:
            peer.die()
            check_heard(peer)


def test_links_obey_commands_to_the_sample_while_peers_stream(tmp_path):
    """A state holds at least from the sample count that its command's answer tells to the one told before the next."""
    other, empty = tmp_path / "other.yaml", tmp_path / "empty.yaml"
    other.write_text(SCENARIO.replace("gain_db: 0.0", "gain_db: -12"))
    empty.write_text(SCENARIO[: SCENARIO.index("links:")] + "links: []\n")
    half = [{"delay_s": 0, "gain_db": -6}]
    steps = [  # command, gain of a>b, gain of b>a, both in dB
        ({"command": "status"}, 0, 0),
        ({"command": "stop"}, None, None),
        ({"command": "start"}, 0, 0),
        ({"command": "set_link", "tx": "a", "rx": "b", "enabled": False}, None, 0),
        ({"command": "set_link", "tx": "b", "rx": "a", "taps": half}, None, -6),
        ({"command": "set_link", "tx": "a", "rx": "b", "enabled": True}, 0, -6),
        ({"command": "set_link", "tx": "a", "rx": "b", "taps": []}, None, -6),
        ({"command": "load", "scenario": str(other)}, -12, -12),
        ({"command": "load", "scenario": str(empty)}, None, None),
    ]
    control = free_address()
    with emulated(tmp_path, "zmq", "--control", control) as (process, *peers), zmq.Context() as context:
        with context.socket(zmq.REQ) as remote:
            remote.linger = 0
            remote.connect(control)

            def ask(command) -> int:
                remote.send_json(command)
                assert remote.poll(30_000), command
                answer = remote.recv_json()
                assert answer["ok"], answer
                return answer["status"]["samples"]

            for peer, kind in zip(peers, (gnuradio, srsran), strict=True):
                peer.live(kind)
            wait_for_samples(process, peers, 500, 60, "at first")
            spans = []
            for command, *gains in steps:
                begin = end = ask(command)
                limit = time.monotonic() + 30
                while end < begin + 20_000:
                    assert time.monotonic() < limit, command
                    end = ask({"command": "status"})
                spans.append((begin, end, gains))
            wait_for_samples(process, peers, end - min(peer.n_heard() for peer in peers), 30, "at last")
        for peer in peers:
            peer.die()
        (a_heard,), (b_heard,) = (peer.heard_lives() for peer in peers)
    for begin, end, (a_to_b_db, b_to_a_db) in spans:
        for heard, gain_db in ((b_heard, a_to_b_db), (a_heard, b_to_a_db)):
            gain = 0 if gain_db is None else 10 ** (gain_db / 20)
            n = np.arange(begin, end)
            np.testing.assert_allclose(heard[n], gain * (n % PERIOD + 1j), rtol=1e-6)
