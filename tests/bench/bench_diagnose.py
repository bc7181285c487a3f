#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Conceal causes by GNU Radio's physics, seal the truths, diagnose, score: one command, a table of floors.

Run it from a built checkout. What an interrupted run left is kept and continued.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path

from diagnose_bank import build, score, truth

ROOT = Path(__file__).resolve().parents[2]


def _progress(index, total, name, case, miss):
    print(f"[{index}/{total}] {name} {build.describe(case, miss)}", flush=True)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=200, metavar="N", help="how many cases (default 200)")
    parser.add_argument("--nulls", type=int, default=0, metavar="N", help="so many more with nothing wrong (default 0)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of all that is drawn (default 1)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="diagnoses at the same time (default 1)")
    parser.add_argument("--output", type=Path, default=ROOT / "build" / "bench", metavar="DIR", help="default build/bench")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all figures as JSON")
    args = parser.parse_args(argv)
    if args.cases < 1 or args.jobs < 1 or args.nulls < 0:
        given = f"{args.cases}, {args.jobs} and {args.nulls}"
        parser.error(f"--cases, --jobs and --nulls: got {given}, need 1, 1 and 0 or more")
    cases, truths, diagnoses = (args.output / name for name in ("cases", "truth", "diagnoses"))
    seal = build.build(cases, truths, args.seed, args.cases, args.nulls, _progress)
    print(f"sealed: {seal}", flush=True)
    names = sorted(path.stem for path in truths.glob("*.json"))
    program = [str(ROOT / "apps" / "cast_diagnose.py"), *(str(cases / name) for name in names)]
    undone = [p for p in program[1:] if not (diagnoses / Path(p).name / "diagnosis.json").exists()]
    if undone:
        command = [
            "/usr/bin/python3",
            program[0],
            *undone,
            "--output",
            str(diagnoses),
            "--jobs",
            str(args.jobs),
        ]
        status = subprocess.run(command, check=False).returncode
        if status not in (0, 2):
            return status
    if not truth.sealed(truths):
        print(f"error: {truths}: the truths are not those that were sealed", file=sys.stderr)
        return 1
    result = {"seed": args.seed, "seal": seal, **score.score(diagnoses, truths)}
    table = score.markdown(result)
    print(table)
    (args.output / "table.md").write_text(table)
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
