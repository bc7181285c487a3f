#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrate the confidence of a diagnosis: scored diagnoses in, the logistic law and its reliability
picture out.

DIAGNOSES/<case>/diagnosis.json are judged against TRUTHS/<case>.json (families of the effects, kind of the
case).
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "apps"))

import _program
import matplotlib
import numpy as np
from gr_cast.core.errors import CastError

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def judged(diagnoses: Path, truths: Path) -> list[tuple[float, float, bool]]:
    """(evidence in nats, stated confidence, whether the family is in the truth) of every effect."""
    found = []
    for path in sorted(truths.glob("*.json")):
        said = diagnoses / path.stem / "diagnosis.json"
        if not said.exists():
            continue
        truth, document = json.loads(path.read_text()), json.loads(said.read_text())
        families = {e["family"] for e in truth["effects"]} | set(truth.get("tolerated", []))
        for effect in truth["effects"]:
            families |= {"extra_path" if s.startswith("extra_path") else s for s in effect.get("same_as", [])}
        if truth["kind"] != "ambiguous":
            found += [
                (e["evidence"]["heldout_gain_nats"] or 0.0, e["confidence"], e["family"] in families) for e in document["effects"]
            ]
    return found


def calibration_error(stated: np.ndarray, true: np.ndarray) -> float:
    """Expected calibration error over ten bins of confidence (Naeini et al., AAAI 2015)."""
    bins = np.minimum((stated * 10).astype(int), 9)
    return sum(
        np.mean(bins == k) * abs(stated[bins == k].mean() - true[bins == k].mean()) for k in range(10) if (bins == k).any()
    )


def picture(stated, true, path: Path) -> None:
    """Share of true effects over stated confidence, with the number of effects in each bin."""
    figure, axis = plt.subplots(figsize=(5, 4.6), layout="constrained")
    bins = np.minimum((stated * 10).astype(int), 9)
    axis.plot([0, 1], [0, 1], ":", color="#8a8a8a")
    for k in range(10):
        inside = bins == k
        if inside.any():
            share, count = true[inside].mean(), int(inside.sum())
            axis.errorbar(
                stated[inside].mean(),
                share,
                np.sqrt(share * (1 - share) / count + 0.25 / count**2),
                fmt="o",
                color="#1f5fa8",
            )
            axis.annotate(str(count), (stated[inside].mean(), share), xytext=(6, -12), textcoords="offset points")
    axis.set(xlabel="stated confidence", ylabel="share that is true", xlim=(0, 1.02), ylim=(0, 1.05))
    figure.savefig(path, dpi=110)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("diagnoses", type=Path)
    parser.add_argument("truths", type=Path)
    parser.add_argument("--picture", type=Path, default=Path("reliability.png"))
    args = parser.parse_args(argv)
    found = judged(args.diagnoses, args.truths)
    if len(found) < 10:
        raise CastError(f"{args.diagnoses}: {len(found)} effects with a truth, needs 10 or more")
    nats, stated, true = (np.array(v, float) for v in zip(*found, strict=True))
    print(f"effects {len(found)}, true {true.mean():.3f}, mean confidence {stated.mean():.3f}")
    print(f"expected calibration error {calibration_error(stated, true):.3f}")
    for low, high in ((0, 15), (15, 40), (40, 150), (150, np.inf)):
        inside = (nats >= low) & (nats < high)
        if inside.any():
            count, share = int(inside.sum()), true[inside].mean()
            print(f"evidence {low:>4} to {high:>4} nats: {count:4d} effects, {share:.3f} true")
    picture(stated, true, args.picture)
    return 0


if __name__ == "__main__":
    _program.run(main)
