# SPDX-License-Identifier: GPL-3.0-or-later
"""NumPy arrays through GNU Radio blocks: one flowgraph per call, always finite."""

import os

os.environ.setdefault("GR_DONT_LOAD_PREFS", "1")

import numpy as np
from gnuradio import analog, blocks, gr


def _run(source, chain, sink):
    top = gr.top_block("bank", catch_exceptions=False)
    top.connect(source, *chain, sink)
    top.run()
    return np.array(sink.data())


def through(x, *chain):
    """Complex samples through blocks, complex or none in between; float32 inside, complex128 out."""
    return _run(blocks.vector_source_c(np.asarray(x, np.complex64)), chain, blocks.vector_sink_c())


def same_length(x, *chain):
    """Blocks that keep the rate; hierarchical ones strand the last samples, so zeros follow and are cut."""
    return through(np.concatenate([x, np.zeros(4096)]), *chain)[: len(x)]


def through_real(x, *chain):
    """Real samples through real blocks."""
    return _run(blocks.vector_source_f(np.asarray(x, np.float32)), chain, blocks.vector_sink_f())


def on_rails(x, make):
    """I and Q through one real block each, both from `make()`."""
    return through_real(x.real, make()) + 1j * through_real(x.imag, make())


def samples(source, count):
    """The first `count` complex samples of a source."""
    return _run(source, (blocks.head(gr.sizeof_gr_complex, count),), blocks.vector_sink_c())


def samples_real(source, count, *chain):
    """The first `count` real samples of a source, after real blocks that keep the rate."""
    return _run(source, (*chain, blocks.head(gr.sizeof_float, count)), blocks.vector_sink_f())


def samples_via(source, *chain):
    """All complex samples of a finite source after blocks that end in complex."""
    return _run(source, chain, blocks.vector_sink_c())


def combine(block, *inputs):
    """Complex inputs through one block of many inputs (add, multiply, stream_mux)."""
    top, sink = gr.top_block("bank", catch_exceptions=False), blocks.vector_sink_c()
    sources = [blocks.vector_source_c(np.asarray(x, np.complex64)) for x in inputs]
    for port, source in enumerate(sources):
        top.connect(source, (block, port))
    top.connect(block, sink)
    top.run()
    return np.array(sink.data())


def multiply(x, y):
    return combine(blocks.multiply_cc(), x, y)


def add(x, y):
    return combine(blocks.add_cc(), x, y)


def oscillator(cycles_per_sample, count, first):
    """e^{j2πfn} by `sig_source_c`, with phase zero at sample `first`."""
    phase = float(np.angle(np.exp(-2j * np.pi * cycles_per_sample * first)))
    return samples(analog.sig_source_c(1.0, analog.GR_COS_WAVE, cycles_per_sample, 1.0, 0.0, phase), count)


def gaussian(count, power, seed):
    """Circular white noise of a mean power, by `noise_source_c`."""
    return samples(analog.noise_source_c(analog.GR_GAUSSIAN, float(np.sqrt(power)), seed), count)


def uniform(count, seed):
    """Uniform on −1…1, by `noise_source_f`."""
    return samples_real(analog.noise_source_f(analog.GR_UNIFORM, 1.0, seed), count)
