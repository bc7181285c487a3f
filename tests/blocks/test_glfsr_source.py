# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gnuradio import blocks, digital, gr
from gr_cast import blocks as cast


def first(source, count, sink_type=blocks.vector_sink_c, item=gr.sizeof_gr_complex):
    top, sink = gr.top_block(catch_exceptions=False), sink_type()
    top.connect(source, blocks.head(item, count), sink)
    top.run()
    return np.array(sink.data()), sink.tags()


@pytest.mark.parametrize("degree", range(1, 33))
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_chips_are_those_of_gnu_radios_glfsr(degree, seed):
    if seed >= 1 << degree:
        pytest.skip("seed beyond the register")
    ours, _ = first(cast.glfsr_source(degree, 0, seed), 5000)
    theirs, _ = first(digital.glfsr_source_f(degree, True, 0, seed), 5000, blocks.vector_sink_f, gr.sizeof_float)
    assert np.array_equal(ours, theirs)
    assert cast.glfsr_source(degree).mask() == digital.glfsr_source_f(degree).mask()


@pytest.mark.parametrize("samples_per_chip", [1, 3, 10])
def test_a_tag_marks_every_period_start(samples_per_chip):
    period = 31 * samples_per_chip
    samples, tags = first(cast.glfsr_source(5, 0, 7, samples_per_chip), 100_000)
    assert [tag.offset for tag in tags] == list(range(0, 100_000, period))
    assert [gr.tag_utils.tag_to_python(tag).value for tag in tags[:3]] == [0, 1, 2]
    assert np.array_equal(samples[:period], samples[period : 2 * period])


@pytest.mark.parametrize("arguments", [(0,), (33,), (8, 0, 0), (8, 0, 256), (8, 0x40), (8, 0, 1, 0)])
def test_a_register_without_a_period_is_refused(arguments):
    with pytest.raises(ValueError, match="needs"):
        cast.glfsr_source(*arguments)
