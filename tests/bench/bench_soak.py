#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""A long run of the emulator in a flowgraph: every sample of two receivers compared, links that change every 1 ms, memory.

Transmitter 1 counts in its real part, transmitter 2 in its imaginary one, gains are powers of two: each sample received
tells exactly which delay and gain both links had at that instant. Exit status 1 where one was wrong or memory grew.
"""

import argparse
import json
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "apps"))
import _program  # noqa: F401  (finds gr_cast)
import numpy as np
from gnuradio import blocks as stock
from gnuradio import gr
from gr_cast import blocks

PERIOD = 2**20  # of the count: exact in a float
N_TAPS = 512
RATE_HZ = 50e6
UPDATE_SAMPLES = 50_000  # 1 ms
AHEAD = 20  # updates that wait in the emulator
GROWTH_LIMIT = 0.01  # of the memory, from a tenth of the run to its end


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096


class Judge(gr.sync_block):
    """Compares what both receivers hear with the links in force, and hands the emulator updates some time ahead."""

    def __init__(self, emulator, seed: int):
        gr.sync_block.__init__(self, "judge", [np.complex64, np.complex64], None)
        self.emulator, self.rng = emulator, np.random.default_rng(seed)
        self.count = np.arange(-N_TAPS, 2 * PERIOD, dtype=np.float32) % PERIOD
        self.links, self.n_queued = {}, 0  # per update: delay and gain of link (tx, rx)
        self.n_samples = self.n_wrong = 0
        self.queue()

    def queue(self) -> None:
        while self.n_queued <= self.n_samples // UPDATE_SAMPLES + AHEAD:
            delay, gain = self.rng.integers(0, N_TAPS, (2, 2)), 2.0 ** self.rng.integers(-3, 1, (2, 2))
            for tx in range(2):
                for rx in range(2):
                    at = self.n_queued * UPDATE_SAMPLES
                    self.emulator.set_sparse_taps(tx, rx, [int(delay[tx, rx])], [complex(gain[tx, rx])], at)
            self.links[self.n_queued] = delay, gain
            self.n_queued += 1

    def work(self, input_items, output_items):
        n = len(input_items[0])
        done = 0
        while done < n:
            update = self.n_samples // UPDATE_SAMPLES
            delay, gain = self.links[update]
            now = min(n - done, (update + 1) * UPDATE_SAMPLES - self.n_samples)
            begin = self.n_samples % PERIOD + N_TAPS
            for rx in range(2):
                heard = input_items[rx][done : done + now]
                for tx, part in enumerate((heard.real, heard.imag)):
                    first = begin - delay[tx, rx]
                    expected = np.float32(gain[tx, rx]) * self.count[first : first + now]
                    if self.n_samples < N_TAPS:
                        expected[: max(0, delay[tx, rx] - self.n_samples)] = 0  # before the first sample was silence
                    self.n_wrong += np.count_nonzero(part != expected)
            done += now
            self.n_samples += now
            if self.n_samples % UPDATE_SAMPLES == 0:
                del self.links[update]
                self.queue()
        return n


def main(argv=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--samples", type=float, default=1e9, help="of every node")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", metavar="FILE", help="write the rows there too")
    args = parser.parse_args(argv)
    n_samples = int(args.samples)

    top = gr.top_block("soak", catch_exceptions=False)
    emulator = blocks.channel_emulator(2, 2, N_TAPS, RATE_HZ, 0, "soak")
    judge = Judge(emulator, args.seed)
    count = np.arange(PERIOD)
    for tx, unit in enumerate((1, 1j)):
        source = stock.vector_source_c((count * unit).tolist(), True)
        top.connect(source, stock.head(gr.sizeof_gr_complex, n_samples), (emulator, tx))
        top.connect((emulator, tx), (judge, tx))
    top.start()
    rows, last, last_s = [], 0, time.perf_counter()
    print("      samples    wrong    late    memory MB    MS/s")
    while judge.n_samples < n_samples:
        time.sleep(0.2)
        if judge.n_samples >= (len(rows) + 1) * n_samples / 20:
            now_s = time.perf_counter()
            rate, last, last_s = (judge.n_samples - last) / (now_s - last_s), judge.n_samples, now_s
            late = emulator.late_updates()
            rows.append(
                {"samples": judge.n_samples, "wrong": int(judge.n_wrong), "late": late, "resident_bytes": resident_bytes()}
            )
            memory = rows[-1]["resident_bytes"] / 1e6
            print(f"{judge.n_samples:13d} {judge.n_wrong:8d} {late:7d} {memory:12.1f} {rate / 1e6:7.1f}", flush=True)
    top.wait()
    early = next(row for row in rows if row["samples"] >= n_samples / 10)["resident_bytes"]
    growth = rows[-1]["resident_bytes"] / early - 1
    print(f"{judge.n_samples} samples per node: {judge.n_wrong} wrong, memory {growth:+.2%} since a tenth of the run")
    if args.json:
        Path(args.json).write_text(json.dumps({"rows": rows, "memory_growth": growth}, indent=1))
    return int(judge.n_wrong > 0 or growth > GROWTH_LIMIT)


if __name__ == "__main__":
    sys.exit(main())
