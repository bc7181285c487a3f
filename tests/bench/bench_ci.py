# SPDX-License-Identifier: GPL-3.0-or-later
"""What a push to a stack and the boot of a box cost a small machine: seconds of the clock and of its processors, bytes.

tests/bench/bench_ci.py FOLDER
"""

import argparse
import os
import resource
import sys
import time
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "build" / "python"), *(str(ROOT / "tests" / part) for part in ("pipeline", "colosseum"))]
import team as teams
from conftest import Stack
from gr_cast.colosseum import box, storage
from gr_cast.colosseum.emulator import Channel
from stack_faults import harmless

SRNS = 4


def processor_s() -> float:
    """Of this process and of all that it has waited for."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


@contextmanager
def told(what: str):
    begun_s, begun_processor_s = time.monotonic(), processor_s()
    yield
    print(f"{what}: {time.monotonic() - begun_s:.1f} s, {processor_s() - begun_processor_s:.1f} s of processor", flush=True)


def push(folder: Path) -> None:
    stack = Stack(folder / "stack")
    stack.testbed()
    kept = folder / "store"
    stack.bench(kept).commit("HEAD").judged()  # the parent of what is pushed
    stack.commit("Words", **harmless(1))
    with told("a push, built, tried ten times at each of two sites and judged"):
        stack.bench(kept).commit("HEAD").judged()
    images = [path.stat().st_size for path in (kept / "images").glob("*.tar*")]
    print(f"images of its commits: {', '.join(f'{size / 1e3:.1f} kB' for size in images)}")


def boot(folder: Path) -> None:
    os.environ["CAST_BOXES"] = str(folder / "b")
    team = teams.make(folder)
    image = teams.write_system(team / "images" / "small.tar", teams.radio_api())
    print(f"the image of the box's nodes: {image.stat().st_size / 1e6:.1f} MB")
    srns = [box.Srn(number=number, image=image) for number in range(1, SRNS + 1)]
    program = ROOT / "apps" / "cast_emulator.py"
    for again in ("the first time", "again"):
        with told(f"a box of {SRNS} nodes, up and down, {again}"):
            begun_s = time.monotonic()
            with box.Box("bench", storage.Storage(folder=team), srns, Channel(), program, interactive=True):
                print(f"up after {time.monotonic() - begun_s:.1f} s", flush=True)


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="a new one, with a short name")
    folder = parser.parse_args(argv).folder
    folder.mkdir(parents=True)
    push(folder)
    boot(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
