# SPDX-License-Identifier: GPL-3.0-or-later
"""The kernel equals the NumPy reference, whatever the network, chunking, threads and instructions."""

import numpy as np
import pytest
from gr_cast import blocks
from gr_cast.emulation.reference import LinkUpdate, emulate
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st


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
