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
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "apps"))
import _program
from gpu_measures import N_TAPS, TAPS, check, on_card, parts, set_up, there_and_back
from gr_cast.emulation.gpu.device import open_device
from gr_cast.emulation.gpu.faults import DeviceFault, told
from gr_cast.emulation.gpu.planner import Task, candidates, choose

PERIOD_S = 1e-3  # that taps last
SMALL = 16  # nodes, up to which a chunk is of several periods: the card is through one before the processor has asked for it
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
