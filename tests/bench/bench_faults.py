#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Attacks on the programs at random: signals and kills at any moment, malformed requests, mutated files, faults of radios.

    tests/bench/bench_faults.py [--minutes 10] [--seed S] [--kind KIND …] [--again NUMBER]

Every attack is drawn from the seed, which is printed, and its number: `--again` repeats one. Ends with the table tried, refused,
resumed, wrong. Refused: ended in lines of what is wrong. Resumed: what was interrupted, killed or lost by a radio is told and
whole, or went on. Wrong: a traceback, no end in time, another result, or a process, socket, namespace, lock or temporary file
that is left. Exit status 1 where any is.
"""

import argparse
import os
import random
import secrets
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

import fuzz_readers  # noqa: F401 (finds the package)
from faults.attacks import ATTACKS, prepare
from faults.watched import Wrong, namespaces

COLUMNS = ("tried", "refused", "resumed", "wrong")


def attacked(kind: str, rng: random.Random, template: Path) -> str:
    """One attack on a copy of the inputs. Raises Wrong."""
    before = namespaces()
    with tempfile.TemporaryDirectory(prefix="cast-faults-") as place:
        folder = Path(place) / "f"
        shutil.copytree(template, folder)
        os.chdir(folder)
        try:
            ended = ATTACKS[kind](rng, folder)
        finally:
            os.chdir("/")
    if left := namespaces() - before:
        raise Wrong(f"network namespaces left behind: {', '.join(left)}")
    return ended


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", default=secrets.token_hex(4), help="of all attacks; fresh without it")
    parser.add_argument("--kind", nargs="+", choices=list(ATTACKS), default=list(ATTACKS))
    parser.add_argument("--again", type=int, metavar="NUMBER", help="only this attack of the seed")
    args = parser.parse_args(argv)
    # In the background it inherits that interrupts are ignored, and so would every program that it interrupts.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    print(f"seed {args.seed}", flush=True)
    table = {kind: dict.fromkeys(COLUMNS, 0) for kind in args.kind}
    end = time.monotonic() + 60 * args.minutes
    with tempfile.TemporaryDirectory(prefix="cast-faults-") as place:
        template = Path(place) / "inputs"
        template.mkdir()
        prepare(template)
        number = args.again or 0
        while args.again is not None and number == args.again or args.again is None and time.monotonic() < end:
            rng = random.Random(f"{args.seed}/{number}")
            kind = rng.choice(args.kind)
            table[kind]["tried"] += 1
            try:
                ended = attacked(kind, rng, template)
                if ended in COLUMNS:
                    table[kind][ended] += 1
            except Wrong as wrong:
                table[kind]["wrong"] += 1
                print(f"attack {number}: {kind}: {wrong}", flush=True)
            number += 1
    print(f"{'kind':<12}" + "".join(f"{name:>9}" for name in COLUMNS))
    for kind, row in table.items():
        print(f"{kind:<12}" + "".join(f"{row[name]:>9}" for name in COLUMNS))
    total = {name: sum(row[name] for row in table.values()) for name in COLUMNS}
    print(f"{'all':<12}" + "".join(f"{total[name]:>9}" for name in COLUMNS))
    return 1 if total["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
