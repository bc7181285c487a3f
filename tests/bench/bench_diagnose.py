#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Conceal causes by GNU Radio's physics, seal the truths, diagnose, score: one command, a table of floors.

Run it from a built checkout. What an interrupted run left is kept and continued.
"""

import argparse
import sys
from pathlib import Path

from diagnose_bank import build, score
from sealed import add_arguments, judged

ROOT = Path(__file__).resolve().parents[2]


def _progress(index, total, name, case, miss):
    print(f"[{index}/{total}] {name} {build.describe(case, miss)}", flush=True)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200, metavar="N", help="how many cases (default 200)")
    parser.add_argument("--nulls", type=int, default=0, metavar="N", help="so many more with nothing wrong (default 0)")
    add_arguments(parser, ROOT / "build" / "bench")
    args = parser.parse_args(argv)
    if args.cases < 1 or args.jobs < 1 or args.nulls < 0:
        given = f"{args.cases}, {args.jobs} and {args.nulls}"
        parser.error(f"--cases, --jobs and --nulls: got {given}, need 1, 1 and 0 or more")
    cases, truths = args.output / "cases", args.output / "truth"
    seal = build.build(cases, truths, args.seed, args.cases, args.nulls, _progress)
    print(f"sealed: {seal}", flush=True)
    return judged(cases, truths, args, score.score, score.markdown)


if __name__ == "__main__":
    sys.exit(main())
