#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Conceal changes of Arena and of the street by a tracer that is not the tool's, seal the truths, diagnose, score: a table.

Arena, 42 nodes, sounded on 20 links: a piece of furniture left out, a material changed, a node 0.4 m off, all three, nothing.
The street, sounded from the car on its drive: a building left out. Run it from a built checkout; what is there is kept.
"""

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench" / "places"))

import grade
import shipped
from diagnose_bank import truth
from sealed import add_arguments, judged


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=shipped.WHAT, default=list(shipped.WHAT), help="these alone")
    parser.add_argument("--draws", type=int, default=1, metavar="N", help="of each, with seeds S, S + 1, … (default 1)")
    add_arguments(parser, ROOT / "build" / "bench_arena")
    args = parser.parse_args(argv)
    if min(args.jobs, args.draws) < 1:
        parser.error(f"--jobs, --draws: got {args.jobs}, {args.draws}, need 1 or more")
    for seed in range(args.seed, args.seed + args.draws):
        for what in args.only:
            shipped.make(what, seed, args.output)
    truths = args.output / "truth"
    print(f"sealed: {truth.seal(truths)}", flush=True)
    return judged(args.output / "places", truths, args, grade.grade, grade.markdown)


if __name__ == "__main__":
    sys.exit(main())
