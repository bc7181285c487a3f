#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Diagnose real recordings and set what the program says beside what independent analysis found.

The table names for every case the NMSE on unseen samples with its bar, the time, the memory, and everything that the
truth asks for and is not there, or forbids and is claimed. Exit status 1 where a bar is missed. With --damage the
recordings are damaged in known ways first: the damage must then be named too, with its size.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import real_damage

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "apps" / "cast_diagnose.py"


def _values(parameter) -> dict[str, float]:
    """{recording: value} of a reported parameter; a common value stands under the empty name."""
    if isinstance(parameter, dict) and "per_recording" in parameter:
        return {name: float(v["value"]) for name, v in parameter["per_recording"].items()}
    return {"": float(parameter["value"] if isinstance(parameter, dict) else parameter)}


def miss(effect: dict, wanted: dict) -> list[str]:
    """What keeps a reported effect from being a wanted one of the truth; empty where it is."""
    faults = []
    whose = effect["owner"]
    if wanted.get("owner") and whose["name"] != wanted["owner"]:
        faults.append(f"owner {whose['name']}, not {wanted['owner']}")
    for name, limit in wanted.get("parameters", {}).items():
        found = effect["parameters"].get(name)
        if isinstance(limit, dict):  # a range for each side that may own it
            limit = limit[whose["level"]]
        if not isinstance(limit, list):
            if found != limit:
                faults.append(f"{name} {found}, not {limit}")
        elif found is None:
            faults.append(f"no {name}")
        else:
            faults += [f"{name} {v:.5g} outside {limit}" for v in _values(found).values() if not limit[0] <= v <= limit[1]]
    for recording, value in wanted.get("per_recording", {}).items():
        values = _values(effect["parameters"]["offset_hz"])
        off = values.get(recording, values.get("", float("nan"))) - value
        if not abs(off) <= wanted["tolerance_hz"]:
            faults.append(f"{recording} {off:+.0f} Hz from the truth")
    return faults


def judge(document: dict, truth: dict) -> list[str]:
    """Every way in which a diagnosis differs from the truth of a real recording; empty where it does not."""
    faults = []
    if document["verdict"] not in truth["verdict"]:
        faults.append(f"verdict {document['verdict']}")
    for wanted in truth["must_find"]:
        near = [miss(e, wanted) for e in document["effects"] if e["family"] in wanted["families"]]
        best = min(near, key=len, default=["missing"])
        faults += [f"{'/'.join(wanted['families'])}: {fault}" for fault in best]
    faults += [f"claims {e['family']}" for e in document["effects"] if e["family"] in truth["must_not_claim"]]
    if "left_time_s" in truth:
        told = [w["time_s"] for w in document["residual"]["where"] if "time_s" in w]
        if not any(a < high and low < b for a, b in told for low, high in truth["left_time_s"]):
            faults.append("what is wrong of the waveform is not placed")
    if truth["beat_db"] is not None and not document["fit"]["corrected_nmse_db"] < truth["beat_db"]:
        faults.append(f"NMSE {document['fit']['corrected_nmse_db']:.1f} dB, bar {truth['beat_db']:.1f}")
    return faults


def diagnose(case: Path, output: Path, budget_s: float) -> tuple[dict | None, float, float]:
    """(document, seconds, MB of the largest process) of one case, diagnosed by the program."""
    begun = time.monotonic()
    process = subprocess.Popen([PROGRAM, case, "--output", output, "--budget", str(budget_s)], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    path = output / case.name / "diagnosis.json"
    document = json.loads(path.read_text()) if process.returncode == 0 else None
    return document, time.monotonic() - begun, usage.ru_maxrss / 1024


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="CASE", help="names of cases (default: all that have a truth)")
    data = Path(os.environ.get("CAST_DATA", ROOT.parent / "shared"))
    parser.add_argument("--data", type=Path, default=data, help="folder with real/ and real-truth/")
    parser.add_argument("--output", type=Path, default=ROOT / "build" / "real", metavar="DIR", help="default build/real")
    parser.add_argument(
        "--damage", nargs="+", default=[], choices=sorted(real_damage.DAMAGES), metavar="KIND", help="a line for each damage"
    )
    parser.add_argument("--budget", type=float, default=240.0, metavar="SECONDS", help="of one case (default 240)")
    args = parser.parse_args(argv)
    truths = {p.stem: json.loads(p.read_text()) for p in sorted((args.data / "real-truth").glob("*.json"))}
    if not truths:
        parser.error(f"{args.data}/real-truth: no truths there")
    unknown = set(args.names) - set(truths)
    if unknown:
        parser.error(f"{', '.join(sorted(unknown))}: no truth of that name, there are {', '.join(truths)}")
    print(f"{'case':28}{'verdict':14}{'twin':>7}{'NMSE':>7}{'bar':>7}{'floor':>7}{'time':>8}{'memory':>9}", flush=True)
    wrong = 0
    cases = [(args.data / "real" / name, truths[name]) for name in args.names or truths]
    if args.damage:
        args.output.mkdir(parents=True, exist_ok=True)
        whole, cases = cases, []
        for case, truth in whole:
            for kind in args.damage:
                folder = args.output / f"{case.name}_{kind}"
                if why := real_damage.invisible(case, kind):
                    print(f"{folder.name} cannot be seen: {why}")
                else:
                    cases.append((folder, real_damage.damage(case, truth, kind, folder)))
    for case, truth in cases:
        name = case.name
        document, seconds, megabytes = diagnose(case, args.output / "diagnoses", args.budget)
        if document is None:
            print(f"{name:28}no diagnosis{seconds:41.0f} s{megabytes:6.0f} MB", flush=True)
            wrong += 1
            continue
        fit, faults = document["fit"], judge(document, truth)
        wrong += bool(faults)
        shown = (fit["twin_nmse_db"], fit["corrected_nmse_db"], truth["beat_db"])
        figures = "".join(f"{'-':>7}" if v is None else f"{v:7.1f}" for v in shown)
        figures += f"{fit['noise_floor_db']:7.1f}"
        print(f"{name:28}{document['verdict']:14}{figures}{seconds:6.0f} s{megabytes:6.0f} MB")
        for effect in document["effects"]:
            nats = effect["evidence"]["heldout_gain_nats"]
            held = "not held out" if nats is None else f"{nats:.0f} nats"  # None where the time ran out
            print(f"  {effect['family']} ({effect['owner']['name']}) {held}: {effect['sentence']}")
        print("".join(f"  MISSED {fault}\n" for fault in faults), end="", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
