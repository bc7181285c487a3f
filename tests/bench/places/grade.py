# SPDX-License-Identifier: GPL-3.0-or-later
"""Place diagnoses against the sealed truths: the floors, families, and every failure with its reason."""

import json
from pathlib import Path

import numpy as np
import recompute
from slabs import C_M_PER_S

STRONG, SURE = 100.0, 0.8
DRIFTING = ("missing_scattering", "moving_scatterer", "small_scale", "meter_limits")  # no spec holds them


def read(folder):
    """(diagnosis, fault)."""
    try:
        d = json.loads((Path(folder) / "diagnosis.json").read_text())
        assert d["verdict"] in ("no_mismatch", "identified", "ambiguous", "unexplained"), "verdict"
        for e in d.setdefault("effects", []):
            assert 0 <= float(e["confidence"]) <= 1 and isinstance(e["owner"]["name"], str), "effect"
            e.setdefault("parameters", {})
        d.setdefault("ambiguous", [])
        return d, None
    except (OSError, ValueError, KeyError, TypeError, AssertionError) as error:
        return {"verdict": None, "effects": [], "ambiguous": []}, f"{type(error).__name__} {error}"


def number(effect, key, part="value"):
    """A parameter as an array, None where it is not given."""
    p = effect["parameters"].get(key)
    try:
        x = np.array(p.get(part), float)
    except (AttributeError, TypeError, ValueError):
        return None
    return x if np.isfinite(x).all() else None


def fits(found, true):
    """Whether a finding names a true cause: family or its equal, and an owner that may be named."""
    same = found["family"] == true["family"]
    if found["owner"]["name"] not in true["owners_ok"]:
        return same and found["owner"].get("level") == "place" == true["owner"]["level"]
    level = f"{found['family']}:{found['owner'].get('level', '')}"
    return same or found["family"] in true["same_as"] or level in true["same_as"]


def plane(found, true):
    """(distance in m, angle in degrees, distance over its stated deviation) of a missing object's nearest true face."""
    p, n, sd = number(found, "point_m"), number(found, "normal"), number(found, "point_m", "std")
    if p is None or n is None or p.shape != (3,) or n.shape != (3,) or not true.get("targets"):
        return None
    best = None
    for t in true["targets"]:
        m = np.array(t["normal"], float)
        far, turn = abs((p - t["point_m"]) @ m), np.degrees(np.arccos(np.clip(abs(n @ m) / np.linalg.norm(n), 0, 1)))
        z = far / np.linalg.norm(m * sd) if sd is not None and np.any(m * sd) else None
        if best is None or far + turn / 10 < best[0] + best[1] / 10:
            best = (float(far), float(turn), z)
    return best


def errors(found, true):
    """[(name, size of the error, size of the truth, [error over deviation])] of judged parameters."""
    out = []
    for key, t in true["parameters"].items():
        v, sd, ref = number(found, key), number(found, key, "std"), np.array(t["value"], float)
        if not t["z"] or v is None or v.shape != ref.shape:
            continue
        e = v - ref
        if "along" in t:
            along = np.array(t["along"])
            e, sd = np.atleast_1d(e @ along), None if sd is None else np.atleast_1d(np.linalg.norm(along * sd))
        elif "axes" in t:
            e, sd = e[t["axes"]], sd if sd is None or sd.ndim == 0 else sd[t["axes"]]
        z = [] if sd is None or np.any(sd <= 0) else np.atleast_1d(e / sd).tolist()
        out.append((key, float(np.linalg.norm(e)), float(np.linalg.norm(ref)), z))
    return out


def grade(diagnoses, truths):
    """{"floors": [(name, value, bound, above, n)], "families": …, "failures": [(case, reason)]}."""
    tallies, families, failures, cal = {}, {}, [], []

    def tally(key, good):
        tallies.setdefault(key, []).append(good)

    for path in sorted(Path(truths).glob("*.json")):
        t = json.loads(path.read_text())
        d, fault = read(Path(diagnoses) / path.stem)
        top = max((float(e["confidence"]) for e in d["effects"]), default=0.0)
        said = f"{d['verdict']}: " + (", ".join(f"{e['family']} of {e['owner']['name']}" for e in d["effects"]) or "nothing")
        tally("missing or malformed", bool(fault))
        tally("seconds", float(d.get("seconds", np.nan)))
        good = True
        if not t["effects"]:
            good = not d["effects"] and d["verdict"] == "no_mismatch"
            tally("null", not good)
            cal += [(float(e["confidence"]), False) for e in d["effects"]]
        elif t["kind"] == "outside":
            good = d["verdict"] in ("unexplained", "ambiguous")
            wrong = [e for e in d["effects"] if e["family"] not in t["tolerated"]]
            tally("outside flagged", good or top < 0.5)
            tally("outside wrong", d["verdict"] == "identified" and top >= SURE)
            cal += [(float(e["confidence"]), False) for e in wrong]
        elif t["kind"] == "ambiguous":
            good = _ambiguous(t, d, truths, top, tally)
        else:
            good = _causes(t, d, Path(diagnoses) / path.stem, truths, tally, families, cal)
        if fault or not good:
            true = ", ".join(f"{e['family']} of {e['owner']['name']} ({e['lambda']:.0f})" for e in t["effects"])
            failures.append((path.stem, t["kind"], true or "nothing", fault or said))
    return {"cases": sum(1 for _ in Path(truths).glob("*.json")), "floors": _floors(tallies, cal, families),
            "families": families, "failures": failures}  # fmt: skip


def _ambiguous(t, d, truths, top, tally):
    sets = [set(s) for s in t["ambiguous"]["family_sets"]]
    right = [a for a in d["ambiguous"] if any(s <= set(a["families"]) and len(a["families"]) <= len(s) + 1 for s in sets)]
    good = d["verdict"] == "ambiguous" and bool(right)
    tally("ambiguous right", good)
    tally("ambiguous wrong", d["verdict"] == "identified" and top >= SURE)
    case = Path(truths) / t["case_dir"]
    nats = [recompute.separation(t, case, a.get("record_next"), t["ambiguous"]["record_words"]) for a in right]
    tally("record_next", max(nats, default=0) >= 10)
    return good


def _causes(t, d, folder, truths, tally, families, cal):
    """Findings against one to three true causes; True if the set is exact."""
    pairs, left = [], list(t["effects"])
    for e in sorted(d["effects"], key=lambda e: -float(e["confidence"])):
        options = [true for true in left if fits(e, true)]
        options.sort(key=lambda true, e=e: (e["family"] != true["family"], (plane(e, true) or (9,))[0]))
        if options:
            pairs.append((e, options[0]))
            left.remove(options[0])
        row = families.setdefault(e["family"], [0, 0, 0, 0])
        row[2] += 1
        row[3] += bool(options)
        cal.append((float(e["confidence"]), bool(options)))
    exact = not left and len(pairs) == len(d["effects"]) and d["verdict"] == "identified"
    strong = all(e["lambda"] >= STRONG for e in t["effects"])
    if strong:
        tally(f"exact {t['kind']}", exact)
    for true in t["effects"]:
        found = next((e for e, q in pairs if q is true), None)
        tally("halves", (true["lambda"], found is not None))
        if true["lambda"] < STRONG:
            continue
        row = families.setdefault(true["family"], [0, 0, 0, 0])
        row[0] += found is not None
        row[1] += 1
        _sizes(t, true, found, tally)
    if strong and t["kind"] != "power" and not any(e["family"] in DRIFTING for e in t["effects"]):
        share = recompute.excess_removed(t, Path(truths) / t["case_dir"], folder, d)
        if share is not None:
            tally("removed", share >= 0.9)
    return exact or not strong


def _sizes(t, true, found, tally):
    same = found is not None and found["family"] == true["family"]
    if true["family"] == "missing_object":
        shown = (true["reflected_nats"] or 0) >= max(100, 0.2 * true["lambda"]) and (true["plane_nats"] or 0) >= 20
        p = plane(found, true) if same else None
        if shown:
            reach = max(0.15, 0.15 * C_M_PER_S / t["conditions"]["bandwidth_hz"])
            tally("plane", bool(p and p[0] <= reach and p[1] <= 5))
        if p and p[2] is not None:
            tally("covered", abs(p[2]) <= 1.96)
        return
    rows = errors(found, true) if same else []
    if true["family"] in ("node_position", "object_moved"):
        tally("offset", any(k == "offset_m" and e <= max(0.03, 0.3 * size) for k, e, size, _ in rows))
    for _, _, _, z in rows:
        for x in z:
            tally("covered", abs(x) <= 1.96)


def _floors(tallies, cal, families):
    mean = {k: (float(np.mean(v)), len(v)) for k, v in tallies.items() if k not in ("halves", "seconds")}
    hits, truths, found, right = (sum(r[i] for r in families.values()) for i in range(4))
    mean["recall"] = (hits / truths, truths) if truths else (None, 0)
    mean["precision"] = (right / found, found) if found else (None, 0)
    bins = [[o for c, o in cal if min(int(c * 10), 9) == k] for k in range(10)]
    stated = [[c for c, o in cal if min(int(c * 10), 9) == k] for k in range(10)]
    off = sum(len(b) * abs(np.mean(b) - np.mean(s)) for b, s in zip(bins, stated, strict=True) if b)
    mean["calibration"] = (off / len(cal), len(cal)) if cal else (None, 0)
    mean["half"] = (_half(tallies.get("halves", [])), len(tallies.get("halves", [])))
    seconds = [s for s in tallies.get("seconds", []) if np.isfinite(s)]
    mean["seconds"] = (max(seconds), len(seconds)) if seconds else (None, 0)
    rows = [
        ("nothing wrong, wrongly accused", "null", 0.02, False),
        ("exact set of causes, one", "exact single", 0.85, True),
        ("exact set of causes, two", "exact double", 0.70, True),
        ("exact set of causes, three", "exact triple", 0.50, True),
        ("exact set of causes, power alone", "exact power", 0.75, True),
        ("recall", "recall", 0.88, True),
        ("precision", "precision", 0.90, True),
        ("λ at half recall", "half", 80, False),
        ("missing object: its plane", "plane", 0.75, True),
        ("node and moved object: offset", "offset", 0.80, True),
        ("95 % intervals cover (at most 0.98)", "covered", 0.90, True),
        ("≥ 90 % of the excess removed on the vault", "removed", 0.85, True),
        ("outside the list: flagged", "outside flagged", 0.80, True),
        ("outside the list: confidently wrong", "outside wrong", 0.08, False),
        ("undecidable: says so", "ambiguous right", 0.78, True),
        ("undecidable: confidently wrong", "ambiguous wrong", 0.05, False),
        ("`record_next` separates by ≥ 10 nats", "record_next", 0.75, True),
        ("calibration error of confidence", "calibration", 0.08, False),
        ("slowest case, s", "seconds", 300, False),
        ("missing or malformed diagnoses", "missing or malformed", 0.0, False),
    ]
    return [(name, *mean.get(key, (None, 0)), bound, above) for name, key, bound, above in rows]


def _half(rows):
    """Strength at which half of the causes are found: a logistic line through hits over log strength."""
    if len(rows) < 12 or len({h for _, h in rows}) < 2:
        return None
    x, y = np.log10([r[0] for r in rows]), np.array([r[1] for r in rows], float)
    middle, b = x.mean(), np.zeros(2)
    a = np.stack([np.ones_like(x), x - middle], 1)
    for _ in range(50):
        p = 1 / (1 + np.exp(-np.clip(a @ b, -30, 30)))
        b = b + np.linalg.solve((a.T * (p * (1 - p))) @ a + 0.01 * np.eye(2), a.T @ (y - p) - 0.01 * b)
    return float(10 ** (middle - b[0] / b[1])) if b[1] > 1e-3 else None


def markdown(result):
    """The table of floors, families and failures."""
    lines = [f"{result['cases']} cases", "", "| | measured | floor | n | |", "|---|---|---|---|---|"]
    for name, value, n, bound, above in result["floors"]:
        shown = "–" if value is None else f"{value:.3g}"
        met = "" if value is None else "met" if (value >= bound if above else value <= bound) else "**missed**"
        lines.append(f"| {name} | {shown} | {'≥' if above else '≤'} {bound:g} | {n} | {met} |")
    lines += ["", "| family | found, λ ≥ 100 | of | right | of named |", "|---|---|---|---|---|"]
    lines += [f"| `{k}` | {v[0]} | {v[1]} | {v[3]} | {v[2]} |" for k, v in sorted(result["families"].items())]
    lines += ["", "| failed case | kind | truth (λ) | said |", "|---|---|---|---|"]
    lines += [f"| {' | '.join(map(str, row))} |" for row in result["failures"]]
    return "\n".join(lines) + "\n"
