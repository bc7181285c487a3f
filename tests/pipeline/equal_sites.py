# SPDX-License-Identifier: GPL-3.0-or-later
"""Verdicts of many commits at once: the stack's frames are made here, the testbed is a closed formula, only the judge is ours."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from gr_cast.pipeline import document, judge
from gr_cast.pipeline.residual import explained
from gr_cast.pipeline.trial import Trial
from gr_cast.scenario import load
from gr_cast.signals import wifi
from scipy import signal

STACK = Path(__file__).resolve().parents[2] / "docs" / "examples" / "stack"
PATHS = {0: (-3.0, 0.0), 4: (-9.0, 1.2), 16: (-15.0, -2.0)}  # room.yaml at 40 MS/s: samples → dB, rad
COUNT, NOISE_DB = 24_000, -55.0


def sent(seed: int) -> np.ndarray:
    """Two frames of 400 bytes, as the stack sends them."""
    rng, x = np.random.default_rng(seed), np.zeros(COUNT // 2, complex)
    for begin in (40, 5923):
        frame = wifi.modulated(rng.bytes(400), wifi.MODES["16qam1/2"])
        x[begin : begin + len(frame)] = frame
    return 0.25 * signal.resample(x, COUNT)


def heard(x: np.ndarray, rng, more_noise_db: float = 0.0) -> np.ndarray:
    y = sum(10 ** (db / 20) * np.exp(1j * rad) * np.concatenate([np.zeros(late), x])[:COUNT] for late, (db, rad) in PATHS.items())
    scale = 10 ** ((NOISE_DB + more_noise_db) / 20) / np.sqrt(2)
    return y + scale * (rng.normal(size=COUNT) + 1j * rng.normal(size=COUNT))


def said(commits: int, repeats: int, seed: int, more_noise_db: float = 0.0) -> list[set[str]]:
    """What the comparisons of so many commits say, testbed against twin, with fresh noise for each."""
    pipeline = document.read(STACK)
    pipeline = replace(pipeline, experiments=(replace(pipeline.experiments[1], repeats=repeats),))
    scenario, rng, rate_hz = load(STACK / "room.yaml"), np.random.default_rng(seed), pipeline.sample_rate_hz
    frames, found = [sent(100 + k) for k in range(repeats)], []

    def trial(x, more_db):
        left_db, gain_db = explained(scenario, {"1": x}, "2", heard(x, rng, more_db), rate_hz)
        return Trial(metrics={"2 loss": 0.0, "2 residual_db": left_db, "2 gain_db": gain_db})

    for _ in range(commits):
        beds = (("twin", 0.0), ("testbed", more_noise_db))
        trials = {site: {"long frames": [trial(x, more_db) for x in frames]} for site, more_db in beds}
        found.append({c.says for c in judge.comparisons(pipeline, trials)})
    return found
