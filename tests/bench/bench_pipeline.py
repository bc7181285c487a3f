# SPDX-License-Identifier: GPL-3.0-or-later
"""Counts of protocol-stack twinning, against a testbed by closed formulas whose noise is fresh in every run.

    tests/bench/bench_pipeline.py FOLDER [bisect|harmless|equal|judge|sites|images] [--count N]

bisect: a scrambler that only long frames notice, and a gain that only clips on the testbed, each at a random one of 20 commits.
harmless: 30 commits that change words; how many raise an alarm. equal: runs of equal sites that are the same on both.
judge: the same, but for the stack, whose frames are made here. images: hashes that repeat.
sites: a hidden amplifier, clock offset, missing path, quieter floor; how often each is named.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "build" / "python"), str(ROOT / "tests" / "pipeline")]
from conftest import Stack
from equal_sites import said
from gr_cast.pipeline.bisect import bisect
from stack_faults import GAIN, SCRAMBLER, harmless

NAMES = {"amplifier": "pa_nonlinearity", "clock": "carrier_frequency_offset", "path": "missing_path", "quiet": "noise_floor"}


def history(stack: Stack, fault: dict, at: int, count: int) -> list[str]:
    return [stack.commit(f"Commit {k}", **(fault if k == at else harmless(k))) for k in range(1, count + 1)]


def bench_bisect(folder: Path, count: int) -> None:
    rng = np.random.default_rng(1)
    for name, fault, bed in (("scrambler", SCRAMBLER, "none"), ("gain", GAIN, "rails")):
        stack, at = Stack(folder / name), int(rng.integers(2, count))
        stack.testbed(bed)
        commits, begun = history(stack, fault, at, count), time.monotonic()
        bench = stack.bench(folder / f"{name}-store")
        found = bisect(bench, stack.git("rev-list", "--max-parents=0", "HEAD"), "HEAD")
        verdict = bench.commit(found.suspects[0]).judged()
        right = found.suspects == (commits[at - 1],)
        print(f"{name}: commit {at} of {count}, {'found' if right else 'MISSED'}, {len(found.tried)} tried, "
              f"{time.monotonic() - begun:.0f} s: {verdict['verdicts']}", flush=True)  # fmt: skip


def bench_harmless(folder: Path, count: int) -> None:
    stack = Stack(folder / "harmless")
    stack.shorten()
    stack.testbed()
    commits = history(stack, {}, 0, count)
    bench, alarms = stack.bench(folder / "harmless-store"), 0
    for commit in commits:
        found = bench.commit(commit).judged()
        if found["kinds"] != ["same on both"]:
            alarms += 1
            print(found["verdicts"], flush=True)
    print(f"harmless: {alarms} of {count} commits raised an alarm, or were not decided", flush=True)


def bench_equal(folder: Path, count: int) -> None:
    stack = Stack(folder / "equal")
    stack.shorten()
    stack.testbed()
    same = sum(
        stack.bench(folder / f"equal-store-{k}").commit("HEAD").judged()["kinds"] == ["same on both"] for k in range(count)
    )
    print(f"equal: {same} of {count} the same on both", flush=True)


def bench_judge(folder: Path, count: int) -> None:
    found = said(count, 4, 1)
    same, apart = found.count({"within"}), sum("beyond" in one for one in found)
    print(f"judge: {same} of {count} equal sites the same on both, {apart} differ", flush=True)


def bench_sites(folder: Path, count: int) -> None:
    stack = Stack(folder / "sites")
    stack.shorten()
    for fault, family in NAMES.items():
        stack.testbed("none" if fault == "quiet" else fault, -63 if fault == "quiet" else -55)
        named = 0
        for k in range(count):
            told = stack.bench(folder / f"sites-store-{fault}-{k}").commit("HEAD").judged()["verdicts"]
            right = [one for one in told if one["kind"] == "twin and testbed differ" and one["cause"]["families"][:1] == [family]]
            named += bool(right)
            if not right:
                print(told, flush=True)
        print(f"sites, {fault}: {named} of {count} named {family}", flush=True)


def bench_images(folder: Path, count: int) -> None:
    stack, alike = Stack(folder / "images"), 0
    for k, commit in enumerate(history(stack, {}, 0, count)):
        kinds = ("process", "namespaces")
        alike += len({stack.bench(folder / f"images-{kind}-{k}", kind).commit(commit).built["image"] for kind in kinds}) == 1
    print(f"images: {alike} of {count} commits gave one hash, built twice in two rooms and two storages", flush=True)


def main() -> None:
    parts = {name.removeprefix("bench_"): part for name, part in globals().items() if name.startswith("bench_")}
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("part", choices=parts)
    parser.add_argument("--count", type=int, default=20)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    parts[args.part](args.folder, args.count)


if __name__ == "__main__":
    main()
