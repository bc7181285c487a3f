# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator program: sample exact between GNU Radio peers that come and go, and obedient while it runs."""

import os
import random
import re
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import zmq
from gr_cast.emulation.reference import emulate, scenario_updates
from gr_cast.scenario import load
from gr_cast.signals import recording
from ports import free_address

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = str(ROOT / "apps" / "cast_emulator.py")

SCENARIO = """\
cast_scenario: 1
name: two nodes
nodes: [a, b]
links:
  - {tx: a, rx: b, taps: [{delay_s: 0.0, gain_db: 0.0}, {delay_s: 3.0e-6, gain_db: -6.0}]}
  - {tx: b, rx: a, taps: [{delay_s: 1.0e-6, gain_db: -3.0}]}
"""
RATE = 1e6

# A peer sends samples first, first+1, … (real part) without end, or writes what it receives to a file.
SENDER = """
import sys
from gnuradio import analog, blocks, gr, zeromq
first, address = int(sys.argv[1]), sys.argv[2]
top = gr.top_block()
ramp = blocks.vector_source_c([complex(first + k) for k in range(100_000)], False)
top.connect(ramp, zeromq.rep_sink(8, 1, address, 50, False, -1))
top.start()
top.wait()
"""
RECEIVER = """
import sys
from gnuradio import blocks, gr, zeromq
address, path, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
top = gr.top_block()
sink = blocks.file_sink(8, path, True)
sink.set_unbuffered(True)
top.connect(zeromq.req_source(8, 1, address, 50, False, -1), blocks.head(8, count), sink)
top.run()
"""


def start(*command) -> subprocess.Popen:
    environment = os.environ | {"PYTHONPATH": str(ROOT / "build" / "python")}
    return subprocess.Popen(list(map(str, command)), env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def end(*processes) -> None:
    for process in processes:
        process.kill()
        process.wait()
        process.stderr.close()


def received(path) -> np.ndarray:
    return np.fromfile(path, np.complex64) if path.exists() else np.empty(0, np.complex64)


def wait_for(holds, seconds=30.0):
    limit = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < limit, "nothing happened for too long"
        time.sleep(0.02)


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "two.yaml"
    path.write_text(SCENARIO)
    return path


def channel(x):
    return x + 10 ** (-6 / 20) * np.concatenate([np.zeros(3), x])[: len(x)]


def test_samples_pass_exactly_between_gnu_radio_peers(scenario, tmp_path):
    sent, heard = free_address(), free_address()
    emulator = start(PROGRAM, "run", scenario, "--rate", RATE, "--port", f"a:tx=zmq:{sent}", "--port", f"b:rx=zmq:{heard}")
    path = tmp_path / "heard"
    sender = start(sys.executable, "-c", SENDER, 1, sent)
    receiver = start(sys.executable, "-c", RECEIVER, heard, path, 50_000)
    try:
        assert receiver.wait(60) == 0
        got = received(path)
        expected = channel(np.arange(1, 50_001))
        assert len(got) == 50_000 and np.max(np.abs(got - expected)) < 1e-6 * np.max(expected)
    finally:
        end(emulator, sender, receiver)


def test_peers_that_are_killed_and_return_are_served_again(scenario, tmp_path):
    sent, heard = free_address(), free_address()
    emulator = start(PROGRAM, "run", scenario, "--rate", RATE, "--port", f"a:tx=zmq:{sent}", "--port", f"b:rx=zmq:{heard}")
    rng = random.Random(1)
    path = tmp_path / "heard"
    sender = receiver = None
    deaths = 1
    try:
        for turn in range(6):
            for _ in range(2):  # sometimes one, sometimes the other, sometimes both at once
                if sender is None or rng.random() < 0.5:
                    deaths += 1
                    if sender:
                        end(sender)
                    time.sleep(rng.uniform(0, 0.1))
                    sender = start(sys.executable, "-c", SENDER, 100_000 * (turn + 1), sent)
                if receiver is None or rng.random() < 0.5:
                    deaths += 1
                    if receiver:
                        end(receiver)
                    receiver = start(sys.executable, "-c", RECEIVER, heard, path, 10**9)
            before = len(received(path))
            wait_for(lambda before=before: len(received(path)) > before + 2000)
            end(sender)
            sender = None
        assert emulator.poll() is None
    finally:
        end(*(process for process in (emulator, sender, receiver) if process))
    # Every sample follows from the one before, but where a peer died: there the sample and its echo jump.
    steps = np.diff(received(path).real)
    usual = 1 + 10 ** (-6 / 20)
    assert np.count_nonzero(np.abs(steps - usual) > 0.5) <= 4 * deaths


def test_commands_are_obeyed_while_samples_flow(scenario, tmp_path):
    control = free_address()
    x = np.ones(200_000, np.complex64)
    recording.write(tmp_path / "x", x, sample_rate_hz=RATE)
    other = tmp_path / "other.yaml"
    other.write_text(SCENARIO.replace("two nodes", "other"))
    emulator = start(PROGRAM, "run", scenario, "--rate", RATE, "--control", control)
    socket_ = zmq.Context.instance().socket(zmq.REQ)
    socket_.setsockopt(zmq.LINGER, 0)
    socket_.connect(control)

    def ask(**command):
        socket_.send_json(command)
        assert socket_.poll(20_000)
        return socket_.recv_json()

    try:
        status = ask(command="status")["status"]
        assert status["scenario"] == "two nodes" and status["active_links"] == 2 and status["on"]
        assert ask(command="stop")["status"]["active_links"] == 0
        assert ask(command="start")["status"]["active_links"] == 2
        assert ask(command="set_link", tx="a", rx="b", enabled=False)["status"]["active_links"] == 1
        taps = [{"delay_s": 0, "gain_db": 0}, {"delay_s": 1e-6, "gain_db": -3, "phase_rad": 1}]
        assert ask(command="set_link", tx="b", rx="b", taps=taps)["status"]["active_taps"] == 2 + 1
        assert ask(command="load", scenario=str(other))["status"]["scenario"] == "other"
        for bad in (
            {},
            {"command": "explode"},
            {"command": "load", "scenario": "/nonexistent.yaml"},
            {"command": "load", "scenario": "four_tap"},
            {"command": "set_link", "tx": "a", "rx": "zz", "enabled": True},
            {"command": "set_link", "tx": "a", "rx": "b", "taps": [{"delay_s": "x", "gain_db": 0}]},
            {"command": "set_link", "tx": "a", "rx": "b", "taps": [{"delay_s": 1.0, "gain_db": 0}]},
            {"command": "status", "more": 1},
        ):
            answer = ask(**bad)
            assert not answer["ok"] and answer["errors"]
        assert ask(command="quit")["ok"]
        assert emulator.wait(20) == 0
    finally:
        socket_.close()
        end(emulator)


def test_no_socket_is_left_behind(scenario, tmp_path):
    here = {name: f"ipc://{tmp_path / name}" for name in ("control", "asked", "published")}
    ports = ["--port", f"b:rx=zmq:{here['asked']}", "--port", f"a:rx=pubsub:{here['published']}"]
    emulator = start(PROGRAM, "run", scenario, "--rate", RATE, *ports, "--control", here["control"])
    try:
        wait_for(lambda: all((tmp_path / name).exists() for name in here))
        quit_ = [PROGRAM, "ask", here["control"], '{"command": "quit"}']
        subprocess.run(quit_, check=True, stdout=subprocess.DEVNULL, timeout=60)
        assert emulator.wait(20) == 0
    finally:
        end(emulator)
    assert not any((tmp_path / name).exists() for name in here)


def test_a_guarded_emulator_obeys_only_who_has_its_key(scenario, tmp_path):
    control, key, other = free_address(), tmp_path / "key", tmp_path / "other"
    for file in (key, other):
        subprocess.run([PROGRAM, "key", str(file)], check=True)
    emulator = start(PROGRAM, "run", scenario, "--rate", RATE, "--control", control, "--control-key", key)

    def ask(*guard):
        command = [PROGRAM, "ask", control, '{"command": "quit"}', *map(str, guard)]
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    try:
        refused = ask("--control-key", other)
        assert refused.returncode == 2 and refused.stderr.count("\n") == 1 and "key is not this one" in refused.stderr
        assert ask("--control-key", key).returncode == 0
        assert emulator.wait(20) == 0 and "key" not in emulator.stderr.read().decode()
    finally:
        end(emulator)


def test_recordings_in_give_recordings_out(scenario, tmp_path):
    x = np.arange(1, 30_001).astype(np.complex64)
    recording.write(tmp_path / "x", x, sample_rate_hz=RATE)
    arguments = [
        "--rate",
        RATE,
        "--port",
        f"a:tx=file:{tmp_path / 'x'}",
        "--port",
        f"b:rx=file:{tmp_path / 'y'}",
    ]
    done = start(PROGRAM, "run", scenario, *arguments)
    assert done.wait(60) == 0, done.stderr.read()
    done.stderr.close()
    y = recording.read(tmp_path / "y")
    assert y.sample_rate_hz == RATE
    np.testing.assert_allclose(y.samples, channel(x), rtol=1e-5)


def test_a_scenario_that_moves_is_played_to_the_sample_however_fast_its_recording_runs(tmp_path):
    (tmp_path / "moving.yaml").write_text(
        "cast_scenario: 1\nname: moving\nnodes: [a, b]\nduration_s: 12\n"
        "links: [{tx: a, rx: b, taps: [{delay_s: 0.0, gain_db: 0.0, doppler_hz: 50.0}]}]\n"
    )
    rate_hz, update_samples = 1e5, 100
    recording.write(tmp_path / "x", np.ones(1_200_000, np.complex64), sample_rate_hz=rate_hz)
    ports = ["--port", f"a:tx=file:{tmp_path / 'x'}", "--port", f"b:rx=file:{tmp_path / 'y'}"]
    done = start(PROGRAM, "run", tmp_path / "moving.yaml", "--rate", rate_hz, *ports)
    assert done.wait(60) == 0, done.stderr.read()
    done.stderr.close()
    y = recording.read(tmp_path / "y").samples
    turns = np.repeat(np.exp(2j * np.pi * 50 * 1e-3 * np.arange(len(y) // update_samples)), update_samples)
    assert len(y) == 1_200_000
    np.testing.assert_allclose(y, turns, atol=1e-5)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--rate", "0"], "--rate"),
        (["--rate", "1e6", "--threads", "-1", "--seed", "-1"], "--seed: got -1"),
        (["--rate", "1e6", "--noise-power-db", "nan"], "needs -400 to 400 dB"),
        (["--rate", "1e6", "--control-key", "absent"], "no --control ADDRESS"),
        (["--rate", "1e6", "--control", "ipc://c", "--control-key", "absent"], "absent"),
        (["--rate", "1e6", "--port", "zz:tx=null"], "no such node"),
        (["--rate", "1e6", "--port", "a:tx=zmq:nowhere"], "tcp://"),
        (["--rate", "1e6", "--port", "a:tx=zmq:tcp://localhost:99999"], "65535"),
        (["--rate", "1e6", "--port", "a:tx=zmq:tcp://*:2000"], "port a:tx: address tcp://*:2000: Invalid argument"),
        (["--rate", "1e6", "--port", "b:rx=zmq:tcp://203.0.113.1:2000"], "Cannot assign requested address"),
        (["--rate", "1e6", "--port", "b:rx=pubsub:tcp://203.0.113.1:2000"], "Cannot assign requested address"),
        (["--rate", "1e6", "--port", "b:rx=zmq:ipc:///nonexistent/x"], "No such file or directory"),
        (["--rate", "1e6", "--port", "a:up=null"], "tx or rx"),
        (["--rate", "1e6", "--port", "a"], "NODE:tx=KIND:WHERE"),
        (["--rate", "1e6", "--port", "a:tx=tape:x"], "kind"),
        (["--rate", "1e6", "--port", "a:tx=file:/nonexistent"], "nonexistent"),
        (["--rate", "1e6", "--port", "a:tx=null", "--port", "a:tx=null"], "given twice"),
        (["--rate", "1e6", "--port", "a:tx=uhd:"], "--frequency"),
        (["--rate", "1e6", "--fixed-point", "99"], "limit 2 to 24"),
        (["--rate", "1e6", "--snr-db", "3", "--noise-power-db", "4"], "needs one of them"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(scenario, arguments, says):
    refused = subprocess.run([PROGRAM, "run", str(scenario), *arguments], capture_output=True, text=True, timeout=60)
    assert refused.returncode == 2 and says in refused.stderr
    assert all(line.startswith("error: ") for line in refused.stderr.splitlines())


@pytest.mark.parametrize("option", ["--port b:rx=zmq:{}", "--port b:rx=pubsub:{}", "--control {}"])
@pytest.mark.parametrize("transport", ["tcp", "ipc"])
def test_a_port_that_another_program_has_is_refused_in_one_line(scenario, tmp_path, option, transport):
    with socket.create_server(("127.0.0.1", 0)) as other, socket.socket(socket.AF_UNIX) as same:
        same.bind(str(tmp_path / "taken"))
        same.listen()
        address = {"tcp": f"tcp://127.0.0.1:{other.getsockname()[1]}", "ipc": f"ipc://{tmp_path / 'taken'}"}[transport]
        file = ["--port", f"a:rx=file:{tmp_path / 'y'}"]
        command = [PROGRAM, "run", str(scenario), "--rate", "1e6", *file, *option.format(address).split()]
        refused = subprocess.run(command, capture_output=True, text=True, timeout=60)
    place = "--control" if "control" in option else "port b:rx"
    assert (refused.returncode, refused.stderr) == (2, f"error: {place}: address {address}: Address already in use\n")
    assert not recording.meta_path(tmp_path / "y").exists()


def test_a_peer_that_has_gone_is_named_and_what_was_recorded_stays(scenario, tmp_path):
    sent, control = free_address(), free_address()
    ports = ["--port", f"a:tx=zmq:{sent}", "--port", f"b:rx=file:{tmp_path / 'y'}"]
    emulator = start(PROGRAM, "run", scenario, "--rate", RATE, *ports, "--control", control, "--report", "0.2")
    sender = start(sys.executable, "-c", SENDER, 1, sent)
    try:
        with zmq.Context() as context, context.socket(zmq.REQ) as remote:
            remote.linger = 0
            remote.connect(control)

            def waits_for() -> list[str]:
                remote.send_json({"command": "status"})
                assert remote.poll(20_000)
                status = remote.recv_json()["status"]
                assert not status["waiting_for"] or status["real_time_factor"] == 0
                return status["waiting_for"]

            recorded = recording.data_path(tmp_path / "y")
            wait_for(lambda: recorded.exists() and recorded.stat().st_size > 8 * 2000)
            sender.kill()
            wait_for(lambda: waits_for() == [f"a:tx={sent}"])
        emulator.send_signal(signal.SIGINT)
        _, told = emulator.communicate(timeout=30)
        assert emulator.returncode == 0 and f"waiting for a:tx={sent}" in told.decode()
        told_mb = float(re.search(r"stopped; sealing (\S+) MB of recordings", told.decode())[1])
        assert told_mb == pytest.approx(recording.data_path(tmp_path / "y").stat().st_size / 1e6, rel=0.01)
    finally:
        end(emulator, sender)
    y = recording.read(tmp_path / "y").samples
    assert len(y) > 2000
    np.testing.assert_allclose(y, channel(np.arange(1, len(y) + 1)), rtol=1e-5)


def batch(scenario, folder, tmp_path, *more):
    arguments = [
        "--transmit",
        f"a={tmp_path / 'xa'}",
        "--transmit",
        f"b={tmp_path / 'xb'}",
        "--output",
        folder,
    ]
    noise = ["--noise-power-db", "-20", "--seed", "5"]
    return [PROGRAM, "batch", str(scenario), *map(str, arguments), *noise, *more]


@pytest.fixture
def transmitted(tmp_path):
    rng = np.random.default_rng(1)
    for name, n in (("xa", 100_000), ("xb", 60_000)):
        x = rng.standard_normal(n) + 1j * rng.standard_normal(n)
        recording.write(tmp_path / name, x.astype(np.complex64), sample_rate_hz=RATE)


def test_batch_gives_the_same_whatever_the_workers_and_equals_the_reference(scenario, transmitted, tmp_path):
    for folder, more in (("one", ["--chunk", "7777"]), ("two", ["--chunk", "7777", "--workers", "2"])):
        subprocess.run(batch(scenario, tmp_path / folder, tmp_path, *more), check=True, timeout=120, capture_output=True)
    updates = scenario_updates(load(scenario), RATE)
    x = [np.pad(recording.read(tmp_path / name).samples, (0, pad)) for name, pad in (("xa", 0), ("xb", 40_000))]
    expected = emulate(x, updates, 2, noise_power=[0.01, 0.01], seed=5)
    for index, node in enumerate("ab"):
        one, two = (recording.read(tmp_path / folder / node).samples for folder in ("one", "two"))
        assert one.tobytes() == two.tobytes()
        assert np.max(np.abs(one - expected[index])) < 1e-5


def test_batch_on_a_cluster_gives_the_same(scenario, transmitted, tmp_path, dask_cluster, monkeypatch):
    monkeypatch.chdir(tmp_path)  # workers stand elsewhere: names relative to this folder must reach them whole
    subprocess.run(batch(scenario, "one", tmp_path), check=True, timeout=120, capture_output=True)
    for workers in (1, 2):
        more = ["--chunk", "7777", "--dask", dask_cluster(workers)]
        subprocess.run(batch(scenario, f"{workers}", tmp_path, *more), check=True, timeout=120, capture_output=True)
        for node in "ab":
            assert recording.data_path(f"{workers}/{node}").read_bytes() == recording.data_path(f"one/{node}").read_bytes()


def test_batch_that_is_killed_goes_on_where_it_was(scenario, transmitted, tmp_path):
    command = batch(scenario, tmp_path / "out", tmp_path, "--chunk", "2000")
    killed = start(*command)
    wait_for(lambda: len(list((tmp_path / "out" / ".batch").glob("*.done"))) >= 3)
    end(killed)
    done = len(list((tmp_path / "out" / ".batch").glob("*.done")))
    assert 3 <= done < 50 and not (tmp_path / "out" / "a.sigmf-meta").exists()
    again = subprocess.run(command, check=True, timeout=120, capture_output=True, text=True)
    assert f"chunks: {done} of 50" in again.stderr
    subprocess.run(batch(scenario, tmp_path / "whole", tmp_path, "--chunk", "2000"), check=True, capture_output=True)
    for node in "ab":
        assert (
            recording.read(tmp_path / "out" / node).samples.tobytes()
            == recording.read(tmp_path / "whole" / node).samples.tobytes()
        )
    assert not (tmp_path / "out" / ".batch").exists()


def test_batch_refuses_what_does_not_fit_before_any_work(scenario, transmitted, tmp_path):
    recording.write(tmp_path / "fast", np.ones(10, np.complex64), sample_rate_hz=2 * RATE)
    bad = [
        PROGRAM,
        "batch",
        str(scenario),
        "--output",
        str(tmp_path / "out"),
        "--transmit",
        f"a={tmp_path / 'xa'}",
    ]
    for more, says in (
        (["--transmit", f"b={tmp_path / 'fast'}"], "one for all"),
        (["--transmit", f"zz={tmp_path / 'xa'}"], "zz"),
        (["--transmit", f"b={tmp_path / 'absent'}"], "absent"),
        (["--receivers", "zz"], "zz"),
    ):
        refused = subprocess.run([*bad, *more], capture_output=True, text=True, timeout=60)
        assert refused.returncode == 2 and says in refused.stderr
    assert not (tmp_path / "out").exists()
