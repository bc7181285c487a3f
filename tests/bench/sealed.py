# SPDX-License-Identifier: GPL-3.0-or-later
"""The way of a sealed bench from its cases to a table: diagnose what is undone, see that the seal holds, score, write."""

import json
import subprocess
import sys
from pathlib import Path

from diagnose_bank import truth

PROGRAM = Path(__file__).resolve().parents[2] / "apps" / "cast_diagnose.py"


def add_arguments(parser, output: Path) -> None:
    """What all sealed benches are asked."""
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of all that is drawn (default 1)")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="diagnoses at the same time (default 1)")
    parser.add_argument("--output", type=Path, default=output, metavar="DIR", help=f"default build/{output.name}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="all figures as JSON")


def judged(cases: Path, truths: Path, args, score, markdown) -> int:
    """Exit status. `args` holds `output`, `jobs`, `seed` and `json`; `score(diagnoses, truths)` gives the figures."""
    diagnoses = args.output / "diagnoses"
    names = sorted(path.stem for path in truths.glob("*.json"))
    undone = [str(cases / name) for name in names if not (diagnoses / name / "diagnosis.json").exists()]
    if undone:
        command = ["/usr/bin/python3", str(PROGRAM), *undone, "--output", str(diagnoses), "--jobs", str(args.jobs)]
        status = subprocess.run(command, check=False).returncode
        if status not in (0, 2):
            return status
    if not truth.sealed(truths):
        print(f"error: {truths}: the truths are not those that were sealed", file=sys.stderr)
        return 1
    result = {"seed": args.seed, "seal": truth.digest(truths), **score(diagnoses, truths)}
    table = markdown(result)
    print(table)
    (args.output / "table.md").write_text(table)
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0
