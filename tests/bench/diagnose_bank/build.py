# SPDX-License-Identifier: GPL-3.0-or-later
"""A bank on disk: DIR/cases/<case>/ and DIR/truth/<case>.json, then the seal."""

import hashlib
import shutil
from pathlib import Path

import numpy as np

from . import closed_form, compose, files, truth, world


def name_of(seed, index):
    return "case_" + hashlib.sha256(f"{seed}/{index}".encode()).hexdigest()[:12]


def checked(case):
    """Largest energy over noise by which the formula misses what GNU Radio played; None without a formula."""
    record, found = case.truth, []
    if record["kind"] in ("outside", "null"):
        return None
    for scene in case.scenes:
        mine = [(e, k) for e, k in zip(record["effects"], case.causes, strict=True) if world.touches(k, scene)]
        found.append(closed_form.misfit(scene, [e for e, _ in mine], [k for _, k in mine]))
    found = [f for f in found if f is not None]
    return max(found) if found else None


def build(cases_dir, truth_dir, seed, total, nulls=0, progress=lambda *a: None):
    """Writes all cases aside and renames at the end of each, `nulls` after `total`; truths are sealed last. Returns the seal."""
    cases_dir, truth_dir = Path(cases_dir), Path(truth_dir)
    cases_dir.mkdir(parents=True, exist_ok=True)
    truth_dir.mkdir(parents=True, exist_ok=True)
    for index in range(total + nulls):
        name = name_of(seed, index)
        if (truth_dir / f"{name}.json").exists() and (cases_dir / name).exists():
            continue
        case = compose.draw(seed, index, total)
        miss = checked(case)
        if miss is not None and miss > 10:
            raise AssertionError(f"{name}: GNU Radio and the formula differ by {miss:.1f} noise variances")
        aside = cases_dir / f".{name}"
        shutil.rmtree(aside, ignore_errors=True)
        files.write_case(aside, case.twin, case.waveforms, case.recordings, case.datatype)
        aside.rename(cases_dir / name)
        truth.write(truth_dir, name, {**case.truth, "case": name})
        progress(index + 1, total + nulls, name, case, miss)
    return truth.seal(truth_dir)


def describe(case, miss):
    record = case.truth
    what = ", ".join(f"{e['family']} λ={e['lambda']:.3g}" for e in record["effects"]) or "nothing"
    peak = max(float(np.max(np.abs(x))) for x in case.recordings.values())
    miss = "no formula" if miss is None else f"formula within {miss:.2g}"
    c = record["conditions"]
    head = f"{record['kind']:9s} {c['waveform']:10s} {c['samples']:6d} {case.datatype:7s}"
    return f"{head} peak {peak:.2f} {what} ({miss})"
