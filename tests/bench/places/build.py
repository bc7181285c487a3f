#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw sealed place cases with a tracer that is not the tool's own: DIR/places/<case>/ and DIR/truth/<case>.json."""

import argparse
import hashlib
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import beyond
import campaign as campaigns
import cases
import numpy as np
import power_cases
import puzzles
import truths
import yaml
from causes import RESPONSE, Unfit

TRIES = 400
COUNTS = {"single": 1, "double": 2, "triple": 3}


def write_obj(path, objects):
    lines, first = ["# metres, z up"], 1
    for name, thing in objects.items():
        corners, index = np.unique(np.round(thing["tris"].reshape(-1, 3), 6), axis=0, return_inverse=True)
        lines.append(f"o {name}")
        lines += ["v {:.9g} {:.9g} {:.9g}".format(*c) for c in corners]
        lines += ["f {} {} {}".format(*(t + first)) for t in index.reshape(-1, 3)]
        first += len(corners)
    path.write_text("\n".join(lines) + "\n")


def spec_of(w, kind):
    """The twin as a SPEC."""
    materials = {}
    for name in w["objects"]:
        own = w["media"].get(name)
        materials[name] = {"material": w["materials"][name], **own} if own else w["materials"][name]
    nodes = {}
    for name, n in w["nodes"].items():
        still = len(n["waypoints_m"]) == 1
        where = (
            {"position_m": n["waypoints_m"][0]}
            if still
            else {"waypoints_m": n["waypoints_m"], "speed_m_per_s": n["speed_m_per_s"]}
        )
        turn = {"orientation_rad": n["orientation_rad"]} if any(n["orientation_rad"]) else {}
        nodes[name] = {**where, "antenna": n["antenna"], **turn}
    return {
        "cast_create": 1,
        "id": "place",
        "environment": {"place": f"a {kind}", "carrier_hz": w["carrier_hz"], "bandwidth_hz": w["bandwidth_hz"]},
        "model": {"mesh": "mesh.obj"},
        "materials": materials,
        "nodes": nodes,
        "sampling": {"duration_s": w["duration_s"], "step_s": 0.1, "max_depth": w["max_depth"], "refraction": w["refraction"]},
    }


def write_case(folder, case, soundings):
    folder.mkdir(parents=True)
    write_obj(folder / "mesh.obj", case["twin"]["objects"])
    text = yaml.safe_dump(truths.plain(spec_of(case["twin"], case["first"].kind)), sort_keys=False, default_flow_style=None)
    (folder / "spec.yaml").write_text(text)
    entries = []
    for name, arrays, use in soundings:
        np.savez_compressed(folder / name, **arrays)
        entries.append({"file": name, "kind": "power" if "power_db" in arrays else "response", **use})
    place = {"cast_place": 1, "twin": "spec.yaml", "soundings": entries, "unknown": case["first"].unknown}
    (folder / "place.yaml").write_text(yaml.safe_dump(place, sort_keys=False, default_flow_style=None))


def response_soundings(rng, case):
    """The two campaigns as files, and what twin and truth leave in the vault."""
    first, noise = case["first"], case["noise"]
    vault = replace(case["vault"], unknown=first.unknown)
    level = np.full(len(vault.links), np.exp(np.mean(np.log(noise))))
    out = []
    changes = case.get("change") or (None, None)
    for name, c, var, use, change in (
        ("first.npz", first, noise, {}, changes[0]),
        ("second.npz", vault, level, {"use": "vault"}, changes[1]),
    ):
        y = campaigns.sounded(rng, case["world"], c, var, change)
        if case.get("gaps"):
            y[rng.random(y.shape[:2]) < case["gaps"]] = np.nan
        tx, rx = (np.array(x) for x in zip(*c.links, strict=True))
        arrays = {"tx": tx, "rx": rx, "time_s": c.time_s, "frequency_hz": c.frequency_hz, "response": y, "noise_power": var}
        out.append((name, arrays, use))
    y = out[1][1]["response"].astype(complex)
    kept = {
        "twin": campaigns.left(case["twin"], y, vault, level),
        "true": campaigns.left(case["world"], y, vault, level),
        "n": int(np.isfinite(y).sum()),
    }
    return out, kept


def draw(kind, rng, family=None):
    """One case of a kind, drawn again until it fits; the families asked for give way when none does."""
    for attempt in range(TRIES):
        try:
            if kind == "null":
                return cases.clean(rng)
            if kind in COUNTS:
                return cases.concealed(rng, _families(rng, COUNTS[kind], family if attempt < TRIES // 2 else None))
            if kind == "power":
                return power_cases.draw(rng, family if attempt < TRIES // 2 else "any")
            if kind == "ambiguous":
                return puzzles.draw(rng, family if attempt < TRIES // 2 else "any")
            return beyond.draw(rng, family if attempt < TRIES // 2 else "any")
        except (Unfit, ValueError):
            continue
    raise SystemExit(f"error: no {kind} case after {TRIES} draws")


def _families(rng, count, first):
    names = sorted(RESPONSE)
    chosen = [first or names[rng.integers(len(names))]]
    while len(chosen) < count:
        other = names[rng.integers(len(names))]
        if other not in chosen or other in ("material", "node_gain", "node_position", "missing_object"):
            chosen.append(other)
    return chosen


def make(kind, seed, family, output):
    """Draw, write and seal one case; what was left unfinished is made again."""
    rng = np.random.default_rng(seed)
    name = "place_" + hashlib.sha256(repr(seed).encode()).hexdigest()[:12]
    if (output / "truth" / f"{name}.json").exists():
        return name, None
    case = draw(kind, rng, family)
    if kind in (*COUNTS, "null") and rng.random() < 0.08:
        case["gaps"] = 0.03
    soundings, kept = case["soundings"](rng) if "soundings" in case else response_soundings(rng, case)
    truth = {
        "kind": kind,
        "ambiguous": case.get("ambiguous"),
        "tolerated": case.get("tolerated", []),
        "record": None,
        "case": name,
        "case_dir": f"../places/{name}",
        "effects": case["effects"],
        "conditions": cases.conditions(case),
    }
    truth |= {"vault": kept} if kept and kind != "outside" else {}
    for key in ("outside", "hypotheses"):
        truth |= {key: case[key]} if key in case else {}
    if kind in (*COUNTS, "null"):
        truth["world"] = case["world"]
    folder = output / "places" / name
    if folder.exists():
        for old in folder.iterdir():
            old.unlink()
        folder.rmdir()
    write_case(folder, case, soundings)
    (output / "truth").mkdir(exist_ok=True)
    (output / "truth" / f"{name}.json").write_text(json.dumps(truths.plain(truth)))
    return name, truth


def plan(args):
    """[(kind, seed, family)]: the kinds asked for, families in turn."""
    rng = np.random.default_rng([args.seed, 7])
    names = [n for _ in range(args.cases // len(RESPONSE) + 1) for n in rng.permutation(sorted(RESPONSE))]
    kinds = ["single"] * (args.cases - args.cases // 2) + ["double"] * (args.cases // 2 - args.cases // 5)
    kinds += ["triple"] * (args.cases - len(kinds))
    rows = list(zip([kinds[k] for k in rng.permutation(len(kinds))], map(str, names), strict=False))
    turns = {"null": (None,), "power": power_cases.FAMILIES, "ambiguous": puzzles.NAMES, "outside": beyond.FAMILIES}
    for kind, options in turns.items():
        count = getattr(args, "nulls" if kind == "null" else kind)
        order = rng.permutation(len(options))
        rows += [(kind, options[order[k % len(options)]]) for k in range(count)]
    return [(kind, [args.seed, index], family) for index, (kind, family) in enumerate(rows)]


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=100, metavar="N", help="with one, two or three causes (default 100)")
    for kind in ("nulls", "power", "ambiguous", "outside"):
        parser.add_argument(f"--{kind}", type=int, default=0, metavar="N", help=f"so many more: {kind} (default 0)")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of all that is drawn (default 1)")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR")
    args = parser.parse_args(argv)
    if min(args.cases, args.nulls, args.power, args.ambiguous, args.outside) < 0:
        parser.error("numbers of cases: need 0 or more")
    args.output.mkdir(parents=True, exist_ok=True)
    rows = plan(args)
    for index, (kind, seed, family) in enumerate(rows):
        begin = time.monotonic()
        name, truth = make(kind, seed, family, args.output)
        said = "kept" if truth is None else ", ".join(f"{e['family']} {e['lambda']:.0f}" for e in truth["effects"]) or "nothing"
        print(f"[{index + 1}/{len(rows)}] {name} {kind}: {said} ({time.monotonic() - begin:.1f} s)", flush=True)
    digest = hashlib.sha256()
    for path in sorted((args.output / "truth").glob("*.json")):
        digest.update(path.name.encode() + path.read_bytes())
    print(f"sealed: {digest.hexdigest()}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
