#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Conceal changes of places by a tracer that is not the tool's, seal the truths, diagnose, score: a table of floors.

Run it from a built checkout. What an interrupted run left is kept and continued.
"""

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench" / "places"))

import grade
from diagnose_bank import truth
from sealed import add_arguments, judged

import build

KINDS = {"cases": 110, "nulls": 0, "power": 0, "ambiguous": 0, "outside": 0}


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for kind, count in KINDS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N", help=f"how many (default {count})")
    add_arguments(parser, ROOT / "build" / "bench_places")
    args = parser.parse_args(argv)
    if args.jobs < 1:
        parser.error(f"--jobs: got {args.jobs}, needs 1 or more")
    counts = [x for kind in KINDS for x in (f"--{kind}", str(getattr(args, kind)))]
    build.main([*counts, "--seed", str(args.seed), "--output", str(args.output)])
    truths = args.output / "truth"
    print(f"sealed: {truth.seal(truths)}", flush=True)
    return judged(args.output / "places", truths, args, grade.grade, grade.markdown)


if __name__ == "__main__":
    sys.exit(main())
