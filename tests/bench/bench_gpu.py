#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The network on a graphics card: how much faster than real time, alone and with all samples coming and going, and how exact.

Every row is a process of its own: what fails is told and leaves the other rows as they are. New taps of all links come every
millisecond, 4 of 512 each, from pinned memory of the processor. Real-time factors are milliseconds of radio per millisecond. What
the card's link to the processor allows is measured beside: the same stream with nothing between its copies, turn about.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "apps"))
import _program
import numpy as np
from gr_cast.emulation.gpu.device import open_device
from gr_cast.emulation.gpu.faults import DeviceFault, told
from gr_cast.emulation.gpu.form import DELAY_TYPE
from gr_cast.emulation.gpu.links import Table
from gr_cast.emulation.gpu.network import DeviceNetwork
from gr_cast.emulation.gpu.planner import Task, candidates, choose, error_db
from gr_cast.emulation.gpu.stream import Stream

N_TAPS, TAPS = 512, 4
TABLES = 8  # of taps, taken in turns
PERIOD_S = 1e-3  # that taps last
SMALL = 16  # nodes, up to which a chunk is of several periods: the card is through one before the processor has asked for it
TURNS = 5  # of every measurement; the best counts
FEWEST = 6  # chunks of a turn
LATE = 20  # chunks that are alone on their way
ENERGY_S = 2.0  # over which joules are counted: a card tells them some ten times a second
LONGEST_S = 150  # of a row
# name: nodes, MS/s, precision, 16 bits out, what must be reached: on the card, with transfers, error in dB
ROWS = {
    "128x100": (128, 100, "tf32", True, 1.4, 1.02, -65),
    "128x80": (128, 80, "tf32", True, None, 1.28, -65),
    "64x100": (64, 100, "tf32", True, None, 2.0, -65),
    "10x100": (10, 100, "tf32", True, 10.0, None, -65),
    "256x20": (256, 20, "tf32", True, 1.3, None, -65),
    "256x50": (256, 50, "tf32", True, 1.0, None, -65),
    "96x100 exact": (96, 100, "fp32", False, 1.0, None, -95),
    "112x100 exact": (112, 100, "fp32", False, None, None, -95),
    "128x100 exact": (128, 100, "fp32", False, None, None, -95),
}
TINY = {
    "4x1": (4, 1, "tf32", True, None, None, -65),
    "4x1 exact": (4, 1, "fp32", False, None, None, -95),
}


def random_table(ops, rng, nodes: int) -> Table:
    shape = (nodes, nodes, TAPS)
    delays, gains = ops.pinned(shape, DELAY_TYPE), ops.pinned(shape, np.complex64)
    delays[...] = np.sort(rng.integers(0, N_TAPS, shape), axis=-1)
    gains[...] = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2 * TAPS)
    return Table(delays=delays, gains=gains)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A network with a stream of int16 chunks through it, and the taps that it gets in turns, every `period` samples."""

    network: DeviceNetwork
    stream: Stream
    tables: list[Table]
    period: int
    full_scale: float  # of samples out

    @property
    def shape(self) -> tuple[int, int]:
        return self.stream.take().shape[:2]

    def new_taps(self) -> None:
        """Others for every period of the next chunk."""
        begin = self.network.position
        for at in range(begin, begin + self.shape[1], self.period):
            self.network.set_network(at, self.tables[at // self.period % TABLES])

    def emptied(self) -> None:
        while self.stream.under_way:
            self.stream.wait()


def set_up(ops, form, period: int, periods: int, is_int16_out: bool) -> Setup:
    network = DeviceNetwork(ops, form)
    # Transmitters of a fifth of full scale meet in a receiver: five times their root mean square is full scale there.
    full_scale = float(np.sqrt(form.n_inputs))
    network.set_samples(int16_in=True, int16_out=is_int16_out, output_full_scale=full_scale)
    rng = np.random.default_rng(3)
    tables = [random_table(ops, rng, form.n_inputs) for _ in range(TABLES)]
    return Setup(network=network, stream=Stream(network, periods * period), tables=tables, period=period, full_scale=full_scale)


def noise16(rng, shape):
    return np.rint(np.clip(0.2 / np.sqrt(2) * rng.standard_normal((*shape, 2), np.float32), -1, 0.99) * 32768).astype(np.int16)


def check(setup: Setup) -> float:
    """Error in dB of a fresh chunk whose taps change at its beginning, and which hears the end of the chunk before."""
    setup.emptied()
    rng, network, past = np.random.default_rng(), setup.network, N_TAPS - 1
    sent = [noise16(rng, setup.shape) for _ in range(2)]
    for samples, table in zip(sent, setup.tables, strict=False):
        network.set_network(None, table)
        setup.stream.take()[...] = samples
        setup.stream.push()
        heard = setup.stream.wait()
    if network.ends.int16_out:
        heard = (heard[..., 0] + 1j * heard[..., 1].astype(np.float32)) * np.float32(setup.full_scale / 32768)
    samples = np.concatenate([sent[0][:, -past:], sent[1]], axis=1)
    return error_db(heard, samples, past, setup.tables[1].delays, setup.tables[1].gains, seed=None)


def on_card(setup: Setup, seconds: float):
    """Chunks per second, and joules per chunk if the card tells, of samples that lie on the card; taps come from outside."""
    network, ops, rng = setup.network, setup.network.ops, np.random.default_rng(4)
    inputs = [ops.upload(noise16(rng, setup.shape)) for _ in range(2)]
    outs = [network.run(*inputs) for _ in range(2)]
    ways = ops.ways(1)

    def turn(n):
        with ways.computing(0):
            for k in range(n):
                setup.new_taps()
                network.run(inputs[(k + 1) % 2], inputs[k % 2], outs[k % 2])
            ops.synchronize()

    (rates,) = paced(seconds, turn)
    return max(rates), joules(turn, max(rates))


class NoNetwork:
    """Leaves samples where they are: what remains of a stream are its copies, a chunk's way down behind its way up."""

    def run(self, before, now, out) -> None:
        pass


def there_and_back(setup: Setup, seconds: float) -> dict:
    """The same from pinned memory to pinned memory, beside bare copies of the samples: chunks per second; seconds that a chunk
    is on its way: median and worst, and alone."""
    stream, took, alone, rng = setup.stream, [], [], np.random.default_rng(5)
    setup.emptied()
    for _ in range(stream.depth):  # samples to be sent again and again: to make them takes longer than to send them
        stream.take()[...] = noise16(rng, setup.shape)
        stream.push()
    setup.emptied()

    def turn(n):
        took.clear()
        for _ in range(n):
            if stream.under_way == stream.depth:
                stream.wait()
                took.append(stream.took_s())
            setup.new_taps()
            stream.push()
        setup.emptied()

    def bare(n):
        stream.network = NoNetwork()
        for _ in range(n):
            if stream.under_way == stream.depth:
                stream.wait()
            stream.push()
        setup.emptied()
        stream.network = setup.network

    both, copies = paced(seconds, turn, bare)
    turn(max(LATE, round(max(both) * seconds / TURNS)))
    for _ in range(LATE):
        setup.new_taps()
        stream.push()
        stream.wait()
        alone.append(stream.took_s())
    later = took[len(took) // 2 :]
    return {
        "chunks_per_s": max(both), "copies_per_s": max(copies), "share": np.median(np.divide(both, copies)),
        "late_s": np.median(later), "worst_s": max(later), "alone_s": np.median(alone),
    }  # fmt: skip


def paced(seconds: float, *turns) -> list[list[float]]:
    """How often per second each of `turns`, asked by turn(n) for n, does it: TURNS figures of each, turn about."""
    counts = []
    for turn in turns:
        turn(3)
        begin = time.perf_counter()
        turn(FEWEST)
        counts.append(int(np.clip(FEWEST * seconds / (time.perf_counter() - begin) / TURNS, FEWEST, 20000)))
    rates = [[] for _ in turns]
    for _ in range(TURNS):
        for turn, n, found in zip(turns, counts, rates, strict=True):
            begin = time.perf_counter()
            turn(n)
            found.append(n / (time.perf_counter() - begin))
    return rates


def joules(turn, rate: float):
    """What one of turn(n)'s n takes, over ENERGY_S; None where the card does not count."""
    before = energy_j()
    if before is None:
        return None
    n = max(1, round(rate * ENERGY_S))
    turn(n)
    return (energy_j() - before) / n


def energy_j():
    """Joules that the card has taken since it was started; None where it does not tell."""
    try:
        import pynvml

        pynvml.nvmlInit()
        return pynvml.nvmlDeviceGetTotalEnergyConsumption(pynvml.nvmlDeviceGetHandleByIndex(0)) * 1e-3
    except Exception:
        return None


def parts(setup: Setup) -> dict:
    """Milliseconds of every step of a period, each waited for, in the last of ten turns; {} in the direct form."""
    ops, form, ends, period = setup.network.ops, setup.network.form, setup.network.ends, setup.period
    if form.method != "overlap-save":
        return {}
    table = np.array([[0, period, 1, 0.0]])
    now = ops.upload(noise16(np.random.default_rng(6), (form.n_inputs, period)))
    taps = ops.upload(setup.tables[0].delays[None]), ops.upload(setup.tables[0].gains[None])
    shape = (form.n_outputs, period, 2) if ends.int16_out else (form.n_outputs, period)
    out = ops.empty(shape, np.int16 if ends.int16_out else np.complex64)
    clipped = ops.upload(np.zeros(1, np.int64))
    for _ in range(10):
        took, lap = {}, ops.clock()
        filters, scale = ops.filters(*taps, form)
        took["taps"] = lap()
        spectra = ops.forward(now, now, table, form.blocks(period), form, ends)
        took["forward"] = lap()
        product = ops.product(filters, spectra, form)
        took["product"] = lap()
        ops.inverse(product, scale, table, form, ends, 0, out, None, True, True, clipped)
        took["inverse"] = lap()
    return {name: round(1e3 * seconds, 4) for name, seconds in took.items()}


def measure(name: str, device: str, seconds: float, only: str | None = None) -> dict:
    nodes, rate_ms, precision, is_int16_out, *wanted = (ROWS | TINY)[name]
    rate = rate_ms * 1e6
    period, periods = round(PERIOD_S * rate), 4 if nodes <= SMALL else 1
    real_time = periods * PERIOD_S
    with told():
        ops, tried = open_device(device), []
        task = Task(
            n_inputs=nodes,
            n_outputs=nodes,
            n_taps=N_TAPS,
            taps_per_link=TAPS,
            life_samples=period,
            precision=precision,
            int16=True,
        )
        forms = [form for form in candidates(task, ops.tiles) if only is None or form.words().endswith(only)]
        choice = choose(ops, task, tried.append, remember=False, forms=forms)
        setup = set_up(ops, choice.form, period, periods, is_int16_out)
        row = {
            "nodes": nodes, "rate_hz": rate, "card": ops.name, "plan": choice.form.words(), "tile": choice.form.tile,
            "chunk_ms": 1e3 * real_time, "samples_out": "int16" if is_int16_out else "complex64", "wanted": wanted,
            "tried": tried, "error_db": check(setup),
        }  # fmt: skip
        chunks_per_s, taken = on_card(setup, seconds)
        row["on_card"] = chunks_per_s * real_time
        row["joules_per_link_sample"] = None if taken is None else taken / (nodes * nodes * periods * period)
        way = there_and_back(setup, seconds)
        table, ends = setup.tables[0], setup.network.ends
        sizes = [nodes * periods * period * (4 if is_int16 else 8) for is_int16 in (True, ends.int16_out)]
        row |= {
            "with_transfers": way["chunks_per_s"] * real_time, "copies": way["copies_per_s"] * real_time,
            "share_of_copies": way["share"], "copies_gb_s": [way["copies_per_s"] * size * 1e-9 for size in sizes],
            "tables_share": periods * (table.delays.nbytes + table.gains.nbytes) / sizes[0],
            "latency_ms": 1e3 * way["late_s"], "latency_worst_ms": 1e3 * way["worst_s"],
            "latency_alone_ms": 1e3 * way["alone_s"], "clipped": setup.network.clipped_samples(),
            "error_after_db": check(setup), "parts_ms": parts(setup),
        }  # fmt: skip
    return row


def laws(device: str) -> dict:
    """The suite's laws of the network, on the device."""
    files = [ROOT / "tests/emulation" / name for name in ("test_gpu_network.py", "test_gpu_sounding.py")]
    command = [sys.executable, "-m", "pytest", "-q", "-c", os.devnull, "--rootdir", ROOT, "-p", "no:cacheprovider"]
    command += ["--import-mode=importlib", *(path for path in files if path.exists())]
    environment = os.environ | {"CAST_DEVICE": device, "PYTHONPATH": f"{ROOT / 'python'}{os.pathsep}{ROOT / 'build/python'}"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    lines = done.stdout.strip().splitlines() or done.stderr.strip().splitlines() or ["nothing"]
    return {"passed": done.returncode == 0, "said": lines[-1], "all": lines[-40:] if done.returncode else []}


def in_a_process(arguments: list[str]) -> dict:
    """What this program, asked for one row, answers; or its fault in one line."""
    try:
        done = subprocess.run([sys.executable, __file__, *arguments], capture_output=True, text=True, timeout=LONGEST_S)
        return json.loads(done.stdout.strip().splitlines()[-1])
    except subprocess.TimeoutExpired:
        return {"fault": f"not done in {LONGEST_S} s"}
    except (ValueError, IndexError):
        return {"fault": (done.stderr.strip().splitlines() or [f"status {done.returncode}"])[-1], "stderr": done.stderr[-3000:]}


def line(name: str, row: dict) -> str:
    if "fault" in row:
        return f"{name:14} {row['fault']}"
    energy = row["joules_per_link_sample"]
    return (
        f"{name:14} {row['on_card']:8.2f} {row['with_transfers']:10.2f} {row['copies']:7.2f} {100 * row['share_of_copies']:4.0f} "
        f"{row['error_db']:8.1f} {row['latency_ms']:8.2f} "
        f"{row['latency_alone_ms']:6.2f} {'-' if energy is None else f'{1e12 * energy:.1f}':>8}  "
        f"{row['plan']}, tile {row['tile']}  {verdict(row)}"
    )


def verdict(row: dict) -> str:
    """What was asked for and is not reached; nothing where nothing was asked."""
    on_card, both, db = row["wanted"]
    short = [
        f"{what} {got:.2f} < {least}"
        for what, got, least in (
            ("on card", row["on_card"], on_card),
            (f"transfers (bare copies: {row['copies']:.2f})", row["with_transfers"], both),
        )
        if least is not None and got < least
    ]
    short += [f"error {row[which]:.1f} dB > {db}" for which in ("error_db", "error_after_db") if not row[which] <= db]
    return "; ".join(short) or "reached"


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", metavar="FILE", help="write the figures there, after every row")
    parser.add_argument("--device", choices=("cuda", "numpy"), default="cuda", help="numpy: tiny networks, to try the program")
    parser.add_argument("--rows", nargs="+", choices=[*ROWS, *TINY], help="some of them")
    parser.add_argument("--seconds", type=float, default=1.0, help="that a figure is taken over")
    parser.add_argument("--no-laws", action="store_true", help="the table alone")
    parser.add_argument("--one", choices=[*ROWS, *TINY], help=argparse.SUPPRESS)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.one:
        try:
            print(json.dumps(measure(arguments.one, arguments.device, arguments.seconds, arguments.only)))
        except DeviceFault as fault:
            print(json.dumps({"fault": "; ".join(fault.faults)}))
        return 0
    result = {"rows": {}}

    def keep():
        if arguments.json:
            Path(arguments.json).write_text(json.dumps(result, indent=1) + "\n")

    print(
        f"{'nodes x MS/s':14} {'on card':>8} {'transfers':>10} {'copies':>7} {'%':>4} {'error dB':>8} {'ms late':>8} "
        f"{'alone':>6} {'pJ/l.s.':>8}  plan"
    )
    for name in arguments.rows or (ROWS if arguments.device == "cuda" else TINY):
        asked = ["--one", name, "--device", arguments.device, "--seconds", str(arguments.seconds)]
        row = in_a_process(asked)
        if "fault" in row:  # a kernel that faults takes the whole process with it: once more with the plainest of spectra
            row = {"first_fault": row["fault"]} | in_a_process([*asked, "--only", (ROWS | TINY)[name][2]])
        result["rows"][name] = row
        print(line(name, row), flush=True)
        keep()
    if not arguments.no_laws:
        try:
            result["laws"] = laws(arguments.device)
        except (OSError, subprocess.SubprocessError) as error:
            result["laws"] = {"passed": False, "said": str(error)}
        print(f"laws on {arguments.device}: {result['laws']['said']}")
        print("\n".join(result["laws"].get("all", [])))
        keep()
    return 0


if __name__ == "__main__":
    _program.run(main)
