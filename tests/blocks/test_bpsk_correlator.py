# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pmt
import pytest
from gnuradio import blocks, gr
from gr_cast import blocks as cast
from gr_cast.signals import codes

RATE_HZ = 1e6


def rx_time(offset, seconds, fraction):
    tag = gr.tag_t()
    tag.offset, tag.key = offset, pmt.intern("rx_time")
    tag.value = pmt.make_tuple(pmt.from_uint64(seconds), pmt.from_double(fraction))
    return tag


def correlate(samples, chips, samples_per_chip=1, average=1, tags=(), max_noutput=100_000):
    source = blocks.vector_source_c(np.asarray(samples, complex).tolist(), False, 1, list(tags))
    block = cast.bpsk_correlator(chips.tolist(), samples_per_chip, average, RATE_HZ)
    length = block.period()
    sinks = [blocks.vector_sink_c(length), blocks.vector_sink_f(length), blocks.vector_sink_f(length)]
    top = gr.top_block(catch_exceptions=False)
    top.connect(source, block)
    for port, sink in enumerate(sinks):
        top.connect((block, port), sink)
    top.run(max_noutput)
    found = [(tag.offset, str(tag.key), pmt.to_python(tag.value)) for tag in sinks[0].tags()]
    return [np.array(sink.data()).reshape(-1, length) for sink in sinks], found, block


def noise(count, seed=1):
    random = np.random.default_rng(seed)
    return (random.standard_normal(count) + 1j * random.standard_normal(count)).astype(np.complex64)


@pytest.mark.parametrize("chips", [codes.glfsr(8), codes.ga128(), codes.gold_paper(), codes.glfsr(14)], ids=len)
@pytest.mark.parametrize(("samples_per_chip", "average"), [(1, 1), (3, 1), (1, 4), (9, 2)])
def test_the_response_is_the_circular_correlation_over_the_code_energy(chips, samples_per_chip, average):
    code = np.repeat(chips, samples_per_chip)
    periods = 3 * average
    samples = noise(len(code) * periods + 17)
    (cir, magnitude, gain_db), _, _ = correlate(samples, chips, samples_per_chip, average)
    means = samples[: periods * len(code)].reshape(3, average, -1).mean(axis=1)
    expected = np.fft.ifft(np.fft.fft(means) * np.conj(np.fft.fft(code))) / np.sum(code**2)
    assert cir.shape == expected.shape
    assert np.abs(cir - expected).max() < 1e-6 * np.abs(expected).max() * np.sqrt(len(code))
    assert np.allclose(magnitude, np.abs(cir), rtol=1e-5)
    assert np.allclose(gain_db, 20 * np.log10(np.abs(cir)), atol=1e-3)


@pytest.mark.parametrize("max_noutput", [1, 7, 1000, 100_000])
def test_the_result_does_not_depend_on_the_schedulers_chunks(max_noutput):
    chips, samples = codes.glfsr(6), noise(63 * 40)
    (whole, _, _), _, _ = correlate(samples, chips, 1, 4)
    (pieces, _, _), _, _ = correlate(samples, chips, 1, 4, max_noutput=max_noutput)
    assert np.array_equal(whole, pieces)


def test_a_path_shows_at_its_delay_with_its_gain():
    chips = codes.glfsr(8)
    received = 0.25j * np.roll(np.tile(chips, 4), 64)
    (cir, _, gain_db), _, _ = correlate(received, chips)
    assert np.argmax(np.abs(cir[0])) == 64
    assert cir[0, 64] == pytest.approx(0.25j, abs=1e-6)
    assert gain_db[0, 64] == pytest.approx(20 * np.log10(0.25), abs=1e-3)


@pytest.mark.parametrize("lost", [1, 100, 254, 255, 1000, 123_456_789])
@pytest.mark.parametrize("average", [1, 3])
def test_lost_samples_restart_the_average_on_the_same_delay_axis(lost, average):
    chips, length = codes.glfsr(8), 255
    heard = 10 * length + 77  # the receiver drops samples in the middle of a period
    air = np.roll(np.tile(chips, 10 + 20), 5)
    after = np.resize(np.roll(chips, 5 - (heard + lost) % length), 12 * length)
    samples = np.concatenate([air[:heard], after])
    later = 0.25 + (heard + lost) / RATE_HZ
    tags = [rx_time(0, 3, 0.25), rx_time(heard, 3 + int(later), later % 1)]
    (cir, _, _), found, block = correlate(samples, chips, 1, average, tags)
    assert block.lost_samples() == lost
    assert np.all(np.argmax(np.abs(cir), axis=1) == 5)
    assert np.allclose(cir[:, 5], 1, atol=1e-5), "no vector mixes samples from before and after the gap"
    (first, restart) = (offset for offset, key, _ in found if key == "sample_index")
    index = {offset: value for offset, key, value in found if key == "sample_index"}
    assert (first, index[first]) == (0, 0)
    assert index[restart] % length == 0
    assert heard + lost <= index[restart] < heard + lost + length
    assert [value for _, key, value in found if key == "lost_samples"] == [lost]
    seconds, fraction = next(value for offset, key, value in found if key == "rx_time" and offset == restart)
    assert seconds + fraction == pytest.approx(3.25 + index[restart] / RATE_HZ, abs=1e-9)


def test_a_repeated_or_malformed_time_tag_changes_nothing():
    chips, samples = codes.glfsr(6), noise(63 * 9)
    wrong = rx_time(200, 0, 0.0)
    wrong.value = pmt.intern("noon")
    tags = [rx_time(0, 10, 0.5), rx_time(100, 10, 0.5 + 100 / RATE_HZ), wrong]
    (plain, _, _), _, _ = correlate(samples, chips)
    (tagged, _, _), found, block = correlate(samples, chips, tags=tags)
    assert np.array_equal(plain, tagged)
    assert block.lost_samples() == 0
    assert [offset for offset, key, _ in found if key == "sample_index"] == [0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([], 1, 1, 1.0), "one chip"),
        (([1.0, 0.5], 1, 1, 1.0), "chip 1"),
        (([1.0], 0, 1, 1.0), "sample per chip"),
        (([1.0], 1, 0, 1.0), "average"),
        (([1.0], 1, 1, 0.0), "sample_rate_hz"),
        (([1.0], 1, 1, float("nan")), "sample_rate_hz"),
    ],
)
def test_wrong_parameters_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        cast.bpsk_correlator(*arguments)
