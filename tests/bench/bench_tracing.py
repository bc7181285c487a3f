#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""What the compiled kernels of the tracer are worth: the same links of a place case traced by them and by NumPy, in one run.

tests/bench/bench_tracing.py ../shared/places/place_*
"""

import argparse
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "build" / "python"))

from gr_cast.scenario.create import fields, images
from gr_cast.twin.places import document, world
from gr_cast.twin.places.predict import Predictor

REPEATS = 5


def seconds(place) -> float:
    """Of processor time, the least of some runs: from the mesh to the responses of the first campaign."""
    one, here = place.soundings[0], world.of_place(place)
    found = []
    for _ in range(REPEATS):
        predictor = Predictor(one.tx, one.rx, one.time_s, getattr(one, "frequency_hz", None))
        begin = time.process_time()
        predictor.response(here)
        found.append(time.process_time() - begin)
    return min(found)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", metavar="CASE", help="folder of a place case with responses")
    args = parser.parse_args(argv)
    compiled = images.tracing
    if compiled is None:
        parser.error("the compiled kernels were not built")
    print("| case | links x instants | NumPy, ms | compiled, ms | ratio |\n|---|---|---|---|---|")
    for folder in args.cases:
        place = document.read(folder)
        if place.soundings[0].kind != "response":
            continue
        times = {}
        for kernels in (None, compiled):
            images.tracing = fields.tracing = kernels
            times[kernels] = 1e3 * seconds(place)
        size = f"{len(place.soundings[0].tx)} x {len(place.soundings[0].time_s)}"
        print(
            f"| {Path(folder).name} | {size} | {times[None]:.1f} | {times[compiled]:.1f} | {times[None] / times[compiled]:.1f} |"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
