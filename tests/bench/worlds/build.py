#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the cases and the sealed truths of a world of concealed faults.

build.py --world lab --cases 250 --nulls 100 --absent 10 --seed 1 --output /tmp/lab
  → /tmp/lab/cases/<case>/, /tmp/lab/truth/<case>.json, and the seal, /tmp/lab/SEAL.sha256

A world is a module or package beside this file that exposes draw(rng, kind, folder) → truth. A build that was
interrupted goes on where it stopped.
"""

import argparse
import hashlib
import importlib
import json
import os
import shutil
import sys
from pathlib import Path

for threads in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

SHARES = {"single": 0.35, "double": 0.22, "triple": 0.15, "network": 0.08, "outside": 0.10, "ambiguous": 0.10}
SEAL = "SEAL.sha256"


def kinds(cases, nulls, absent):
    """The kind of every case, in an order that a seed does not change."""
    exact = {k: v * cases for k, v in SHARES.items()}
    count = {k: int(v) for k, v in exact.items()}
    for k in sorted(exact, key=lambda k: count[k] - exact[k])[: cases - sum(count.values())]:
        count[k] += 1
    count |= {"null": nulls, "absent": absent}
    return [k for k, n in count.items() for _ in range(n)]


def case_name(world, seed, number):
    """Tells nothing of what the case holds."""
    return "case_" + hashlib.sha256(f"{world}/{seed}/{number}".encode()).hexdigest()[:12]


def digest(folder):
    """SHA-256 over names and contents of the truths, in the order of their names."""
    total = hashlib.sha256()
    for path in sorted(Path(folder).glob("*.json")):
        total.update(path.name.encode() + b"\0" + path.read_bytes())
    return total.hexdigest()


def build_case(draw, world, seed, number, kind, output):
    """The truth is written last: where it stands, the case is whole."""
    name = case_name(world, seed, number)
    case, truth = output / "cases" / name, output / "truth" / f"{name}.json"
    if truth.exists() and case.is_dir():
        return name, False
    part = output / "cases" / f".{name}.part"
    for old in (part, case):
        if old.exists():
            shutil.rmtree(old)
    part.mkdir(parents=True)
    told = draw(np.random.default_rng([seed, number, sum(world.encode())]), kind, part)
    told["case"] = name
    part.rename(case)
    part = truth.with_suffix(".part")
    part.write_text(json.dumps(told, indent=1) + "\n")
    part.rename(truth)
    return name, True


def main(argv=None):
    ap = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ap.add_argument("--world", required=True)
    ap.add_argument("--cases", type=int, default=250)
    ap.add_argument("--nulls", type=int, default=100)
    ap.add_argument("--absent", type=int, default=10)
    ap.add_argument("--seed", type=int, default=1)
    ap.add_argument("--output", type=Path, required=True)
    a = ap.parse_args(argv)
    draw = importlib.import_module(f"worlds.{a.world}").draw
    (a.output / "truth").mkdir(parents=True, exist_ok=True)
    (a.output / SEAL).unlink(missing_ok=True)
    every = kinds(a.cases, a.nulls, a.absent)
    for number, kind in enumerate(every):
        name, fresh = build_case(draw, a.world, a.seed, number, kind, a.output)
        if fresh:
            print(f"{number + 1}/{len(every)} {name}", flush=True)
    value = digest(a.output / "truth")
    (a.output / SEAL).write_text(value + "\n")
    print(f"{len(every)} cases of {a.world}, sealed: {value}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
