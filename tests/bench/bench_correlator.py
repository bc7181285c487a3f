#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The correlator against GNU Radio's fft_filter_ccc as matched filter: kernels alone, and in flowgraphs on one core."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "apps"))
os.environ["GR_DONT_LOAD_PREFS"] = "1"

import _program
from gnuradio import blocks, filter, gr
from gr_cast import blocks as cast
from gr_cast.signals import codes

SAMPLES = 40_000_000
REAL_TIME = 50e6  # samples per second that 255 chips must sustain on one core


def flowgraph_rate(*chain, item_size: int = gr.sizeof_gr_complex) -> float:
    """Samples per second of null source → chain → null sink, all on one core; the best of three."""
    best = 0.0
    for _ in range(3):
        top = gr.top_block(catch_exceptions=False)
        source, head = blocks.null_source(gr.sizeof_gr_complex), blocks.head(gr.sizeof_gr_complex, SAMPLES)
        sink = blocks.null_sink(item_size)
        made = [make() for make in chain]
        top.connect(source, head, *made, sink)
        for block in (source, head, sink, *made):
            block.set_processor_affinity([0])
        began = time.perf_counter()
        top.run()
        best = max(best, SAMPLES / (time.perf_counter() - began))
    return best


def main() -> int:
    subprocess.run(["cmake", "--build", ROOT / "build", "--target", "bench_correlator"], check=True, stdout=subprocess.DEVNULL)
    print("kernels, one thread")
    told = subprocess.run([ROOT / "build/lib/bench_correlator"], capture_output=True, text=True, check=True).stdout
    for line in (line for line in told.splitlines() if line.startswith("{")):  # GNU Radio's log shares the stream
        row = json.loads(line)
        way = "Walsh-Hadamard" if row["walsh_hadamard"] else "FFT"
        print(
            f"  {row['code']:<11} × {row['samples_per_chip']}  {way:<15} {row['kernel'] / 1e6:7.0f} MS/s   "
            f"fft_filter {row['fft_filter_kernel'] / 1e6:6.0f} MS/s   ratio {row['ratio']:.2f}"
        )
    chips = codes.glfsr(8)
    ceiling = flowgraph_rate(lambda: blocks.copy(gr.sizeof_gr_complex))
    stock = flowgraph_rate(lambda: filter.fft_filter_ccc(1, chips[::-1].tolist()))
    print("flowgraphs, every block on one core, 255 chips")
    print(f"  copy (the scheduler's ceiling)  {ceiling / 1e6:6.0f} MS/s")
    print(f"  fft_filter_ccc                  {stock / 1e6:6.0f} MS/s   {stock / ceiling:.0%} of the ceiling")
    for average in (1, 10):
        rate = flowgraph_rate(lambda k=average: cast.bpsk_correlator(chips.tolist(), 1, k, 50e6), item_size=8 * 255)
        print(
            f"  bpsk_correlator, average {average:<3}    {rate / 1e6:6.0f} MS/s   {rate / ceiling:.0%} of the ceiling, "
            f"{rate / stock:.2f} × fft_filter_ccc, {rate / REAL_TIME:.1f} × real time at 50 MS/s"
        )
    return 0


if __name__ == "__main__":
    _program.run(main)
