# SPDX-License-Identifier: GPL-3.0-or-later
"""Any request to a running emulator gets one answer; what is refused changes nothing."""

import contextlib
import dataclasses
import json
import os
import random
import select
import socket
import subprocess
import sys
import threading
from pathlib import Path

import gr_cast
import pytest
import zmq
from gr_cast import scenario as sc
from gr_cast.blocks import control
from gr_cast.blocks.cast_python import emulator_kernel
from gr_cast.blocks.emulation import Emulation
from gr_cast.core import keys
from gr_cast.core.errors import CastError

RATE_HZ = 1e6
SCENARIO = "cast_scenario: 1\nnodes: [a, b]\nlinks:\n  - {tx: a, rx: b, taps: [{delay_s: 0.0, gain_db: %s}]}\n"


@pytest.fixture
def asked(tmp_path):
    """ask(*parts): the answer of an emulation to a request of these parts."""
    (tmp_path / "two.yaml").write_text(SCENARIO % -3)
    emulation = Emulation(sc.load(tmp_path / "two.yaml"), [], RATE_HZ)
    address = f"ipc://{tmp_path}/control"
    client = zmq.Context.instance().socket(zmq.REQ)
    client.setsockopt(zmq.LINGER, 0)
    client.connect(address)

    def ask(*parts: bytes):
        client.send_multipart(parts)
        assert client.poll(20_000), f"no answer to {parts}"
        return client.recv_json()

    with control.ControlServer(address) as server, server.obeying(emulation, threading.Event()):
        yield ask
    client.close()


def said(ask, **command):
    return ask(json.dumps(command).encode())


TAP = {"command": "set_link", "tx": "a", "rx": "b"}


@pytest.mark.parametrize(
    "parts",
    [
        [b""],
        [b"null"],
        [b"[1]"],
        [b'{"command": []}'],
        [b'{"command": {}}'],
        [b"[" * 100_000],
        [b'{"command": "status"}', b"and more"],
        [b"\xff\xfe"],
        [json.dumps({**TAP, "taps": [{"delay_s": 0, "gain_db": 10_000}]}).encode()],
        [json.dumps({**TAP, "taps": [{"delay_s": 1e8, "gain_db": 0}]}).encode()],
        [json.dumps({**TAP, "taps": [{"delay_s": 0, "gain_db": 0, "phase_rad": 10**400}]}).encode()],
        [b'{"command": "set_link", "tx": "a", "rx": "b", "taps": [{"delay_s": NaN, "gain_db": 0}]}'],
        [json.dumps({"command": "load", "scenario": "/"}).encode()],
        [json.dumps({"command": "load", "scenario": "1009", "cycle": "yes"}).encode()],
        [json.dumps({"command": "load", "scenario": "nul\0.yaml"}).encode()],
        [json.dumps({"command": "load", "scenario": "x" * 10_000 + ".yaml"}).encode()],
        [json.dumps({"command": "status", "k" * 5000: 1}).encode()],
    ],
)
def test_a_malformed_request_is_refused_and_the_next_one_is_answered(asked, parts):
    before = said(asked, command="status")["status"]
    answer = asked(*parts)
    assert answer["ok"] is False and answer["errors"] and max(map(len, answer["errors"])) < 11_000
    after = said(asked, command="status")
    assert after["ok"] and after["status"]["active_taps"] == before["active_taps"]


def test_a_fault_of_the_emulators_own_is_an_answer_and_not_the_end_of_all_answers(asked, monkeypatch, capfd):
    with monkeypatch.context() as broken:
        broken.setattr(Emulation, "status", lambda self: {}["no such level"])
        answer = said(asked, command="status")
    assert answer == {"ok": False, "errors": ["internal error: KeyError: 'no such level'"]}
    assert said(asked, command="status")["ok"] and "KeyError" in capfd.readouterr().err


ASKED_EARLY = """
import sys, threading
from gr_cast import scenario
from gr_cast.blocks.emulation import Emulation

for _ in range(25):
    emulation, ended = Emulation(scenario.load(sys.argv[1]), [], 1e6), threading.Event()
    asking = threading.Thread(target=lambda: [emulation.status() for _ in range(300)] and ended.set())
    asking.start()
    emulation.run_until(ended)
    asking.join()
"""


def test_an_emulator_is_asked_in_every_moment_of_its_start(tmp_path):
    (tmp_path / "two.yaml").write_text(SCENARIO % -3)
    command = [sys.executable, "-c", ASKED_EARLY, tmp_path / "two.yaml"]
    path = {"PYTHONPATH": str(Path(gr_cast.__file__).parents[1])}
    ended = subprocess.run(command, env=os.environ | path, capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0, ended.stderr[-2000:]


def test_a_scenario_that_cannot_be_is_refused_and_the_old_one_plays_on(asked, tmp_path):
    (tmp_path / "loud.yaml").write_text(SCENARIO % 3000)
    (tmp_path / "far.yaml").write_text((SCENARIO % 0).replace("delay_s: 0.0", "delay_s: 100.0"))
    os.mkfifo(tmp_path / "pipe.yaml")
    for name in ("loud", "far", "pipe"):
        answer = said(asked, command="load", scenario=str(tmp_path / f"{name}.yaml"))
        assert not answer["ok"] and said(asked, command="status")["status"]["scenario"] == "two"


def test_random_requests_are_all_answered(asked):
    rng = random.Random(5)
    atoms = [None, True, -1, 1e308, 10**30, "", "a", "b", "status", "load", "set_link", "\0", [], {}, float("nan")]

    def grown(depth):
        kind = rng.random()
        if depth == 0 or kind < 0.5:
            return rng.choice(atoms)
        if kind < 0.7:
            return [grown(depth - 1) for _ in range(rng.randrange(4))]
        keys = ["command", "scenario", "tx", "rx", "taps", "enabled", "delay_s", "gain_db", "phase_rad"]
        return {rng.choice(keys): grown(depth - 1) for _ in range(rng.randrange(6))}

    for _ in range(300):
        request = grown(4)
        if isinstance(request, dict) and rng.random() < 0.8:
            request["command"] = rng.choice(["status", "start", "load", "set_link"])
        assert "ok" in asked(json.dumps(request).encode())
    assert said(asked, command="status")["ok"]


def test_from_another_machine_only_named_folders_are_read(tmp_path):
    assert [control.is_local(a) for a in ("tcp://127.0.0.1:1", "tcp://localhost:1", "tcp://[::1]:1", "ipc:///x")] == [True] * 4
    assert [control.is_local(a) for a in ("tcp://*:1", "tcp://0.0.0.0:1", "tcp://192.168.1.2:1", "tcp://eth0:1")] == [False] * 4
    inside, outside = tmp_path / "in", tmp_path / "out"
    for folder in (inside, outside):
        folder.mkdir()
        (folder / "s.yaml").write_text("secret: of the house\n")
    for name in (outside / "s.yaml", inside / ".." / "out" / "s.yaml", outside / "absent.yaml"):
        with pytest.raises(CastError) as refused:
            control._scenario(str(name), (inside,))
        assert "secret" not in str(refused.value) and "absent" not in str(refused.value)
    with pytest.raises(CastError, match="secret"):
        control._scenario(str(inside / "s.yaml"), (inside,))
    assert control._scenario("four_tap", ()).name


STATUS = b'{"command": "status"}'


@pytest.fixture
def guarded(tmp_path):
    """An address that is guarded by the key in tmp_path / "key"; what came through is in the list."""
    keys.write_key(tmp_path / "key")
    address, came = f"ipc://{tmp_path}/guarded", []

    class Emulation:
        def status(self):
            came.append(True)
            return {}

    with control.ControlServer(address, (), keys.read_key(tmp_path / "key")) as server:
        with server.obeying(Emulation(), threading.Event()):
            yield address, came


def answer(address, key=None, timeout_ms=1000, kind=zmq.REQ):
    with zmq.Context() as context, context.socket(kind) as client:
        client.linger = 0
        if key:
            key.present(client)
        client.connect(address)
        client.send(STATUS)
        return client.recv_json() if client.poll(timeout_ms) else None


def test_with_the_key_one_is_obeyed_and_without_it_nobody_is_heard(guarded, tmp_path):
    address, came = guarded
    right = keys.read_key(tmp_path / "key")
    keys.write_key(tmp_path / "other")
    other = keys.read_key(tmp_path / "other")
    # A peer that has learnt the emulator's public key, and a false emulator's client.
    strangers = [
        None,
        other,
        dataclasses.replace(right, client=other.client),
        dataclasses.replace(right, emulator=other.emulator),
    ]
    for stranger in strangers:
        assert answer(address, stranger) is None and not came
    assert answer(address, right, 20_000)["ok"] and len(came) == 1


def test_what_goes_over_a_guarded_port_is_not_to_be_read_on_the_way(tmp_path):
    keys.write_key(tmp_path / "key")
    key, passed = keys.read_key(tmp_path / "key"), []
    with socket.create_server(("127.0.0.1", 0)) as way, zmq.Context() as context, key.required_of(context):
        with context.socket(zmq.REP) as server, context.socket(zmq.REQ) as client:
            server.linger = client.linger = 0
            key.guard(server)
            port = server.bind_to_random_port("tcp://127.0.0.1")
            key.present(client)
            client.connect(f"tcp://127.0.0.1:{way.getsockname()[1]}")
            client.send(b"a secret of the house")
            come, _ = way.accept()
            with come, socket.create_connection(("127.0.0.1", port)) as gone:
                other = {come: gone, gone: come}
                while not server.poll(0):
                    for end in select.select(other, [], [], 0.1)[0]:
                        passed.append(end.recv(65536))
                        other[end].sendall(passed[-1])
            assert server.recv() == b"a secret of the house"
    assert b"CURVE" in b"".join(passed) and b"secret" not in b"".join(passed)


def test_a_key_is_its_users_own_and_never_shown(tmp_path):
    path = tmp_path / "key"
    keys.write_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(CastError, match="overwritten"):
        keys.write_key(path)
    key, secret = keys.read_key(path), json.loads(path.read_text())["client"]
    assert secret not in repr(key) and key.client != key.emulator
    path.write_text(path.read_text().replace(secret, secret[:-1] + "!"))
    with pytest.raises(CastError, match="client: needs 64 hexadecimal digits") as refused:
        keys.read_key(path)
    assert secret[:8] not in str(refused.value)
    path.chmod(0o640)
    with pytest.raises(CastError, match="other users have access"):
        keys.read_key(path)


@pytest.mark.parametrize("ramp", [2**64 - 10, 2**62 + 1])
def test_a_ramp_beyond_all_samples_is_refused(ramp):
    kernel = emulator_kernel(1, 1, 8)
    kernel.set_sparse_taps(0, 0, [0], [1.0])
    with contextlib.suppress(OverflowError), pytest.raises(ValueError, match="ramp"):
        kernel.set_sparse_taps(0, 0, [0], [0.5], 0, ramp)
