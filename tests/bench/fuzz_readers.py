#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Every reader against mutations of valid files: each must end in a result or in lines of a CastError, in time and memory.

    tests/bench/fuzz_readers.py [--count 100000] [--seed N] [--reader NAME …]

Ends with tried / read / refused / wrong per reader; wrong is an exception that is no CastError, a fault of more than one line,
more than LIMIT_S or more than MEMORY_BYTES. Exit status 1 where any is.
"""

import argparse
import os
import random
import resource
import secrets
import signal
import sys
import tempfile
import time
import traceback
import warnings
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

for place in ("build/python", "python"):
    if (folder := Path(__file__).resolve().parents[2] / place).joinpath("gr_cast").is_dir():
        sys.path.insert(0, str(folder))
        break
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from fuzz.mutations import mutated
from fuzz.valid_files import READERS
from gr_cast.core.errors import CastError

MEMORY_BYTES = 1 << 30  # of address space beyond what a worker has when it begins
LIMIT_S = 20.0  # of one file; the slowest valid ones take 0.1 s
BATCH = 200  # mutations that a worker does for one valid file


@dataclass
class Count:
    tried: int = 0
    read: int = 0
    refused: int = 0
    wrong: int = 0
    seconds: float = 0.0

    def __iadd__(self, other: "Count") -> "Count":
        for name in vars(self):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        return self


def _out_of_time(*_):
    raise TimeoutError(f"more than {LIMIT_S:g} s")


def attack(number: int, count: int, seed: str, keep: str | None = None) -> tuple[Count, list[str]]:
    """`count` mutations of one reader's file: what they ended in, and a line for each that went wrong."""
    rng, total, wrong = random.Random(f"{seed}/{number}"), Count(), []
    signal.signal(signal.SIGALRM, _out_of_time)
    with tempfile.TemporaryDirectory() as folder:
        path, read = READERS[number](Path(folder))
        read(path)  # valid as it is
        data = path.read_bytes()
        for index in range(count):
            bad = None
            changed = mutated(data, path.name, rng)
            path.write_bytes(changed)
            began = time.monotonic()
            signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    read(path)
                total.read += 1
            except CastError as error:
                total.refused += 1
                lines = str(error).split("\n")
                if lines != list(error.faults) or not all(line.isprintable() and len(line) < 2000 for line in lines):
                    bad = f"a fault that is not one line: {error.faults[0][:200]!r}"
            except Exception as error:  # what a reader must not end in
                last = traceback.extract_tb(error.__traceback__)[-1]
                bad = f"{type(error).__name__}: {str(error)[:150]} ({Path(last.filename).name}:{last.lineno})"
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0)
            total.tried += 1
            total.seconds += time.monotonic() - began
            if bad:
                total.wrong += 1
                wrong.append(f"{READERS[number].__name__} seed {seed} mutation {index}: {bad}")
                if keep:
                    (Path(keep) / f"{READERS[number].__name__}-{seed.replace('/', '-')}-{index}{path.suffix}").write_bytes(
                        changed
                    )
    return total, wrong


def _limit_memory() -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY_BYTES,) * 2)


def _row(name: str, count: Count) -> str:
    each_ms = 1e3 * count.seconds / max(count.tried, 1)
    return f"{name:<20}{count.tried:9}{count.read:9}{count.refused:9}{count.wrong:7}{each_ms:9.2f}"


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [reader.__name__ for reader in READERS]
    parser.add_argument("--count", type=int, default=100_000, help="mutations over all readers")
    parser.add_argument("--seed", default=secrets.token_hex(4), help="of all mutations; fresh without it")
    parser.add_argument("--reader", nargs="+", choices=names, default=names)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--keep", metavar="DIR", help="files that went wrong go here")
    args = parser.parse_args(argv)
    print(f"seed {args.seed}", flush=True)
    counts = {names.index(name): Count() for name in args.reader}
    with ProcessPoolExecutor(args.jobs, initializer=_limit_memory) as pool:
        work = [(number, batch) for batch in range(-(-args.count // (len(counts) * BATCH))) for number in counts]
        futures = {pool.submit(attack, number, BATCH, f"{args.seed}/{batch}", args.keep): number for number, batch in work}
        try:
            for future in as_completed(futures):
                count, lines = future.result()
                counts[futures[future]] += count
                print(*lines, sep="\n", end="\n" if lines else "", flush=True)
        except BaseException:  # a fault of the bench itself ends it at once
            pool.shutdown(cancel_futures=True)
            raise
    total = Count()
    print(f"{'reader':<20}{'tried':>9}{'read':>9}{'refused':>9}{'wrong':>7}{'ms each':>9}")
    for number, count in counts.items():
        total += count
        print(_row(names[number], count))
    print(_row("all", total))
    return 1 if total.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
