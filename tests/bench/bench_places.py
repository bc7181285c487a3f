#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Conceal changes of places by a tracer that is not the tool's, seal the truths, diagnose, score: a table of floors.

Run it from a built checkout. What an interrupted run left is kept and continued.
"""

import argparse
import hashlib
import json
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "bench" / "places"))

import grade

import build

KINDS = {"cases": 110, "nulls": 0, "power": 0, "ambiguous": 0, "outside": 0}


def seal(truths):
    digest = hashlib.sha256()
    for path in sorted(truths.glob("*.json")):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for kind, count in KINDS.items():
        parser.add_argument(f"--{kind}", type=int, default=count, metavar="N", help=f"how many (default {count})")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of all that is drawn (default 1)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="diagnoses at the same time (default 1)")
    parser.add_argument(
        "--output", type=Path, default=ROOT / "build" / "bench_places", metavar="DIR", help="default build/bench_places"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="all figures as JSON")
    args = parser.parse_args(argv)
    if args.jobs < 1:
        parser.error(f"--jobs: got {args.jobs}, needs 1 or more")
    counts = [x for kind in KINDS for x in (f"--{kind}", str(getattr(args, kind)))]
    build.main([*counts, "--seed", str(args.seed), "--output", str(args.output)])
    truths, diagnoses = args.output / "truth", args.output / "diagnoses"
    before = seal(truths)
    names = sorted(path.stem for path in truths.glob("*.json"))
    undone = [str(args.output / "places" / n) for n in names if not (diagnoses / n / "diagnosis.json").exists()]
    if undone:
        program = ["/usr/bin/python3", str(ROOT / "apps" / "cast_diagnose.py")]
        command = [*program, *undone, "--output", str(diagnoses), "--jobs", str(args.jobs)]
        status = subprocess.run(command, check=False).returncode
        if status not in (0, 2):
            return status
    if seal(truths) != before:
        print(f"error: {truths}: the truths are not those that were sealed", file=sys.stderr)
        return 1
    result = {"seed": args.seed, "seal": before, **grade.grade(diagnoses, truths)}
    table = grade.markdown(result)
    print(table)
    (args.output / "table.md").write_text(table)
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
