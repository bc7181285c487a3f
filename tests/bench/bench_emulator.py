#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast the channel emulator is: against networks of stock filters and this machine, and how it grows.

All figures of a row are measured one after the other in one run, so that their ratios hold anywhere.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "apps"))
import _program
import numpy as np
from gnuradio import blocks as stock
from gnuradio import filter as stock_filter
from gnuradio import gr
from gr_cast import blocks

N_TAPS = 512
NODES = (1, 2, 4, 10, 16)
THREADS = os.cpu_count()


def random_taps(rng, n_taps):
    """Delays and gains of a link; one delay is the longest, so that stock filters need all 512 taps."""
    inner = np.sort(rng.choice(N_TAPS - 1, n_taps - 1, replace=False))
    gains = (rng.standard_normal(n_taps) + 1j * rng.standard_normal(n_taps)) / np.sqrt(n_taps)
    return np.append(inner, N_TAPS - 1), gains.astype(np.complex64)


def network(nodes, n_taps):
    rng = np.random.default_rng(nodes)
    return {(tx, rx): random_taps(rng, n_taps) for tx in range(nodes) for rx in range(nodes)}


def dense(delays, gains):
    taps = np.zeros(N_TAPS, np.complex64)
    taps[delays] = gains
    return taps


def best_rate(samples, run, repeats=3):
    """Samples per second of the best of several runs: the others met somebody else's work."""
    took = []
    for _ in range(repeats):
        begin = time.perf_counter()
        run()
        took.append(time.perf_counter() - begin)
    return samples / min(took)


def kernel_rate(links, nodes, threads=THREADS, update_samples=None, chunk=12288, isa="auto"):
    """Samples per second and node of the kernel, all links getting new taps every `update_samples`."""
    kernel = blocks.emulator_kernel(nodes, nodes, N_TAPS, threads, isa)
    for (tx, rx), (delays, gains) in links.items():
        kernel.set_sparse_taps(tx, rx, delays, gains)
    rng = np.random.default_rng(1)
    shape = (nodes, N_TAPS - 1 + chunk)
    x = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
    begin = time.perf_counter()
    kernel.process(x)
    chunks = int(np.clip(0.4 / (time.perf_counter() - begin), 2, 4000))
    done = chunk

    def run():
        nonlocal done
        if update_samples:
            for at in range(done, done + chunks * chunk, update_samples):
                kernel.set_all(at, delay_table, gain_table)
        for _ in range(chunks):
            kernel.process(x)
        done += chunks * chunk

    if update_samples:
        delay_table = np.array([delays for delays, _ in links.values()], np.int32)
        gain_table = np.array([gains for _, gains in links.values()], np.complex64)
    return best_rate(chunks * chunk, run), kernel.plan()


def flow_rate(nodes, n_samples, connect):
    """Samples per second and node of sources, what connect() puts in, and sinks."""

    def run():
        top = gr.top_block()
        heads = [stock.head(gr.sizeof_gr_complex, n_samples) for _ in range(nodes)]
        sinks = [stock.null_sink(gr.sizeof_gr_complex) for _ in range(nodes)]
        for head in heads:
            top.connect(stock.null_source(gr.sizeof_gr_complex), head)
        keep = connect(top, heads, sinks)  # noqa: F841 - GNU Radio's Python blocks need a reference
        top.run()

    return best_rate(n_samples, run, repeats=2)


def through_emulator(links):
    def connect(top, heads, sinks):
        emulator = blocks.channel_emulator(len(heads), len(sinks), N_TAPS, 1e6)
        for (tx, rx), (delays, gains) in links.items():
            emulator.set_sparse_taps(tx, rx, delays, gains)
        for i, (head, sink) in enumerate(zip(heads, sinks, strict=True)):
            top.connect(head, (emulator, i))
            top.connect((emulator, i), sink)
        return emulator

    return connect


def through_stock(links, make_filter):
    def connect(top, heads, sinks):
        keep = []
        for rx, sink in enumerate(sinks):
            total = stock.add_cc() if len(heads) > 1 else sink
            for tx, head in enumerate(heads):
                link = make_filter(1, dense(*links[tx, rx]))
                top.connect(head, link, (total, tx))
                keep.append(link)
            if len(heads) > 1:
                top.connect(total, sink)
        return keep

    return connect


def bare(top, heads, sinks):
    for head, sink in zip(heads, sinks, strict=True):
        top.connect(head, stock.copy(gr.sizeof_gr_complex), sink)


def memory_rate():
    """Bytes per second of a copy that no cache holds, read and written."""
    source, target = np.ones(1 << 25), np.empty(1 << 25)
    return best_rate(2 * source.nbytes, lambda: np.copyto(target, source))


def measure_row(nodes, n_taps, fma_peak, progress):
    links = network(nodes, n_taps)
    row = {"nodes": nodes, "taps": n_taps}
    progress(f"{nodes}x{nodes}, {n_taps} of {N_TAPS} taps: kernel")
    row["kernel"], row["plan"] = kernel_rate(links, nodes)
    row["kernel_one_core"], _ = kernel_rate(links, nodes, threads=1)
    # Four real multiply-adds per complex tap, where the kernel is the direct form.
    direct = 4 * nodes * n_taps * nodes * row["kernel_one_core"]
    row["fma_share"] = direct / fma_peak if "sparse" in row["plan"] else None
    progress(f"{nodes}x{nodes}, {n_taps} of {N_TAPS} taps: flowgraphs")
    seconds = 1.5
    row["flowgraph"] = flow_rate(nodes, int(seconds * 0.5 * min(row["kernel"], 1e8)), through_emulator(links))
    row["stock_fft"] = flow_rate(
        nodes, int(seconds * 1e8 / nodes**1.6), through_stock(links, stock_filter.fft_filter_ccc)
    )
    row["stock_fir"] = flow_rate(
        nodes, int(seconds * 8e6 / nodes**1.7), through_stock(links, stock_filter.fir_filter_ccc)
    )
    row["bare_streams"] = flow_rate(nodes, int(seconds * 2e8 / nodes), bare)
    return row


def exponent(rows, n_taps, sizes):
    """Power of N that the cost of all outputs grows with, between the two largest networks."""
    cost = {row["nodes"]: 1 / row["kernel_one_core"] for row in rows if row["taps"] == n_taps}
    small, large = sizes
    return np.log(cost[large] / cost[small]) / np.log(large / small)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", metavar="FILE", help="write the figures there")
    parser.add_argument("--nodes", type=int, nargs="+", default=NODES, help="sizes of the networks")
    arguments = parser.parse_args(argv)
    gr.logging().set_default_level(gr.log_levels.warn)  # a line per flowgraph would bury the table
    fma_peak, memory = blocks.fma_rate(), memory_rate()
    print(
        f"{THREADS} cores; one core: {fma_peak / 1e9:.1f} G multiply-adds/s; memory {memory / 1e9:.1f} GB/s"
    )
    print("MS/s per node; ratios to the stock FFT and FIR networks")
    header = f"{'nodes':>5} {'taps':>4} {'kernel':>8} {'/fft':>6} {'1 core':>8} {'cores':>6} {'of FMA':>6} "
    print(header + f"{'flow':>8} {'/fft':>6} {'/fir':>7} {'stock fft':>9} {'stock fir':>9} {'bare':>6}")
    rows = []
    for n_taps in (4, N_TAPS):
        for nodes in arguments.nodes:
            row = measure_row(
                nodes, n_taps, fma_peak, lambda text: print(f"\r{text:60}", end="", file=sys.stderr)
            )
            rows.append(row)
            print("\r" + " " * 60 + "\r", end="", file=sys.stderr)
            share = f"{row['fma_share']:6.0%}" if row["fma_share"] else f"{'-':>6}"
            print(
                f"{nodes:5} {n_taps:4} {row['kernel'] / 1e6:8.2f} {row['kernel'] / row['stock_fft']:6.1f} "
                f"{row['kernel_one_core'] / 1e6:8.2f} {row['kernel'] / row['kernel_one_core']:6.2f} {share} "
                f"{row['flowgraph'] / 1e6:8.2f} {row['flowgraph'] / row['stock_fft']:6.1f} "
                f"{row['flowgraph'] / row['stock_fir']:7.1f} {row['stock_fft'] / 1e6:9.2f} "
                f"{row['stock_fir'] / 1e6:9.3f} {row['bare_streams'] / 1e6:6.1f}",
                flush=True,
            )
    result = {"cores": THREADS, "fma_per_second": fma_peak, "memory_bytes_per_second": memory, "rows": rows}
    nodes = arguments.nodes[-2] if len(arguments.nodes) > 1 else arguments.nodes[0]
    for n_taps in (4, N_TAPS):
        links = network(nodes, n_taps)
        still, _ = kernel_rate(links, nodes)
        moving, plan = kernel_rate(links, nodes, update_samples=50_000)
        result[f"update_cost_{n_taps}"] = still / moving - 1
        print(
            f"{nodes}x{nodes}, {n_taps} taps: new taps on all links every 1 ms at 50 MS/s cost "
            f"{still / moving - 1:.1%} ({plan})"
        )
    if len(arguments.nodes) > 1:
        sizes = arguments.nodes[-2:]
        result["exponent_sparse"] = exponent(rows, 4, sizes)
        result["exponent_dense"] = exponent(rows, N_TAPS, sizes)
        print(
            f"cost of a sample of all nodes grows from {sizes[0]} to {sizes[1]} nodes as "
            f"N^{result['exponent_sparse']:.2f} at 4 taps (links x taps: N^2), "
            f"N^{result['exponent_dense']:.2f} at {N_TAPS} (links + N log: between N and N^2)"
        )
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    _program.run(main)
