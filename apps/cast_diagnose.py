#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
# PYTHON_ARGCOMPLETE_OK
"""Diagnose cases: where a twin and its recordings differ, what physics was left out, whose it is, and a
corrected twin."""

import argparse
import os
import sys
import time
import traceback
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process per case is faster than threads in small products
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import _program
from gr_cast.core import tasks
from gr_cast.core.errors import CastError
from gr_cast.core.files import check_writable, sweep_dead

PROGRESS_S = 10.0  # between two lines about a case that takes long


def _progress(name: str):
    """A function that prints where the diagnosis of a case stands, now and then."""
    last = time.monotonic()

    def show(where: str) -> None:
        nonlocal last
        if time.monotonic() - last >= PROGRESS_S:
            last = time.monotonic()
            print(f"{name}: {where}", flush=True)

    return show


def _one(common: tuple[Path, float | None], folder: Path) -> tuple[str, list[str]]:
    """(line for the screen, faults) of one case; `common`: folder for the diagnoses, seconds for each, or None."""
    # Only a process that diagnoses loads what that takes: two seconds.
    from gr_cast import diagnose as links
    from gr_cast.diagnose import places
    from gr_cast.diagnose.write import check_replaceable
    from gr_cast.report.link import page as link_page
    from gr_cast.report.place import page as place_page
    from gr_cast.twin.places import document

    output, budget_s = common
    target = output / Path(folder).resolve().name
    kind = places if document.is_place(folder) else links
    budget_s = budget_s or kind.BUDGET_S
    try:
        check_replaceable(target)
        case = kind.read_case(folder)
        slips = kind.mistakes_of(case)
        for slip in slips:  # before the time that a search takes
            print(f"{case.name}: {slip}", flush=True)
        diagnosis = kind.diagnose(case, budget_s=budget_s, progress=_progress(case.name))
        page = (place_page if kind is places else link_page).render(diagnosis)
    except CastError as error:
        return "", list(error.faults)
    except Exception:  # one case must not stop the others
        return "", [f"{folder}: internal error\n{traceback.format_exc()}"]
    try:
        kind.write(diagnosis, target, page)
    except CastError as error:
        return "", list(error.faults)
    except OSError as error:
        return "", [f"{error.filename or output}: {error.strerror or error}"]
    d = diagnosis.document
    notes = [f"    {line}" for line in d["warnings"] if line not in slips]
    if d["residual"].get("out_of_time"):
        notes.append(f"    Out of time after {budget_s:g} s: a larger --budget may find more.")
    named = ", ".join(f"{e['family']} ({e['owner']['name']})" for e in d["effects"])
    return "\n".join(
        [f"{case.name}: {d['verdict']}{': ' + named if named else ''}  [{d['seconds']:.1f} s]", *notes, *_next(d)]
    ), []


def _next(document: dict) -> list[str]:
    """What stays open, and what to record to decide it."""
    decides = "put it into the case and diagnose again"
    return [
        f"    open: {' or '.join(pair['families'])}. Record next: {_told(pair['record_next'])}; {decides}"
        for pair in document["ambiguous"]
    ]


def _told(record_next: str | dict) -> str:
    if isinstance(record_next, dict):
        x, y, z = record_next["position_m"]
        return f"sound with a node at ({x:g}, {y:g}, {z:g}) m"
    from gr_cast.report.link.page import EXPERIMENTS

    return EXPERIMENTS.get(record_next, record_next.replace("_", " "))


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="+", type=Path, metavar="CASE", help="folder with a twin.yaml, or with a place.yaml")
    parser.add_argument("--output", required=True, type=Path, metavar="DIR", help="one folder per case goes here")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="cases at the same time (default 1)")
    budget = "processor time per case (default 120, of a place 320)"
    parser.add_argument("--budget", type=float, metavar="SECONDS", help=budget)
    args = _program.parse(parser, argv)
    names = [case.resolve().name for case in args.cases]
    faults = [f"{name}: two cases have this name" for name in sorted({n for n in names if names.count(n) > 1})]
    if args.jobs < 1:
        faults.append(f"--jobs: got {args.jobs}, needs 1 or more")
    if args.budget is not None and not args.budget > 0:
        faults.append(f"--budget: got {args.budget}, needs more than 0 seconds")
    try:
        check_writable(args.output)
    except CastError as error:
        faults += error.faults
    if faults:
        raise CastError(*faults)
    refused, done = False, 0
    lost = lambda index: ("", [f"{args.cases[index]}: its process was killed (out of memory?)"])  # noqa: E731
    try:
        for _, (line, faults) in tasks.run(_one, (args.output, args.budget), args.cases, processes=args.jobs, lost=lost):
            done += 1
            for fault in faults:
                refused = True
                print(f"error: {fault}", file=sys.stderr, flush=True)
            if line:
                print(f"[{done}/{len(args.cases)}] {line}", flush=True)
    finally:
        sweep_dead(args.output)
    return 2 if refused else 0


if __name__ == "__main__":
    _program.run(main)
