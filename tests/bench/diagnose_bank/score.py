# SPDX-License-Identifier: GPL-3.0-or-later
"""Diagnoses against sealed truths: floors, figures per family and parameter, failures with reasons."""

import itertools
import json
import math
from collections import defaultdict
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize

STRONG = 100.0  # λ from which a cause must be found
SURE = 0.8  # confidence from which a statement is a confident one
NOISE_LIKE = {
    "noise_floor",
    "signal_dependent_noise",
    "impulsive_noise",
    "pulsed_interference",
    "narrowband_interference",
    "quantization",
}
EXACT = {"single": "one", "double": "two", "triple": "three"}
ABSTAINS = {"unexplained", "ambiguous"}


def read_diagnosis(folder):
    """diagnosis.json of a folder, or a diagnosis that says nothing, with the fault."""
    nothing = {"verdict": None, "effects": [], "ambiguous": [], "fit": {}}
    try:
        document = json.loads((Path(folder) / "diagnosis.json").read_text())
        return {**nothing, **document}, None
    except (OSError, ValueError) as error:
        return nothing, f"no diagnosis: {type(error).__name__}"


def _number(parameters, key, part="value"):
    entry = parameters.get(key)
    if isinstance(entry, dict) and "per_recording" in entry:
        values = [v.get(part) for v in entry["per_recording"].values()]
        values = [v for v in values if v is not None]
        return float(np.mean(values)) if values else None
    v = entry.get(part) if isinstance(entry, dict) else entry if part == "value" else None
    usable = isinstance(v, (int, float)) and not isinstance(v, bool) and math.isfinite(v)
    return float(v) if usable else None


# ---------------------------------------------------------------- which found effect is which true cause
def same_answer(found, true, truth):
    """The contract's equivalences."""
    if found["family"] == true["family"] or found["family"] in true["same_as"]:
        return True
    delay = _number(found["parameters"], "delay_s")
    if found["family"] != "extra_path" or delay is None:
        return False
    sample = 1 / truth["conditions"]["sample_rate_hz"]
    if "extra_path_within_sample" in true["same_as"]:
        return min(abs(delay - t) for t in truth["tap_delays_s"]) <= sample
    if "extra_path_at_tap" in true["same_as"]:
        moving = abs(_number(found["parameters"], "doppler_hz") or 0) > 0
        return moving and abs(delay - true["parameters"]["delay_s"]["value"]) <= sample
    return False


def pair_up(effects, truth):
    """[(found, true)] one to one, cheapest in all: the same family, owner and place first."""
    cost = np.full((len(effects), len(truth["effects"])), 1e3)
    for (i, found), (j, true) in itertools.product(enumerate(effects), enumerate(truth["effects"])):
        if not same_answer(found, true, truth):
            continue
        price = (found["family"] != true["family"]) + 0.5 * (found["owner"]["name"] not in true["owners_ok"])
        for key in ("delay_s", "frequency_hz", "time_s"):
            v, t = _number(found["parameters"], key), true["parameters"].get(key)
            if v is not None and t:
                price += min(0.4, abs(v - t["value"]) / (abs(t["value"]) + 1e-12))
        cost[i, j] = price
    rows, columns = linear_sum_assignment(cost) if cost.size else ((), ())
    return [(effects[i], truth["effects"][j]) for i, j in zip(rows, columns, strict=True) if cost[i, j] < 1e3]


def deviations(found, true):
    """{parameter: (error, z or None, counts for coverage)} for the numbers that both give."""
    out = {}
    for key, t in true["parameters"].items():
        v = _number(found["parameters"], key)
        if v is None:
            continue
        errors = [abs(v) - abs(r) if t["unsigned"] else v - r for r in [t["value"], *t["also"]]]
        if key.endswith("_rad"):
            errors = [math.remainder(e, 2 * math.pi) for e in errors]
        error = min(errors, key=abs)
        std = _number(found["parameters"], key, "std")
        out[key] = (error, error / std if std else None, t["z"])
    return out


def placed(found, true, truth):
    """{axis: bool}: the stated interval holds the true place, and is not too wide."""
    c, out = truth["conditions"], {}
    tolerance = {
        "time_s": 0.01 * c["duration_s"],
        "delay_s": 1 / c["sample_rate_hz"],
        "frequency_hz": 5 / c["duration_s"],
    }
    chip = max(4, 2 * c["samples_per_chip"]) / c["sample_rate_hz"]
    widest = {"time_s": 0.15 * c["duration_s"], "delay_s": chip, "frequency_hz": 0.05 * c["sample_rate_hz"]}
    for axis, (a, b) in true["where"].items():
        said = (found.get("where") or {}).get(axis)
        if not said or any(v is None for v in said) or said[0] > said[1]:
            out[axis] = False
            continue
        low, high = map(float, said)
        if b > a:
            overlap = max(0.0, min(b, high) - max(a, low)) / (max(b, high) - min(a, low))
            out[axis] = overlap >= (0.3 if axis == "delay_s" else 0.5)
            continue
        room = tolerance[axis]
        at_edge = axis == "time_s" and min(abs(low - a), abs(high - a)) <= room
        out[axis] = at_edge or (low - room <= a <= high + room and high - low <= widest[axis])
    return out


def removed_share(diagnosis, truth):
    """Share of the excess residual that the correction removed, blur allowed for; None: not to judge."""
    floor = np.mean([10 ** (f["noise_floor_db"] / 10) for f in truth["fit"]])
    twin = np.mean([10 ** (f["twin_nmse_db"] / 10) for f in truth["fit"]])
    blur = floor / math.sqrt(truth["conditions"]["samples"] * len(truth["fit"]) / 4)
    if NOISE_LIKE & {e["family"] for e in truth["effects"]} or twin - floor < 40 * blur:
        return None
    corrected = _number(diagnosis["fit"], "corrected_nmse_db")
    if corrected is None:
        return 0.0
    return 1 - (10 ** (corrected / 10) - floor) / (twin - floor) + 3 * blur / (twin - floor)


# ---------------------------------------------------------------- one case
def judge(name, truth, diagnosis, fault):
    """Everything that one case says about the tool, with the reasons of its failures."""
    kind, verdict, effects = truth["kind"], diagnosis["verdict"], diagnosis["effects"]
    row = {
        "case": name,
        "kind": kind,
        "verdict": verdict,
        "reasons": [fault] if fault else [],
        "calibration": [],
    }
    row["seconds"] = diagnosis.get("seconds")
    say = row["reasons"].append
    top = max((e["confidence"] for e in effects), default=0.0)
    if kind == "null":
        row["accused"] = verdict != "no_mismatch"
        row["found"] = [e["family"] for e in effects]
        row["calibration"] = [(e["confidence"], False) for e in effects]
        if row["accused"]:
            say(f"accused: {verdict} {_names(effects)}")
        return row
    if kind == "outside":
        wrong = [e for e in effects if e["family"] not in truth["tolerated"]]
        sure = max((e["confidence"] for e in wrong), default=0.0)
        row["abstained"] = verdict in ABSTAINS or (verdict == "identified" and sure < 0.5)
        row["calibration"] = [(e["confidence"], e not in wrong) for e in effects]
        if not row["abstained"]:
            say(f"{truth['effects'][0]['family']} passed for {verdict} {_names(effects)}")
        return row
    if kind == "ambiguous":
        wanted = truth["ambiguous"]
        said = any(
            set(s) <= set(a["families"]) and len(a["families"]) <= len(s) + 1 and a["record_next"] in wanted["record_next"]
            for a in diagnosis["ambiguous"]
            for s in wanted["family_sets"]
        )
        row["undecided"] = verdict == "ambiguous" and said
        row["cocksure"] = verdict == "identified" and top >= SURE
        if not row["undecided"]:
            heard = "; ".join(f"{a['families']} → {a['record_next']}" for a in diagnosis["ambiguous"])
            say(f"should be undecided between {wanted['family_sets']}: {verdict} {_names(effects)} {heard}")
        return row
    pairs = pair_up(effects, truth)
    row["causes"], row["found"] = [], [(e["family"], any(e is f for f, _ in pairs)) for e in effects]
    row["calibration"] = [(e["confidence"], ok) for e, (_, ok) in zip(effects, row["found"], strict=True)]
    for true in truth["effects"]:
        found = next((f for f, t in pairs if t is true), None)
        row["causes"].append(_judge_cause(true, found, truth, say))
    row["strong"] = all(t["lambda"] >= STRONG for t in truth["effects"])
    row["exact"] = verdict == "identified" and len(pairs) == len(effects) == len(truth["effects"])
    extra = [e for e in effects if not any(e is f for f, _ in pairs)]
    if extra:
        say(f"not there: {_names(extra)}")
    if verdict != "identified":
        say(f"verdict {verdict}")
    if row["strong"]:
        row["removed"] = removed_share(diagnosis, truth)
        if row["removed"] is not None and row["removed"] < 0.95:
            say(f"only {100 * row['removed']:.0f} % of the excess residual removed")
    return row


def _names(effects):
    return ", ".join(f"{e['family']} ({e['owner']['name']}, {e['confidence']:.2f})" for e in effects)


def _judge_cause(true, found, truth, say):
    cause = {
        "family": true["family"],
        "lambda": true["lambda"],
        "hit": found is not None,
        "deviations": {},
        "placed": {},
    }
    cause["owner_right"] = found is not None and found["owner"]["name"] == true["owner"]["name"]
    if found is None:
        say(f"missed: {true['family']} λ={true['lambda']:.0f}")
        cause["placed"] = {axis: False for axis in true["where"]}
        return cause
    if truth["network"] and not cause["owner_right"]:
        say(f"owner of {true['family']}: {found['owner']['name']}, is {true['owner']['name']}")
    cause["placed"] = placed(found, true, truth)
    for axis in [a for a, ok in cause["placed"].items() if not ok]:
        say(f"{true['family']}: {axis} {(found.get('where') or {}).get(axis)}, is {true['where'][axis]}")
    if found["family"] == true["family"]:
        cause["deviations"] = deviations(found, true)
        for key, (error, z, counts) in cause["deviations"].items():
            if counts and (z is None or abs(z) > 3):
                far = "no std" if z is None else f"z = {z:.1f}"
                say(f"{true['family']}.{key}: off by {error:.3g}, {far}")
    return cause


# ---------------------------------------------------------------- all cases
def half_recall_lambda(lambdas, hits):
    """λ at half recall: logistic regression on log λ (weak ridge)."""
    x, y = np.log10(np.maximum(lambdas, 1e-3)), np.asarray(hits, float)
    if len(y) < 12 or y.all() or not y.any():
        return None

    def loss(w):
        u = w[0] + w[1] * (x - 2)
        return np.sum(np.logaddexp(0, u) - y * u) + 5e-3 * w @ w

    w = minimize(loss, [0.0, 1.0]).x
    return float(10 ** (2 - w[0] / w[1])) if w[1] > 0 else None


def calibration_error(pairs, bins=10):
    """Σ share·|mean confidence − share right| over ten bins (Guo et al., ICML 2017)."""
    pairs = np.asarray(pairs, float).reshape(-1, 2)
    index = np.minimum((pairs[:, 0] * bins).astype(int), bins - 1)
    gaps = [pairs[index == k] for k in range(bins)]
    return float(sum(len(g) * abs(g[:, 0].mean() - g[:, 1].mean()) for g in gaps if len(g)) / max(len(pairs), 1))


def _mean(values):
    values = [v for v in values if v is not None]
    return (float(np.mean(values)) if values else None), len(values)


def summarise(rows):
    """Floors, families and parameters of judged cases."""
    of = lambda kind: [r for r in rows if r["kind"] == kind]  # noqa: E731
    caused = [r for r in rows if "causes" in r]
    causes = [c for r in caused for c in r["causes"]]
    strong = [c for c in causes if c["lambda"] >= STRONG]
    found = [ok for r in caused for _, ok in r["found"]] + [False for r in of("null") for _ in r["found"]]
    counted = [d for c in causes for d in c["deviations"].values() if d[2]]
    zs = np.array([d[1] if d[1] is not None else np.inf for d in counted])
    rms = float(np.sqrt(np.mean(np.clip(zs, -50, 50) ** 2))) if len(zs) else None
    calibration = [p for r in rows for p in r["calibration"]]
    seconds = [r["seconds"] for r in rows if r["seconds"] is not None]
    owners = {n: [c["owner_right"] for r in of("network") if len(r["causes"]) == n for c in r["causes"]] for n in (1, 2)}
    half = half_recall_lambda([c["lambda"] for c in causes], [c["hit"] for c in causes])
    floors = []

    def add(metric, value_and_count, floor, sense):
        value, count = value_and_count
        kept = {
            "≥": lambda: value >= floor,
            "≤": lambda: value <= floor,
            "in": lambda: floor[0] <= value <= floor[1],
        }
        met = None if value is None else bool(kept[sense]())
        floors.append({"metric": metric, "value": value, "floor": floor, "sense": sense, "count": count, "met": met})

    add("no-mismatch cases wrongly accused", _mean([r["accused"] for r in of("null")]), 0.02, "≤")
    for kind, floor in zip(EXACT, (0.92, 0.85, 0.72), strict=True):
        add(
            f"exact set, λ ≥ 100, {EXACT[kind]}",
            _mean([r["exact"] for r in of(kind) if r["strong"]]),
            floor,
            "≥",
        )
    add("recall, λ ≥ 100", _mean([c["hit"] for c in strong]), 0.95, "≥")
    add("precision", _mean(found), 0.92, "≥")
    add("λ at half recall", (half, len(causes)), 40.0, "≤")
    add("parameters: RMS z", (rms, len(zs)), 1.2, "≤")
    add("parameters: 95 % coverage", _mean(list(np.abs(zs) <= 1.96)), (0.90, 0.98), "in")
    removed = [r["removed"] for r in caused if r.get("removed") is not None]
    add("≥ 95 % of the excess residual removed", _mean([s >= 0.95 for s in removed]), 0.95, "≥")
    add("outside the list: flagged", _mean([r["abstained"] for r in of("outside")]), 0.85, "≥")
    add("undecidable: says so, right experiment", _mean([r["undecided"] for r in of("ambiguous")]), 0.85, "≥")
    add("undecidable: confidently wrong", _mean([r["cocksure"] for r in of("ambiguous")]), 0.05, "≤")
    add("owner in a network, one cause", _mean(owners[1]), 0.95, "≥")
    add("owner in a network, two causes", _mean(owners[2]), 0.85, "≥")
    add("place of the mismatch", _mean([ok for c in strong for ok in c["placed"].values()]), 0.90, "≥")
    add(
        "expected calibration error",
        (calibration_error(calibration) if calibration else None, len(calibration)),
        0.07,
        "≤",
    )
    add("seconds per case, largest", (max(seconds, default=None), len(seconds)), 300.0, "≤")
    return {
        "floors": floors,
        "families": _families(causes, rows),
        "parameters": _parameters(causes),
        "failures": [{k: r[k] for k in ("case", "kind", "reasons")} for r in rows if r["reasons"]],
    }


def _families(causes, rows):
    table = defaultdict(lambda: {"true": 0, "hit": 0, "found": 0, "right": 0})
    for c in causes:
        if c["lambda"] >= STRONG:
            table[c["family"]]["true"] += 1
            table[c["family"]]["hit"] += c["hit"]
    for row in rows:
        for item in row.get("found", []):
            family, ok = item if isinstance(item, tuple) else (item, False)
            table[family]["found"] += 1
            table[family]["right"] += ok
    return dict(sorted(table.items()))


def _parameters(causes):
    table = defaultdict(list)
    for c in causes:
        for key, (_, z, counts) in c["deviations"].items():
            if counts and z is not None:
                table[f"{c['family']}.{key}"].append(z)
    return {
        key: {
            "count": len(z),
            "rms_z": float(np.sqrt(np.mean(np.clip(z, -50, 50) ** 2))),
            "coverage": float(np.mean(np.abs(z) <= 1.96)),
        }
        for key, z in sorted(table.items())
    }


def score(diagnoses, truths):
    """All truths of a folder against the diagnoses of another; a missing diagnosis fails its case."""
    rows = []
    for path in sorted(Path(truths).glob("*.json")):
        diagnosis, fault = read_diagnosis(Path(diagnoses) / path.stem)
        rows.append(judge(path.stem, json.loads(path.read_text()), diagnosis, fault))
    return {"cases": len(rows), **summarise(rows)}


# ---------------------------------------------------------------- as Markdown
def _text(v):
    return "–" if v is None else f"{v:.3g}"


def markdown(result):
    lines = [f"{result['cases']} cases", "", "| | value | floor | of | |", "|---|---|---|---|---|"]
    for f in result["floors"]:
        floor = f"{f['floor'][0]}–{f['floor'][1]}" if f["sense"] == "in" else f"{f['sense']} {f['floor']:g}"
        met = {True: "met", False: "**missed**", None: ""}[f["met"]]
        lines.append(f"| {f['metric']} | {_text(f['value'])} | {floor} | {f['count']} | {met} |")
    lines += ["", "| family | recall, λ ≥ 100 | of | precision | of |", "|---|---|---|---|---|"]
    for name, f in result["families"].items():
        recall, precision = (
            f["hit"] / f["true"] if f["true"] else None,
            f["right"] / f["found"] if f["found"] else None,
        )
        lines.append(f"| {name} | {_text(recall)} | {f['true']} | {_text(precision)} | {f['found']} |")
    lines += ["", "| parameter | of | RMS z | 95 % coverage |", "|---|---|---|---|"]
    lines += [f"| {k} | {p['count']} | {_text(p['rms_z'])} | {_text(p['coverage'])} |" for k, p in result["parameters"].items()]
    lines += ["", f"{len(result['failures'])} cases with a fault", ""]
    lines += [f"- {f['case']} ({f['kind']}): {'; '.join(f['reasons'])}" for f in result["failures"]]
    return "\n".join(lines) + "\n"
