# SPDX-License-Identifier: GPL-3.0-or-later
"""One attack each: `attack(rng, folder)` gives what it ended in, `refused`, `resumed` or `done`, or raises Wrong."""

import contextlib
import json
import random
import signal
import subprocess
import time
from pathlib import Path

import fuzz_readers
import numpy as np
import yaml
import zmq
from gr_cast.signals import codes, recording

from .watched import ROOT, Watched, Wrong, check_recordings, check_tidy

SIGNAL_S = 20.0  # for a program to end after a signal, on a machine with other work
RADIO_S = 5.0  # beyond a radio's deadline
START_S = 60.0  # for an interpreter with GNU Radio to begin, on a machine with other work
RATE_HZ = 200e3
ENDS = {0, 2, 3, 130, 141, 128 + signal.SIGINT, 128 + signal.SIGTERM, -signal.SIGINT, -signal.SIGTERM}
SCENARIO = "cast_scenario: 1\nnodes: [a, b]\nlinks:\n  - {tx: a, rx: b, taps: [{delay_s: 3.0e-6, gain_db: -3}]}\n"
FAKE = ROOT / "tests" / "blocks" / "fake_device.py"
RADIO = ["--rate", f"{RATE_HZ:g}", "--frequency", "1e9", "--args", "addr=1"]


def prepare(folder: Path) -> None:
    """Inputs that programs work on: a scenario, recordings, two series, a twin, a stack with its sites."""
    rng = np.random.default_rng(1)
    (folder / "s.yaml").write_text(SCENARIO)
    for name, count in (("x", 200_000), ("y", 2_000_000)):
        noise = (rng.normal(size=(count, 2)) @ [1, 1j]).astype(np.complex64)
        recording.write(folder / name, noise, sample_rate_hz=RATE_HZ)
    code = np.resize(codes.glfsr(8), 60_000).astype(np.complex64)
    recording.write(folder / "heard", code * 0.5, sample_rate_hz=1e6)
    for name in "pq":
        rows = "".join(f"{k / 10},{value:.6g}\n" for k, value in enumerate(rng.normal(size=300)))
        (folder / f"{name}.csv").write_text("time_s,value\n" + rows)
    _case(folder / "case", code)
    subprocess.run(["bash", ROOT / "docs/examples/stack.sh", folder / "stack"], check=True, stdout=subprocess.DEVNULL)


def _case(folder: Path, sent: np.ndarray) -> None:
    folder.mkdir()
    rng = np.random.default_rng(2)
    heard = sent + 0.1 * np.roll(sent, 9) + 1e-2 * (rng.normal(size=(len(sent), 2)) @ [1, 1j])
    recording.write(folder / "r", heard.astype(np.complex64), sample_rate_hz=1e6)
    twin = {
        "cast_twin": 1, "sample_rate_hz": 1e6, "center_frequency_hz": 1e9, "unknown": ["delay", "phase", "gain"],
        "waveforms": {"w": {"code": "glfsr", "degree": 8, "mask": 0, "seed": 1, "samples_per_chip": 1}},
        "nodes": {"tx1": {"transmit": "w"}, "rx1": {}},
        "links": [{"tx": "tx1", "rx": "rx1", "taps": [{"delay_s": 0.0, "gain_db": 0.0}]}],
        "recordings": [{"file": "r", "receiver": "rx1"}],
    }  # fmt: skip
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))


def _programs(rng: random.Random) -> list[list]:
    """Every program, at some work that takes a few seconds."""
    fake = [FAKE, "{}"]
    run = ["run", "s.yaml", "--rate", f"{RATE_HZ:g}", "--frequency", "1e9", "--report", "0.5"]
    return [
        ["cast_sounder.py", "run", "--output", "out", "--frames", "3000"],
        ["cast_sounder.py", "process", "heard", "--code", "glfsr:8", "--output", "out"],
        ["cast_sounder.py", "codes", "--output", "out"],
        [*fake, "cast_sounder", "rx", "--output", "out", *RADIO],
        [*fake, "cast_sounder", "tx", "--log", "tx.json", *rng.choice([[], ["--restart-aligned"]]), *RADIO],
        ["cast_emulator.py", *run, "--port", "b:rx=file:out/b"],
        [*fake, "cast_emulator", *run, "--port", "a:tx=uhd:addr=1", "--port", "b:rx=uhd:addr=2", "--port", "a:rx=file:out/a"],
        ["cast_emulator.py", *run, "--port", "a:tx=zmq:ipc://a", "--port", "b:rx=file:out/b", "--control", "ipc://control"],
        ["cast_emulator.py", "batch", "s.yaml", "--transmit", "a=y", "--output", "out", "--chunk", "100000"],
        ["cast_emulator.py", "play", "--twin", "case/twin.yaml", "--output", "out", "--duration", "1"],
        ["cast_emulator.py", "play", "--twin", "case/twin.yaml", "--port", "rx1:rx=file:out/r"],
        ["cast_diagnose.py", "case", "--output", "out", *rng.choice([[], ["--jobs", "2"]])],
        ["cast_compare.py", "p.csv", "q.csv", "--output", "out"],
        ["cast_pipeline.py", "run", "HEAD", "--repository", "stack", "--sites", "stack-sites", "--storage", "out"],
        ["cast_scenario.py", "convert", "s.yaml", "out.mat"],
        ["cast_scenario.py", "validate", "s.yaml"],
        ["cast_jamming.py", "run", "--case", "static-none", "--frames-per-second", "50", "--output", "out"],
        ["cast_cellular.py", "--output", "out", "--blocks", "6", "--duration", "3"],
    ]


def signals(rng: random.Random, folder: Path) -> str:
    """SIGINT or SIGTERM at any moment, now and then a second one soon after. Done: it had ended before."""
    words = rng.choice(_programs(rng))
    program = Watched(folder, *words)
    with contextlib.suppress(subprocess.TimeoutExpired):
        program.process.wait(rng.uniform(0.3, rng.choice([2.0, 4.0, 12.0])))  # some are at work for a second or two
    there = program.signal(rng.choice([signal.SIGINT, signal.SIGTERM]))
    there_twice = rng.random() < 0.4
    if there_twice:
        time.sleep(rng.choice([0.0, rng.uniform(0, 0.5)]))
        program.signal(rng.choice([signal.SIGINT, signal.SIGTERM]))
    try:
        ended = program.ended(SIGNAL_S if there else START_S)
        if ended.status not in ENDS:
            raise Wrong(f"exit status {ended.status}: {ended.errors[-200:]!r}")
        program.check_gone()
        check_recordings(folder)
        if not there_twice:  # who ends a program at once cleans up for it
            check_tidy(folder)
    except Wrong as wrong:
        raise Wrong(f"{' '.join(map(str, words[:4]))}: {wrong}") from None
    return "resumed" if there else "done"


def kills(rng: random.Random, folder: Path) -> str:
    """SIGKILL of a batch, which run again ends as if it had never been; of a diagnosis and an emulator: no process is left."""
    what = rng.choice(["batch", "batch", "diagnose", "run"])
    if what == "batch":
        chunks = ["--chunk", str(rng.choice([20_000, 77_777])), "--workers", str(rng.choice([1, 2])), "--noise-power-db", "-20"]
        batch = ["cast_emulator.py", "batch", "s.yaml", "--transmit", "a=x", *chunks, "--output"]
        for _ in range(rng.randrange(1, 4)):
            killed = Watched(folder, *batch, "out")
            time.sleep(rng.uniform(0.5, 6.0))
            killed.signal(signal.SIGKILL)
            killed.process.communicate()
            killed.check_gone()
        again = Watched(folder, *batch, "out").ended(START_S)
        if again.status and "exists" not in again.errors:  # it had been whole before the kill came
            raise Wrong(f"batch, run again: {again.errors[-200:]!r}")
        whole = Watched(folder, *batch, "whole").ended(START_S)
        for node in "ab":
            files = [recording.data_path(folder / place / node) for place in ("out", "whole")]
            if whole.status or files[0].read_bytes() != files[1].read_bytes():
                raise Wrong(f"batch, run again: {node} is not what it is without a kill")
        if (folder / "out" / ".batch").exists():
            raise Wrong("batch, run again: left its plan behind")
        check_tidy(folder)
        return "resumed"
    words = {
        "diagnose": ["cast_diagnose.py", "case", "--output", "out", "--jobs", "2"],
        "run": ["cast_emulator.py", "run", "s.yaml", "--rate", "1e5", "--port", "a:tx=file:y", "--port", "b:rx=file:out/b"],
    }[what]
    killed = Watched(folder, *words)
    time.sleep(rng.uniform(0.5, 8.0))
    killed.signal(signal.SIGKILL)
    killed.process.communicate()
    killed.check_gone()
    check_recordings(folder)
    return "resumed"


def requests(rng: random.Random, folder: Path) -> str:
    """Malformed requests to a running emulator: each has an answer, and what is refused changes nothing."""
    address = f"ipc://{folder / 'control'}"
    run = ["run", "s.yaml", "--rate", "1e6", "--report", "60", "--control", address]
    emulator = Watched(folder, "cast_emulator.py", *run)
    refused = 0
    with zmq.Context() as context, context.socket(zmq.REQ) as remote:
        remote.linger = 0
        remote.connect(address)

        def ask(parts: list[bytes]) -> dict:
            remote.send_multipart(parts)
            if not remote.poll(1e3 * START_S):
                raise Wrong(f"no answer to {parts!r:.200}: {emulator.stuck()}")
            return remote.recv_json()

        try:
            for _ in range(60):
                before = ask([b'{"command": "status"}'])["status"]
                answer = ask(_request(rng))
                refused += not answer["ok"]
                after = ask([b'{"command": "status"}'])["status"]
                kept = ("active_taps", "active_links", "scenario", "on")
                if not answer["ok"] and any(before[key] != after[key] for key in kept):
                    raise Wrong("a refused request changed something")
            ask([b'{"command": "quit"}'])
            ended = emulator.ended(SIGNAL_S)
        except BaseException:
            emulator.end()
            raise
    if ended.status:
        raise Wrong(f"quit: {ended.errors[-200:]!r}")
    emulator.check_gone()
    check_tidy(folder)
    return "refused" if refused else "done"


def _request(rng: random.Random) -> list[bytes]:
    atoms = [None, True, -1, 0, 1e308, 10**30, 1e-3, "", "a", "b", "\0", "s.yaml", "/", float("nan"), float("inf")]
    keys = ["command", "scenario", "tx", "rx", "taps", "enabled", "delay_s", "gain_db", "phase_rad"]

    def grown(depth: int):
        kind = rng.random()
        if depth == 0 or kind < 0.5:
            return rng.choice(atoms)
        if kind < 0.7:
            return [grown(depth - 1) for _ in range(rng.randrange(4))]
        return {rng.choice(keys): grown(depth - 1) for _ in range(rng.randrange(6))}

    if rng.random() < 0.15:
        return [rng.choice([b"", b"[" * 50_000, b"\xff\xfe", rng.randbytes(50), b'{"command"' * 99]), *rng.choice([[], [b"x"]])]
    request = grown(4)
    if isinstance(request, dict):
        request["command"] = rng.choice(["status", "start", "load", "set_link", "stop"])
        if request["command"] == "set_link":
            request |= {"tx": "a", "rx": "b", "taps": [{"delay_s": rng.choice(atoms), "gain_db": rng.choice(atoms)}]}
    return [json.dumps(request).encode()]


def files(rng: random.Random, folder: Path) -> str:
    """Mutated files for one reader."""
    number, seed = rng.randrange(len(fuzz_readers.READERS)), f"{rng.random()}"
    count, wrong = fuzz_readers.attack(number, 50, seed)
    if wrong:
        raise Wrong(wrong[0])
    return "refused" if count.refused else "done"


def radios(rng: random.Random, folder: Path) -> str:
    """A fault of a radio: it ends in time, in one line, with a status that says so and what was received."""
    seconds = rng.uniform(0.2, 1.5)
    at = rng.randrange(int(seconds * RATE_HZ))
    fault = rng.choice(
        [{}, {"rx_silent_after": at}, {"rx_dies_after": at}, {"rx_overrun_every": 5000 + at, "rx_lost": rng.randrange(1, 9999)},
         {"tx_silent_after": at}, {"tx_dies_after": at}, {"tx_underrun_at": [max(1, at)]}, {"starts_late": True},
         {"no_pulse": True}, {"unlocked": True}, {"gain_db": 3.0}, {"rate_hz": 250e3}]
    )  # fmt: skip
    kind = rng.choice(["rx", "tx", "run"])
    timed = ["--clock-source", "external", "--time-source", "external"] if {"no_pulse", "unlocked"} & set(fault) else []
    late_s = 0.0
    if "no_pulse" in fault:
        late_s = 30.0
        timed += ["--start-at", str(int(time.time() + late_s))]
    ends = ["--duration", f"{seconds}"]
    words = {
        "rx": ["cast_sounder", "rx", "--record-only", "--output", "out", *ends, *RADIO],
        "tx": ["cast_sounder", "tx", "--log", "tx.json", *ends, *RADIO],
        "run": ["cast_emulator", "run", "s.yaml", "--rate", f"{RATE_HZ:g}", "--frequency", "1e9", "--port", "a:tx=uhd:addr=1",
                "--port", "b:rx=uhd:addr=2", "--port", "a:rx=file:out/a"],
    }[kind]  # fmt: skip
    fails = {"rx_silent_after", "rx_dies_after"} if kind == "rx" else {"tx_silent_after", "tx_dies_after"}
    if kind == "run":  # a receiver and a transmitter; it has no end of its own
        fault |= {"rx_silent_after": int(seconds * RATE_HZ)} if not {"rx_silent_after", "rx_dies_after"} & set(fault) else {}
        fails |= {"rx_silent_after", "rx_dies_after"}
    program = Watched(folder, FAKE, json.dumps(fault), *words, *timed)
    told = f"{kind} with {fault}"
    try:
        ended = program.ended(seconds + RADIO_S + START_S + late_s)
        lines = [line for line in ended.errors.splitlines() if line.startswith(("error: ", "lost: "))]
        is_lost = {
            "rx": fault.get("rx_overrun_every", np.inf) < int(seconds * RATE_HZ),
            "tx": bool({"tx_underrun_at", "starts_late"} & set(fault)),
            "run": False,  # what ends it is told
        }[kind]
        refused = {"no_pulse", "unlocked", "gain_db", "rate_hz"} & set(fault)
        should = 2 if refused or fails & set(fault) or "starts_late" in fault and kind != "tx" else 3 if is_lost else 0
        if ended.status != should and not (kind == "tx" and ended.status == 3):  # a host too busy for a radio: told, too
            raise Wrong(f"exit status {ended.status}, not {should}: {ended.errors[-300:]!r}")
        if (should != 0) != bool(lines) and ended.status == should:
            raise Wrong(f"{len(lines)} lines: {ended.errors[-300:]!r}")
        program.check_gone()
        check_recordings(folder)
        check_tidy(folder)
    except Wrong as wrong:
        raise Wrong(f"{told}: {wrong}") from None
    return "refused" if should == 2 else "resumed" if should == 3 else "done"


ATTACKS = {"signals": signals, "kills": kills, "requests": requests, "files": files, "radios": radios}
