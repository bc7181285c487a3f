#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Four taps for the traced channels that `cast_scenario.py create` left in its work folder: what each way of choosing them
loses over the band, and how long it takes.

`held`: least squares on one support per second, as created; its time counts interpolation and alignment too. `anew`: a support
for every impulse response by itself. `kmeans`: clustering. Exit status 1 where `held` misses -13 dB of NMSE in the median, or
0.1 ms per response.
"""

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "apps"))
import _program
import numpy as np
from gr_cast.scenario.create import approximate, paths
from gr_cast.scenario.model import GRID_STEP_S

HOLD_S, UPDATE_S = 1.0, 1e-3
EVERY = 50  # instants at which losses are counted, and the slow ways tried
NMSE_LIMIT_DB, TIME_LIMIT_MS = -13.0, 0.1


def on_grid(delay_s, gain, bandwidth_hz: float):
    support, taps = approximate.least_squares(delay_s, gain, bandwidth_hz)
    return np.broadcast_to(support * GRID_STEP_S, taps.shape), taps


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path, help="work folder of create, such as arena.create")
    parser.add_argument("--links", type=int, default=10**9, help="so many, spread over all (default: all)")
    args = parser.parse_args(argv)
    about = json.loads((args.work / "environment/environment.json").read_text())
    carrier_hz, bandwidth_hz = about["carrier_hz"], about["bandwidth_hz"]
    links = [link for _, link in sorted(paths.read(args.work / "parsing/links.npz").items())]
    chosen = [links[index] for index in np.linspace(0, len(links) - 1, min(args.links, len(links))).astype(int)]
    nmse_db = {name: [] for name in ("held", "anew", "kmeans")}
    spent_s, responses = dict.fromkeys(nmse_db, 0.0), dict.fromkeys(nmse_db, 0)
    moving_db = []  # of what is held

    def fit(name: str, way, delay_s, gain, every: int = 1) -> None:
        begin = time.process_time()
        taps = way(delay_s, gain)
        spent_s[name] += time.process_time() - begin
        responses[name] += len(gain)
        part = slice(None, None, every)
        nmse_db[name] += approximate.loss(delay_s[part], gain[part], taps[0][part], taps[1][part], bandwidth_hz).nmse_db.tolist()

    for link in chosen:
        is_moving = len(link.time_s) > 1
        for start_s in np.arange(0, link.time_s[-1], HOLD_S) if is_moving else [0.0]:
            begin = time.process_time()
            clock_s = np.arange(start_s, min(start_s + HOLD_S, link.time_s[-1]), UPDATE_S) if is_moving else np.zeros(1)
            delay_s, gain = paths.at(link, clock_s, carrier_hz)
            here = (gain != 0).any(axis=0)
            delay_s, gain = delay_s[:, here], gain[:, here]
            delay_s = delay_s + approximate.best_shift_s(delay_s, gain, bandwidth_hz)
            spent_s["held"] += time.process_time() - begin
            fit("held", lambda d, g: on_grid(d, g, bandwidth_hz), delay_s, gain, EVERY)
            few = slice(None, None, EVERY)
            moving_db += nmse_db["held"][-len(clock_s[few]) :] if is_moving else []
            for one_s, one in zip(delay_s[few, None], gain[few, None], strict=True):
                fit("anew", lambda d, g: on_grid(d, g, bandwidth_hz), one_s, one)
            fit("kmeans", approximate.kmeans, delay_s[few], gain[few])
    print(f"{len(chosen)} links, {bandwidth_hz / 1e6:g} MHz        NMSE dB: median  90 % below    ms per response")
    for name, losses in nmse_db.items():
        each_ms = 1e3 * spent_s[name] / responses[name]
        print(f"{name:>24s} {np.median(losses):20.2f} {np.percentile(losses, 90):11.2f} {each_ms:18.3f}")
    if moving_db:
        print(f"{np.median(moving_db):24.2f} dB in the median of `held` on links that move alone")
    return int(np.median(nmse_db["held"]) > NMSE_LIMIT_DB or 1e3 * spent_s["held"] / responses["held"] > TIME_LIMIT_MS)


if __name__ == "__main__":
    _program.run(main)
