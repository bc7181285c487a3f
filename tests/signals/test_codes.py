# SPDX-License-Identifier: GPL-3.0-or-later
import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.core.units import db_from_amplitude
from gr_cast.signals import codes
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import max_len_seq


def first_chips(code):
    return "".join("+" if chip > 0 else "-" for chip in code[:16])


@pytest.mark.parametrize(
    ("code", "published"),
    [
        (codes.glfsr(8), "+-++---++++-+---"),
        (codes.gold_paper(), "-------+++-+---+"),
        (codes.ga128(), "++-------+-++--+"),
        (codes.ls(), "++-++++-++-+---+"),
    ],
)
def test_first_chips_are_the_published_ones(code, published):
    assert first_chips(code) == published


@pytest.mark.parametrize(
    ("code", "sidelobe_db"),
    [(codes.glfsr(8), -48.1), (codes.gold_paper(), -2.5), (codes.ga128(), -16.1), (codes.ls(), -15.3)],
)
def test_periodic_sidelobes_are_the_published_ones(code, sidelobe_db):
    sidelobes = np.abs(codes.periodic_autocorrelation(code))[1:]
    assert db_from_amplitude(sidelobes.max()) == pytest.approx(sidelobe_db, abs=0.05)


@pytest.mark.parametrize("degree", range(2, 19))
def test_m_sequence_correlates_to_minus_one_off_its_peak(degree):
    length = 2**degree - 1
    correlation = codes.periodic_autocorrelation(codes.m_sequence(degree)) * length
    assert np.allclose(correlation[1:], -1, atol=1e-6 * length)


@pytest.mark.parametrize("degree", [7, 8, 10, 16])
def test_m_sequence_has_the_run_statistics_of_an_independent_generator(degree):
    # SciPy's sequence uses another polynomial: equal run-length histograms, not equal chips (Golomb's postulates).
    def runs(bits):
        edges = np.flatnonzero(np.diff(np.concatenate([bits, bits[:1]])) != 0)
        return np.sort(np.diff(np.concatenate([edges, [edges[0] + len(bits)]])))

    ours = (codes.m_sequence(degree) > 0).astype(int)
    assert np.array_equal(runs(ours), runs(max_len_seq(degree)[0].astype(int)))


@pytest.mark.parametrize("length", [63, 127, 511])
def test_gold_codes_take_three_correlation_values(length):
    degree = length.bit_length()
    t = 2 ** ((degree + 2) // 2) + 1
    sidelobes = np.rint(codes.periodic_autocorrelation(codes.gold(length)).real * length)[1:]
    assert set(sidelobes) <= {-1, -t, t - 2}


def test_the_papers_gold_code_is_one_of_63_chips_cut_at_255():
    paper = codes.gold_paper()
    assert np.array_equal(paper, np.resize(codes.gold(63), 255))


def test_golay_pair_is_complementary():
    a, b = codes.ga128(), codes.gb128()
    total = np.correlate(a, a, "full") + np.correlate(b, b, "full")
    assert total[127] == 256
    assert np.count_nonzero(total) == 1


@given(st.integers(2, 300), st.data())
def test_zadoff_chu_has_constant_amplitude_and_no_sidelobes(length, data):
    roots = [root for root in range(1, length) if np.gcd(root, length) == 1]
    code = codes.zadoff_chu(length, data.draw(st.sampled_from(roots)))
    assert np.allclose(np.abs(code), 1, atol=1e-6)
    assert np.abs(codes.periodic_autocorrelation(code))[1:].max() < 1e-6


@given(st.integers(1, 12), st.integers(0), st.integers(1, 5))
def test_chips_are_held_for_their_samples(degree, seed, samples_per_chip):
    seed = 1 + seed % (2**degree - 1)
    spec = {"code": "glfsr", "degree": degree, "seed": seed, "samples_per_chip": samples_per_chip}
    samples = codes.from_spec(spec)
    assert samples.dtype == np.complex64
    held = samples.reshape(-1, samples_per_chip)
    assert np.array_equal(held, np.repeat(codes.glfsr(degree, 0, seed)[:, None], samples_per_chip, 1))


@given(st.integers(1, 10), st.data())
def test_any_register_comes_back_to_its_seed_after_one_period(degree, data):
    mask = data.draw(st.integers(1 << (degree - 1), (1 << degree) - 1))
    seed = data.draw(st.integers(1, (1 << degree) - 1))
    code = codes.glfsr(degree, mask, seed)
    state, chips = seed, []
    for _ in range(2 * len(code)):
        chips.append(1 if state & 1 else -1)
        state = (state >> 1) ^ (mask if state & 1 else 0)
    assert np.array_equal(np.resize(code, 2 * len(code)), chips)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ({"code": "gold", "length": 255}, ["255", "no preferred pair", "gold_paper"]),
        ({"code": "glfsr", "degree": 25}, ["25", "1 to 24"]),
        ({"code": "glfsr", "degree": 8, "seed": 0}, ["seed", "1 to 255"]),
        ({"code": "glfsr", "degree": 8, "mask": 0x40}, ["mask", "bit 7"]),
        ({"code": "glfsr"}, ["degree", "missing"]),
        ({"code": "glfsr", "degree": 8.0, "colour": 1}, ["integer", "colour: unknown key"]),
        ({"code": "barker"}, ["barker", "zadoff_chu"]),
        ({"code": "ga128", "samples_per_chip": 0}, ["samples_per_chip", "0"]),
        ({"code": "zadoff_chu", "length": 9, "root": 3}, ["root", "factor in common"]),
    ],
)
def test_a_wrong_code_is_refused_with_its_limit(spec, words):
    with pytest.raises(CastError) as error:
        codes.from_spec(spec)
    assert all(word in str(error.value) for word in words)
