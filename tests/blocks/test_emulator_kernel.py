# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel equals the NumPy reference, whatever the network, chunking, threads and instructions."""

import numpy as np
import pytest
from gr_cast import blocks
from gr_cast.emulation.reference import FixedPoint, LinkUpdate, emulate, quantize, receiver_noise
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.signal import fftconvolve, lfilter


def has(isa):
    try:
        blocks.emulator_kernel(1, 1, isa=isa)
    except ValueError:
        return False
    return True


ISAS = [isa for isa in ("generic", "avx2", "avx512") if has(isa)]


def complex_noise(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@st.composite
def cases(draw):
    """A random network, its updates, and how it is run."""
    n_inputs, n_outputs = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    n_taps = draw(st.sampled_from([1, 2, 33, 300, 512, 900]))
    n_samples = draw(st.integers(1, 9000))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    updates = []
    for _ in range(draw(st.integers(0, 12))):
        taps = np.zeros(n_taps, complex)
        delays = rng.choice(n_taps, draw(st.integers(0, min(8, n_taps))), replace=False)
        taps[delays] = complex_noise(rng, len(delays))
        if draw(st.booleans()):
            taps = complex_noise(rng, n_taps)
        updates.append(
            LinkUpdate(
                tx=int(rng.integers(n_inputs)),
                rx=int(rng.integers(n_outputs)),
                taps=taps,
                at_sample=draw(st.sampled_from([0, 1, int(rng.integers(n_samples))])),
                ramp_samples=draw(st.sampled_from([0, 0, 1, 500])),
            )
        )
    cuts = sorted(rng.integers(0, n_samples, draw(st.integers(0, 6))))
    config = dict(
        n_taps=n_taps,
        n_threads=draw(st.sampled_from([1, 2, 3])),
        isa=draw(st.sampled_from(ISAS)),
        method=draw(st.sampled_from(["auto", "sparse", "dense"])),
    )
    x = complex_noise(rng, n_inputs, n_samples).astype(np.complex64)
    return x, n_outputs, updates, np.split(np.arange(n_samples), cuts), config


def run(x, n_outputs, updates, chunks, config):
    kernel = blocks.emulator_kernel(len(x), n_outputs, **config)
    for update in updates:
        delays = np.flatnonzero(update.taps)
        kernel.set_sparse_taps(update.tx, update.rx, delays, update.taps[delays], update.at_sample, update.ramp_samples)
    past = config["n_taps"] - 1
    padded = np.pad(x, ((0, 0), (past, 0)))
    return np.hstack([kernel.process(padded[:, c[0] : c[-1] + 1 + past]) for c in chunks if len(c)])


@settings(max_examples=400, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(cases())
def test_kernel_equals_the_reference(case):
    x, n_outputs, updates, chunks, config = case
    got, expected = run(*case), emulate(x, updates, n_outputs)
    assert got.shape == expected.shape
    # Relative to what the taps could bring together at most, not to what happened to cancel.
    gain = sum((np.linalg.norm(u.taps) for u in updates), start=0.0)
    assert np.max(np.abs(got - expected), initial=0) <= 1e-6 * gain * np.max(np.abs(x))


@pytest.mark.parametrize("method", ["sparse", "dense"])
def test_result_is_the_same_to_the_last_bit_for_any_number_of_threads(method):
    rng = np.random.default_rng(1)
    x = complex_noise(rng, 5, 30_000).astype(np.complex64)
    updates = [
        LinkUpdate(tx=i, rx=j, at_sample=a, taps=complex_noise(rng, 40)) for i in range(5) for j in range(5) for a in (0, 7777)
    ]
    outputs = [run(x, 5, updates, [np.arange(30_000)], dict(n_taps=512, n_threads=n, method=method)) for n in (1, 2, 5)]
    assert outputs[0].tobytes() == outputs[1].tobytes() == outputs[2].tobytes()


def test_planner_takes_the_direct_form_for_few_taps_and_overlap_save_for_many():
    for n_taps, words in ((4, "sparse"), (512, "overlap-save")):
        kernel = blocks.emulator_kernel(4, 4)
        for link in range(16):
            kernel.set_sparse_taps(link // 4, link % 4, np.arange(n_taps), np.ones(n_taps))
        assert words in kernel.plan()


@pytest.mark.parametrize("isa", ["mmx", ""])
def test_unknown_instruction_set_is_refused(isa):
    with pytest.raises(ValueError, match="expected auto"):
        blocks.emulator_kernel(1, 1, isa=isa)


@pytest.mark.parametrize(("begin", "end"), [(0.25, 1.0), (1.0, 0.25)])
def test_a_wire_that_comes_or_goes_in_a_ramp_is_no_plain_wire_meanwhile(begin, end):
    """A single tap of gain 1 is a copy, but neither on its way there nor on its way from there."""
    x = complex_noise(np.random.default_rng(1), 1, 600).astype(np.complex64)
    kernel, updates = blocks.emulator_kernel(1, 1, 4), []
    for gain, at, ramp in ((begin, 0, 0), (end, 100, 300)):
        kernel.set_sparse_taps(0, 0, [0], [gain], at, ramp)
        updates.append(LinkUpdate(tx=0, rx=0, at_sample=at, taps=np.array([gain + 0j]), ramp_samples=ramp))
    y = kernel.process(np.concatenate([np.zeros((1, 3), np.complex64), x], axis=1))
    assert y == pytest.approx(emulate(x, updates, 1), abs=1e-5)


def set_all_network(rng, order, zeros):
    """Delays and gains of 2 x 3 links with 5 taps each, and 300 samples for them."""
    delays = np.array([order(rng.choice(64, 5, replace=False)) for _ in range(6)], np.int32)
    gains = (rng.standard_normal((6, 5)) + 1j * rng.standard_normal((6, 5))).astype(np.complex64)
    gains[:, :zeros] = 0
    x = rng.standard_normal((2, 63 + 300)) + 1j * rng.standard_normal((2, 63 + 300))
    return delays, gains, x.astype(np.complex64)


@pytest.mark.parametrize("order", [np.sort, lambda delays: delays], ids=["sorted", "as drawn"])
@pytest.mark.parametrize("zeros", [0, 2])
def test_table_of_all_links_is_one_update_per_link(order, zeros):
    delays, gains, x = set_all_network(np.random.default_rng(4), order, zeros)
    table, one_by_one = (blocks.emulator_kernel(2, 3, 64) for _ in range(2))
    for offset, part in ((0, slice(0, 6)), (150, slice(None, None, -1))):
        table.set_all(offset, delays[part], gains[part])
        for row, (d, g) in enumerate(zip(delays[part], gains[part], strict=True)):
            one_by_one.set_sparse_taps(row // 3, row % 3, d, g, offset)
    np.testing.assert_array_equal(table.process(x), one_by_one.process(x))


def test_table_with_a_delay_or_a_gain_that_cannot_be_is_refused():
    delays, gains, _ = set_all_network(np.random.default_rng(4), np.sort, 0)
    kernel = blocks.emulator_kernel(2, 3, 64)
    with pytest.raises(ValueError, match="delay: got 64, expected 0 to 63"):
        kernel.set_all(0, np.full_like(delays, 64), gains)
    with pytest.raises(ValueError, match="not a finite number"):
        kernel.set_all(0, delays, gains * np.nan)


def test_samples_that_somebody_holds_stay_as_they_were():
    delays, gains, x = set_all_network(np.random.default_rng(4), np.sort, 0)
    kernel = blocks.emulator_kernel(2, 3, 64)
    kernel.set_all(0, delays, gains)
    held = [kernel.process(factor * x) for factor in (1, 2, 3, 4)]
    for factor, samples in enumerate(held, start=1):
        np.testing.assert_allclose(samples, factor * held[0], rtol=1e-6)


def heard(kernel, x, n_taps):
    return kernel.process(np.pad(np.atleast_2d(x), ((0, 0), (n_taps - 1, 0))).astype(np.complex64))


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("n_paths", [1, 2, 5])
def test_the_direct_form_is_a_filter_whatever_the_length(isa, n_paths):
    """Lengths from one sample to beyond the registers' blocks: vectors, the last one made again, and what fills none."""
    rng = np.random.default_rng(n_paths)
    for n in [*range(1, 66), 95, 96, 97, 130, 191, 193, 400]:
        x, delays = complex_noise(rng, 2, n), rng.choice(20, n_paths, replace=False)
        gains = complex_noise(rng, 2, n_paths)
        kernel = blocks.emulator_kernel(2, 1, 20, isa=isa, method="sparse")
        for i in (0, 1):
            kernel.set_sparse_taps(i, 0, delays, gains[i])
        want = 0
        for i in (0, 1):
            taps = np.zeros(20, complex)
            taps[delays] = gains[i]
            want = want + lfilter(taps, 1, x[i])
        np.testing.assert_allclose(heard(kernel, x, 20)[0], want, atol=2e-5)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("n_taps", [1, 2, 15, 16, 17, 256, 257, 512, 513, 1024, 1025])
def test_overlap_save_is_a_filter_whatever_the_taps_and_where_it_is_cut(isa, n_taps):
    rng = np.random.default_rng(n_taps)
    n = 6000
    x, taps = complex_noise(rng, 3, n), complex_noise(rng, 2, n_taps)
    for cuts in ([], [1, 700, 701, 3000], [2048]):
        kernel = blocks.emulator_kernel(3, 2, n_taps, isa=isa, method="dense")
        kernel.set_sparse_taps(0, 0, np.arange(n_taps), taps[0])
        kernel.set_sparse_taps(2, 0, np.arange(n_taps), taps[1])  # of three inputs the outer ones
        kernel.set_sparse_taps(1, 1, [n_taps - 1], [2j])
        padded = np.pad(x, ((0, 0), (n_taps - 1, 0))).astype(np.complex64)
        edges = [0, *cuts, n]
        got = np.hstack([kernel.process(padded[:, a : b + n_taps - 1]) for a, b in zip(edges, edges[1:], strict=False)])
        scale = np.linalg.norm(taps)
        np.testing.assert_allclose(got[0], lfilter(taps[0], 1, x[0]) + lfilter(taps[1], 1, x[2]), atol=2e-6 * scale * 5)
        np.testing.assert_allclose(got[1], 2j * np.append(np.zeros(n_taps - 1), x[1])[:n], atol=2e-5)


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("first", [0, 1, 1001, 2**33 - 300])
def test_every_instruction_set_makes_the_references_noise_at_any_sample(isa, first):
    seed, n = (3 << 40) + 7, 1500
    kernel = blocks.emulator_kernel(1, 3, 1, isa=isa, seed=seed)
    kernel.seek(first)
    kernel.set_noise_power(2, 4.0)
    got = np.hstack([kernel.process(np.zeros((1, k), np.complex64)) for k in (1, 250, 257, n - 508)])
    np.testing.assert_allclose(got[2], 2 * receiver_noise(seed, 2, n, first), atol=1e-5)
    assert not got[:2].any()


@pytest.mark.parametrize("isa", ISAS)
@pytest.mark.parametrize("method", ["sparse", "dense"])
def test_fixed_point_of_every_instruction_set_is_the_references_and_counts_what_is_cut_off(isa, method):
    rng = np.random.default_rng(6)
    x = 0.6 * complex_noise(rng, 2, 3000)
    x[0, [5, 700]] = 40, -40j
    taps = complex_noise(rng, 3)
    arithmetic = FixedPoint(bits=6, tap_bits=8, input_full_scale=2.0, output_full_scale=4.0)
    kernel = blocks.emulator_kernel(2, 1, 3, isa=isa, method=method)
    kernel.set_fixed_point(6, 8, 2.0, 4.0)
    kernel.set_sparse_taps(0, 0, [0, 1, 2], taps)
    kernel.set_sparse_taps(1, 0, [1], [0.5])
    updates = [LinkUpdate(tx=0, rx=0, taps=taps), LinkUpdate(tx=1, rx=0, taps=[0, 0.5])]
    want = emulate(x.astype(np.complex64), updates, 1, fixed_point=arithmetic)
    got = heard(kernel, x, 3)
    step = 4.0 / 32
    assert np.mean(got == want) > 0.99 and np.abs(got - want).max() <= step * 1.5  # half a step may round either way
    rounded = [LinkUpdate(tx=u.tx, rx=u.rx, taps=quantize(u.taps, 2.0, 8)) for u in updates]
    inside = emulate(quantize(x.astype(np.complex64), 2.0, 6), rounded, 1)

    def beyond(values, step):
        parts = np.rint(np.stack([values.real, values.imag]) / step)
        return np.sum(((parts > 31) | (parts < -32)).any(axis=0))

    cut = beyond(x, 2.0 / 32) + beyond(inside, step)
    assert kernel.clipped_samples() == pytest.approx(cut, abs=2) and cut > 10


@pytest.mark.parametrize("method", ["sparse", "dense"])
def test_ramps_that_begin_end_and_are_interrupted_anywhere_are_the_references(method):
    rng = np.random.default_rng(8)
    x, updates = complex_noise(rng, 3, 7000).astype(np.complex64), []
    for link in range(6):
        for at, ramp in ((0, 0), (500, 1000), (500, 1000), (900, 3000), (6000, 5000)):
            taps = complex_noise(rng, 40) * (rng.random(40) < 0.3)
            updates.append(LinkUpdate(tx=link % 3, rx=link // 3, at_sample=at + 10 * (link > 3), ramp_samples=ramp, taps=taps))
    config = dict(n_taps=40, n_threads=2, method=method)
    want = emulate(x, updates, 2)
    for cuts in ([], [500, 501, 2000, 3905]):
        got = run(x, 2, updates, np.split(np.arange(7000), cuts), config)
        assert np.abs(got - want).max() < 3e-5 * np.abs(want).max()


def test_what_is_skipped_changes_taps_and_ramps_as_what_is_processed_does():
    rng = np.random.default_rng(9)
    x = complex_noise(rng, 1, 3000)
    got = []
    for skips in (False, True):
        kernel = blocks.emulator_kernel(1, 1, 4)
        for at, gain, ramp in ((0, 1.0, 0), (100, 3j, 2000), (900, -1.0, 0), (1000, 2.0, 1500)):
            kernel.set_sparse_taps(0, 0, [at % 3], [gain], at, ramp)
        padded = np.pad(x, ((0, 0), (3, 0))).astype(np.complex64)
        kernel.skip_to(1500) if skips else kernel.process(padded[:, :1503])
        got.append(kernel.process(padded[:, 1500:]))
    np.testing.assert_allclose(*got, atol=1e-6)


def test_after_a_seek_taps_are_those_of_the_end_of_a_ramp_and_changes_come_at_their_samples():
    kernel = blocks.emulator_kernel(1, 1, 1)
    kernel.set_sparse_taps(0, 0, [0], [1.0])
    kernel.set_sparse_taps(0, 0, [0], [5.0], 0, 1000)
    assert kernel.process(np.ones((1, 501), np.complex64))[0, 500] == pytest.approx(3.0)
    kernel.seek(10_000)
    kernel.set_sparse_taps(0, 0, [0], [7.0], 10_003)
    assert kernel.process(np.ones((1, 6), np.complex64))[0].tolist() == [5, 5, 5, 7, 7, 7]


def test_taps_of_one_delay_add_in_any_order_and_those_that_cancel_are_none():
    kernel = blocks.emulator_kernel(1, 1, 8)
    kernel.set_sparse_taps(0, 0, [5, 2, 5, 3, 3, 2], [1, 2, 0.5j, 1, -1, 0])
    want = np.zeros(20, complex)
    want[[2, 5]] = 2, 1 + 0.5j
    np.testing.assert_allclose(heard(kernel, np.eye(1, 20), 8)[0], want)
    kernel.set_sparse_taps(0, 0, [1, 1], [1, -1])
    assert not heard(kernel, np.eye(1, 20), 8).any()


def test_base_loss_of_a_link_holds_from_its_sample_on_for_its_taps_and_ramps():
    kernel = blocks.emulator_kernel(1, 2, 1)
    for rx in (0, 1):
        kernel.set_sparse_taps(0, rx, [0], [1.0])
        kernel.set_sparse_taps(0, rx, [0], [2.0], 10, 10)
    kernel.set_base_loss(0, 1, 20.0, 15)
    y = kernel.process(np.ones((1, 30), np.complex64))
    line = np.interp(np.arange(30), [10, 20], [1, 2])
    np.testing.assert_allclose(y[0], line, atol=1e-6)
    np.testing.assert_allclose(y[1], line * np.where(np.arange(30) < 15, 1, 0.1), atol=1e-6)


@pytest.mark.parametrize(
    ("ask", "says"),
    [
        (lambda k: k.set_sparse_taps(2, 0, [0], [1]), "tx: got 2, expected 0 to 1"),
        (lambda k: k.set_sparse_taps(-1, 0, [0], [1]), "tx: got -1, expected 0 to 1"),
        (lambda k: k.set_sparse_taps(0, 3, [0], [1]), "rx: got 3, expected 0 to 2"),
        (lambda k: k.set_sparse_taps(0, 0, [8], [1]), "delay: got 8, expected 0 to 7 samples"),
        (lambda k: k.set_sparse_taps(0, 0, [0, -1], [1, 1]), "delay: got -1, expected 0 to 7 samples"),
        (lambda k: k.set_sparse_taps(0, 0, [0, 3], [1, complex(0, np.inf)]), "tap at delay 3: not a finite number"),
        (lambda k: k.set_sparse_taps(0, 0, [0, 3], [1, np.nan]), "tap at delay 3: not a finite number"),
        (lambda k: k.set_sparse_taps(0, 0, [0, 3], [1]), "got 2 delays and 1 gains"),
        (lambda k: k.set_sparse_taps(0, 0, [0], [1], 2**62 + 1), "offset or ramp: got 4611686018427387905"),
        (lambda k: k.set_sparse_taps(0, 0, [0], [1], 0, 2**62 + 1), "offset or ramp: got 4611686018427387905"),
        (lambda k: k.set_base_loss(0, 0, -np.inf), "gain of the link: not a finite number"),
        (lambda k: k.set_noise_power(3, 1.0), "rx: got 3, expected 0 to 2"),
        (lambda k: k.set_noise_power(-1, 1.0), "rx: got -1, expected 0 to 2"),
        (lambda k: k.set_noise_power(0, -1e-9), "noise power"),
        (lambda k: k.set_noise_power(0, np.inf), "noise power"),
        (lambda k: k.set_fixed_point(1, 8, 1.0, 1.0), "bits: got 1"),
        (lambda k: k.set_fixed_point(25, 8, 1.0, 1.0), "bits: got 25"),
        (lambda k: k.set_fixed_point(8, 1, 1.0, 1.0), "tap_bits: got 1"),
        (lambda k: k.set_fixed_point(8, 25, 1.0, 1.0), "tap_bits: got 25"),
        (lambda k: k.set_fixed_point(8, 8, 0.0, 1.0), "full scale"),
        (lambda k: k.set_fixed_point(8, 8, 1.0, np.inf), "full scale"),
        (lambda k: k.set_all(0, [[0, 0]] * 6, [[1, 1]] * 5), "expected shape"),
        (lambda k: k.set_all(2**62 + 1, np.zeros((6, 1), np.int32), np.ones((6, 1))), "offset or ramp"),
        (lambda k: k.process(np.zeros((2, 6), np.complex64)), "inputs: expected shape"),
        (lambda k: k.process(np.zeros((3, 9), np.complex64)), "inputs: expected shape"),
    ],
)
def test_what_cannot_be_is_refused_and_changes_nothing(ask, says):
    kernel = blocks.emulator_kernel(2, 3, 8)
    kernel.set_sparse_taps(0, 0, [7], [1j])
    with pytest.raises(ValueError, match=says):
        ask(kernel)
    y = heard(kernel, np.eye(2, 20), 8)
    assert np.flatnonzero(y[0]).tolist() == [7] and not y[1:].any()


def test_what_may_be_at_most_may_be():
    kernel = blocks.emulator_kernel(2, 3, 8)
    for ask in (
        lambda: kernel.set_sparse_taps(1, 2, [0, 7], [1, 1], 2**62, 2**62), lambda: kernel.set_noise_power(2, 0.0),
        lambda: kernel.set_fixed_point(2, 2, 1e-9, 1e9), lambda: kernel.set_fixed_point(24, 24, 1.0, 1.0),
        lambda: kernel.set_all(2**62, np.zeros((6, 1), np.int32), np.ones((6, 1))),
        lambda: kernel.set_all(0, np.zeros((6, 0), np.int32), np.ones((6, 0))),
    ):  # fmt: skip
        ask()
    assert kernel.process(np.zeros((2, 7), np.complex64)).shape == (3, 0)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [(dict(n_inputs=0), "n_inputs"), (dict(n_outputs=0), "n_outputs"), (dict(n_taps=0), "n_taps"),
     (dict(n_threads=0), "n_threads"), (dict(method="fast"), "method: got 'fast'")],
)  # fmt: skip
def test_a_kernel_of_nothing_is_refused(wrong, says):
    with pytest.raises(ValueError, match=says):
        blocks.emulator_kernel(**dict(n_inputs=1, n_outputs=1) | wrong)
    blocks.emulator_kernel(1, 1, 1, 1)


@pytest.mark.parametrize(
    ("n_taps", "bins"), [(1, 1024), (256, 1024), (257, 2048), (512, 2048), (513, 4096), (1024, 4096), (1025, 8192)]
)
def test_the_plan_tells_form_bins_instructions_and_threads(n_taps, bins):
    kernel = blocks.emulator_kernel(1, 2, n_taps, method="dense", isa="generic")
    kernel.set_sparse_taps(0, 1, [0], [2.0])
    assert kernel.plan() == f"sparse direct form and dense overlap-save in {bins} bins for 1 of 2 outputs, generic, 1 thread"
    assert blocks.emulator_kernel(1, 1, n_taps, 2, "generic").plan() == "sparse direct form, generic, 2 threads"
    both = blocks.emulator_kernel(2, 1, n_taps, 1, "generic", "dense")
    both.set_sparse_taps(0, 0, [0], [2.0])
    both.set_sparse_taps(1, 0, [0], [2.0])
    assert both.plan() == f"dense overlap-save in {bins} bins for 1 of 1 outputs, generic, 1 thread"
    direct = blocks.emulator_kernel(2, 1, n_taps, 1, "generic", "sparse")
    direct.set_sparse_taps(0, 0, np.arange(n_taps), np.ones(n_taps))
    assert direct.plan() == "sparse direct form, generic, 1 thread"


def test_a_plain_wire_is_no_work_for_a_transform():
    for gain, form in ((1.0, "sparse direct form, "), (1.0001, "dense overlap-save")):
        kernel = blocks.emulator_kernel(1, 1, 8, method="dense", isa="generic")
        kernel.set_sparse_taps(0, 0, [3], [gain])
        assert kernel.plan().startswith(form)


@pytest.mark.parametrize("n_threads", [1, 3])
def test_long_runs_are_cut_into_rounds_and_tiles_that_nobody_hears(n_threads):
    rng = np.random.default_rng(10)
    n = 200_000
    x = complex_noise(rng, 2, n)
    for n_paths, method in ((3, "sparse"), (300, "auto")):
        taps = np.zeros((2, 512), complex)
        taps[:, rng.choice(512, n_paths, replace=False)] = complex_noise(rng, 2, n_paths)
        kernel = blocks.emulator_kernel(2, 1, 512, n_threads, method=method)
        for i in (0, 1):
            kernel.set_sparse_taps(i, 0, np.flatnonzero(taps[i]), taps[i, np.flatnonzero(taps[i])])
        want = sum(fftconvolve(x[i], taps[i])[:n] for i in (0, 1))
        assert np.abs(heard(kernel, x, 512)[0] - want).max() < 1e-5 * np.abs(want).max()
