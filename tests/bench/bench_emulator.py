#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast the channel emulator is: against networks of stock filters and this machine, and how it grows.

All figures of a row are measured in turns, the best turn of each counts, so that their ratios hold anywhere: the
other turns met somebody else's work. The cost of updates is processor time, with and without them in turns. Where
others work beside it, processor time of a flowgraph (all threads, kernel too) says more than its rate.
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
TURNS = 5


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


def best_turns(runs):
    """Samples per second, and nanoseconds of processor time per sample, of every run's best turns, the runs taking turns.

    runs: {name: (samples, run)}.
    """
    took = {name: [] for name in runs}
    for _ in range(TURNS):
        for name, (_, run) in runs.items():
            begin = time.perf_counter(), time.process_time()
            run()
            took[name].append((time.perf_counter() - begin[0], time.process_time() - begin[1]))
    rates = {name: samples / min(wall for wall, _ in took[name]) for name, (samples, _) in runs.items()}
    return rates, {name: min(cpu for _, cpu in took[name]) * 1e9 / samples for name, (samples, _) in runs.items()}


def loaded_kernel(links, nodes, threads, chunk):
    """A kernel with all its links, their delays and gains as it takes them, and samples for one call."""
    kernel = blocks.emulator_kernel(nodes, nodes, N_TAPS, threads, "auto")
    delays, gains = zip(*links.values(), strict=True)
    table = np.array(delays, np.int32), np.array(gains, np.complex64)
    kernel.set_all(0, *table)
    rng = np.random.default_rng(1)
    shape = (nodes, N_TAPS - 1 + chunk)
    return kernel, table, (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def kernel_run(links, nodes, threads=THREADS, chunk=12288):
    """(samples of a run, run, plan) of the kernel."""
    kernel, _, x = loaded_kernel(links, nodes, threads, chunk)
    begin = time.perf_counter()
    kernel.process(x)
    chunks = int(np.clip(0.4 / (time.perf_counter() - begin), 2, 4000))

    def run():
        for _ in range(chunks):
            kernel.process(x)

    return chunks * chunk, run, kernel.plan()


def update_cost(links, nodes, samples=50_000, chunk=12_500, periods=800):
    """(share of its processor time by which one thread works longer on `samples` where all links get new taps, plan)."""
    kernel, table, x = loaded_kernel(links, nodes, 1, chunk)
    took = np.empty(periods)
    for k in range(periods):
        begin = time.process_time()
        if k % 2:
            kernel.set_all(k * samples + chunk // 2, *table)  # the first chunk holds the old taps and the new ones
        for _ in range(samples // chunk):
            kernel.process(x)
        took[k] = time.process_time() - begin
    return np.median(took[1::2]) / np.median(took[::2]) - 1, kernel.plan()


def flow_run(nodes, n_samples, connect):
    """(samples of a run, run) of a source, what connect() puts between, and a sink: a thread each, of however many ports.

    The first port ends after n_samples, and everything with it.
    """

    def run():
        top = gr.top_block()
        source, head = stock.null_source(gr.sizeof_gr_complex), stock.head(gr.sizeof_gr_complex, n_samples)
        sink = stock.null_sink(gr.sizeof_gr_complex)
        top.connect(source, head)
        sources = [(head, 0), *((source, i) for i in range(1, nodes))]
        keep = connect(top, sources, [(sink, i) for i in range(nodes)])  # noqa: F841 - Python blocks need a reference
        top.run()

    return n_samples, run


def through_emulator(links):
    def connect(top, sources, sinks):
        emulator = blocks.channel_emulator(len(sources), len(sinks), N_TAPS, 1e6)
        for (tx, rx), (delays, gains) in links.items():
            emulator.set_sparse_taps(tx, rx, delays, gains)
        for i, (source, sink) in enumerate(zip(sources, sinks, strict=True)):
            top.connect(source, (emulator, i))
            top.connect((emulator, i), sink)
        return emulator

    return connect


def through_stock(links, make_filter):
    def connect(top, sources, sinks):
        for rx, sink in enumerate(sinks):
            filters = [make_filter(1, dense(*links[tx, rx])) for tx in range(len(sources))]
            for source, link in zip(sources, filters, strict=True):
                top.connect(source, link)
            if len(filters) == 1:
                top.connect(filters[0], sink)
                continue
            total = stock.add_cc()
            top.connect(total, sink)
            for tx, link in enumerate(filters):
                top.connect(link, (total, tx))

    return connect


def bare(top, sources, sinks):
    for source, sink in zip(sources, sinks, strict=True):
        copy = stock.copy(gr.sizeof_gr_complex)
        top.connect(source, copy)
        top.connect(copy, sink)


def memory_rate():
    """Bytes per second of a copy that no cache holds, read and written."""
    source, target = np.ones(1 << 25), np.empty(1 << 25)
    rates, _ = best_turns({"copy": (2 * source.nbytes, lambda: np.copyto(target, source))})
    return rates["copy"]


def measure_row(nodes, n_taps, fma_peak, progress):
    links = network(nodes, n_taps)
    progress(f"{nodes}x{nodes}, {n_taps} of {N_TAPS} taps")
    *kernel, plan = kernel_run(links, nodes)
    *one_core, _ = kernel_run(links, nodes, threads=1)
    seconds = 1.0
    fft, fir = (through_stock(links, f) for f in (stock_filter.fft_filter_ccc, stock_filter.fir_filter_ccc))
    emulated = int(seconds * (3e8 / nodes**1.3 if n_taps == 4 else 1.5e8 / nodes**1.3))
    runs = {
        "kernel": kernel,
        "kernel_one_core": one_core,
        "flowgraph": flow_run(nodes, emulated, through_emulator(links)),
        "stock_fft": flow_run(nodes, int(seconds * 1e8 / nodes**1.8), fft),
        "stock_fir": flow_run(nodes, int(seconds * 8e6 / nodes**1.8), fir),
        "bare_streams": flow_run(nodes, int(seconds * 2e8 / nodes), bare),
    }
    rates, cpu_ns = best_turns(runs)
    row = {"nodes": nodes, "taps": n_taps, "plan": plan, **rates, "cpu_ns": cpu_ns}
    # Four real multiply-adds per complex tap, where the kernel is the direct form.
    direct = 4 * nodes * n_taps * nodes * row["kernel_one_core"]
    row["fma_share"] = direct / fma_peak if "sparse" in plan else None
    return row


def exponent(rows, n_taps, sizes):
    """Power of N that the cost of all outputs grows with: the slope through networks of these sizes, in logarithms."""
    cost = {row["nodes"]: 1 / row["kernel_one_core"] for row in rows if row["taps"] == n_taps}
    return np.polyfit(np.log(sizes), np.log([cost[n] for n in sizes]), 1)[0]


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", metavar="FILE", help="write the figures there")
    parser.add_argument("--nodes", type=int, nargs="+", default=NODES, help="sizes of the networks")
    arguments = parser.parse_args(argv)
    gr.logging().set_default_level(gr.log_levels.warn)  # a line per flowgraph would bury the table
    fma_peak, memory = blocks.fma_rate(), memory_rate()
    print(f"{THREADS} cores; one core: {fma_peak / 1e9:.1f} G multiply-adds/s; memory {memory / 1e9:.1f} GB/s")
    print("MS/s per node; ratios to the stock FFT and FIR networks; cpu: ns of processor time per sample of all nodes")
    header = f"{'nodes':>5} {'taps':>4} {'kernel':>8} {'/fft':>6} {'1 core':>8} {'cores':>6} {'of FMA':>6} "
    header += f"{'flow':>8} {'/fft':>6} {'/fir':>7} {'stock fft':>9} {'stock fir':>9} {'bare':>6} "
    print(header + f"{'flow cpu':>8} {'fft cpu':>8} {'ratio':>6}")
    rows = []
    for n_taps in (4, N_TAPS):
        for nodes in arguments.nodes:
            row = measure_row(nodes, n_taps, fma_peak, lambda text: print(f"\r{text:60}", end="", file=sys.stderr))
            rows.append(row)
            print("\r" + " " * 60 + "\r", end="", file=sys.stderr)
            share = f"{row['fma_share']:6.0%}" if row["fma_share"] else f"{'-':>6}"
            print(
                f"{nodes:5} {n_taps:4} {row['kernel'] / 1e6:8.2f} {row['kernel'] / row['stock_fft']:6.1f} "
                f"{row['kernel_one_core'] / 1e6:8.2f} {row['kernel'] / row['kernel_one_core']:6.2f} {share} "
                f"{row['flowgraph'] / 1e6:8.2f} {row['flowgraph'] / row['stock_fft']:6.1f} "
                f"{row['flowgraph'] / row['stock_fir']:7.1f} {row['stock_fft'] / 1e6:9.2f} "
                f"{row['stock_fir'] / 1e6:9.3f} {row['bare_streams'] / 1e6:6.1f} {row['cpu_ns']['flowgraph']:8.1f} "
                f"{row['cpu_ns']['stock_fft']:8.1f} {row['cpu_ns']['stock_fft'] / row['cpu_ns']['flowgraph']:6.1f}",
                flush=True,
            )
    result = {"cores": THREADS, "fma_per_second": fma_peak, "memory_bytes_per_second": memory, "rows": rows}
    nodes = arguments.nodes[-2] if len(arguments.nodes) > 1 else arguments.nodes[0]
    for n_taps in (4, N_TAPS):
        cost, plan = update_cost(network(nodes, n_taps), nodes)
        result[f"update_cost_{n_taps}"] = cost
        print(
            f"{nodes}x{nodes}, {n_taps} taps: new taps on all links every 1 ms at 50 MS/s cost "
            f"{cost:.1%} of processor time ({plan})"
        )
    if len(arguments.nodes) > 1:
        sizes = arguments.nodes[-3:]
        result["exponent_sparse"] = exponent(rows, 4, sizes)
        result["exponent_dense"] = exponent(rows, N_TAPS, sizes)
        print(
            f"cost of a sample of all nodes grows from {sizes[0]} to {sizes[-1]} nodes as "
            f"N^{result['exponent_sparse']:.2f} at 4 taps (links x taps: N^2), "
            f"N^{result['exponent_dense']:.2f} at {N_TAPS} (links + N log: between N and N^2)"
        )
    if arguments.json:
        Path(arguments.json).write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    _program.run(main)
