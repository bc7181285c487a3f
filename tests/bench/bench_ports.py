#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""One stream over ZeroMQ between processes, by our ports and by GNU Radio's own: samples per second, and processor time.

Samples per second need an idle machine; the processor time of all processes per sample hardly depends on others.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "apps"), str(ROOT / "tests")]

import _program  # noqa: F401  (finds gr_cast)
from ports import free_address

SCENARIO = """\
cast_scenario: 1
name: one link
nodes: [a, b]
links:
  - {tx: a, rx: b, taps: [{delay_s: 0.0, gain_db: 0.0}]}
"""
SETTLE_S = 1.0


def send(kind: str, address: str) -> None:
    """Zeros without end to whoever asks."""
    from gnuradio import blocks, gr, zeromq
    from gr_cast.blocks import zmq_replier

    top = gr.top_block()
    sink = zmq_replier(address) if kind == "ours" else zeromq.rep_sink(8, 1, address, 50, False, -1)
    top.connect(blocks.null_source(8), sink)
    top.run()


def receive(kind: str, address: str, seconds: float, answer) -> None:
    """Ask for samples; tell when how many came, at the begin and `seconds` later."""
    from gnuradio import blocks, gr, zeromq
    from gr_cast.blocks import zmq_requester

    top = gr.top_block()
    source = zmq_requester(address) if kind == "ours" else zeromq.req_source(8, 1, address, 50, False, -1)
    sink = blocks.null_sink(8)
    top.connect(source, sink)
    top.start()
    while not sink.nitems_read(0):
        time.sleep(0.01)
    time.sleep(SETTLE_S)
    for _ in range(2):
        answer.send((sink.nitems_read(0), time.perf_counter()))
        time.sleep(seconds)
    top.stop()
    top.wait()


def emulate(sent: str, heard: str) -> None:
    """One link of gain 1 between the two."""
    from gr_cast.blocks.emulation import Emulation
    from gr_cast.blocks.ports import Port
    from gr_cast.scenario import load

    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        file.write(SCENARIO)
        file.flush()
        scenario = load(file.name)
    ports = [Port.parse(f"a:tx=zmq:{sent}"), Port.parse(f"b:rx=zmq:{heard}")]
    Emulation(scenario, ports, 1e6).run_until(threading.Event())


def processor_s(process) -> float:
    """User and system time that a process has taken."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(sender: str, receiver: str, seconds: float, through_emulator: bool = False) -> tuple[float, float]:
    """Samples per second from a sender to a receiver, each "ours" or "stock", and processor seconds per sample."""
    processes = multiprocessing.get_context("spawn")
    sent = free_address()
    heard = free_address() if through_emulator else sent
    told, answer = processes.Pipe(duplex=False)
    running = [processes.Process(target=send, args=(sender, sent), daemon=True)]
    if through_emulator:
        running.append(processes.Process(target=emulate, args=(sent, heard), daemon=True))
    running.append(processes.Process(target=receive, args=(receiver, heard, seconds, answer), daemon=True))
    for process in running:
        process.start()
    marks = []
    for _ in range(2):
        if not told.poll(60):
            raise SystemExit(f"{sender} to {receiver}: nothing came within 60 s")
        marks.append((*told.recv(), sum(map(processor_s, running))))
    for process in running:
        process.kill()
        process.join()
    samples, wall_s, cpu_s = (after - before for before, after in zip(*marks, strict=True))
    return samples / wall_s, cpu_s / samples


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    parser.add_argument("--json", metavar="FILE", help="write the rows there too")
    args = parser.parse_args(argv)
    rows = []
    print("sender  receiver                 MS/s  re stock   CPU ns/sample")
    for sender, receiver, emulator in (
        ("stock", "stock", False), ("stock", "ours", False), ("ours", "stock", False), ("ours", "ours", False),
        ("stock", "stock", True), ("ours", "ours", True),
    ):  # fmt: skip
        samples_per_s, cpu_s = measure(sender, receiver, args.seconds, emulator)
        rows.append(
            {"sender": sender, "receiver": receiver, "emulator": emulator, "samples_per_s": samples_per_s,
             "cpu_s_per_sample": cpu_s}
        )  # fmt: skip
        ratio = samples_per_s / rows[0]["samples_per_s"]
        place = "emulator" * emulator
        print(f"{sender:7} {receiver:8} {place:10} {samples_per_s / 1e6:8.1f} {ratio:9.2f} {cpu_s * 1e9:13.1f}", flush=True)
    if args.json:
        Path(args.json).write_text(json.dumps({"rows": rows}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
