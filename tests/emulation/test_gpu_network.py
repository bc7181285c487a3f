# SPDX-License-Identifier: GPL-3.0-or-later
"""A network as a graphics card computes it equals the reference: any links, updates, chunks, forms. Here on NumPy; the same tests
run on a card with CAST_DEVICE=cuda."""

import os

import numpy as np
import pytest
from gr_cast.core.errors import CastError
from gr_cast.emulation.gpu.device import open_device
from gr_cast.emulation.gpu.form import Form
from gr_cast.emulation.gpu.links import Table
from gr_cast.emulation.gpu.network import DeviceNetwork
from gr_cast.emulation.reference import FixedPoint, LinkUpdate, emulate, receiver_noise

N_TAPS = 60
LIMIT_DB = {"fp32": -125, "split": -120, "tf32": -65, "fp16": -65}
FORMS = [("direct", "fp32", 512)] + [("overlap-save", p, 1024 if p == "fp32" else 512) for p in LIMIT_DB]


@pytest.fixture(scope="module")
def ops():
    return open_device(os.environ.get("CAST_DEVICE", "numpy"))


def network(ops, method, precision, n_bins, n_inputs=3, n_outputs=2, **more):
    form = Form(n_inputs=n_inputs, n_outputs=n_outputs, n_taps=N_TAPS, method=method, precision=precision, n_bins=n_bins)
    return DeviceNetwork(ops, form, **more)


def samples(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def random_updates(rng, n, n_samples, n_inputs=3, n_outputs=2):
    """Updates of all kinds at any samples, some of them at the beginning."""
    for k in range(n):
        taps = np.zeros(N_TAPS, complex)
        taps[rng.choice(N_TAPS, 4, replace=False)] = samples(rng, 4)
        kind = rng.integers(5) if k > 5 else 0
        yield LinkUpdate(
            tx=int(rng.integers(n_inputs)),
            rx=int(rng.integers(n_outputs)),
            at_sample=0 if k < 6 else int(rng.integers(n_samples)),
            taps=None if kind == 4 else taps,
            enabled=bool(rng.integers(2)) if kind == 4 else None,
            base_loss_db=float(rng.uniform(-3, 20)) if kind == 3 else None,
            ramp_samples=int(rng.integers(1, 900)) if kind == 1 else 0,
        )


def send(net, update):
    if update.taps is not None:
        delays = np.flatnonzero(update.taps)
        net.set_sparse_taps(update.tx, update.rx, delays, update.taps[delays], update.at_sample, update.ramp_samples)
    if update.base_loss_db is not None:
        net.set_base_loss(update.tx, update.rx, update.base_loss_db, update.at_sample)
    if update.enabled is not None:
        net.enable_link(update.tx, update.rx, update.enabled, update.at_sample)


def in_chunks(net, x, rng=None):
    """All samples, in chunks of any size."""
    past = np.concatenate([np.zeros((len(x), N_TAPS - 1), np.complex64), x], axis=1)
    cuts = [0, *np.sort(rng.choice(x.shape[1], 4, replace=False)), x.shape[1]] if rng else [0, x.shape[1]]
    return np.concatenate([net.process(past[:, a : b + N_TAPS - 1]) for a, b in zip(cuts, cuts[1:], strict=False)], axis=1)


def error_db(got, wanted):
    return 10 * np.log10(np.mean(np.abs(got - wanted) ** 2) / np.mean(np.abs(wanted) ** 2))


@pytest.mark.parametrize(("method", "precision", "n_bins"), FORMS)
@pytest.mark.parametrize("seed", range(3))
def test_any_network_equals_the_reference_for_any_updates_and_chunks(ops, method, precision, n_bins, seed):
    rng = np.random.default_rng(seed)
    x = samples(rng, 3, 4000)
    updates = list(random_updates(rng, 25, 4000))
    net = network(ops, method, precision, n_bins, seed=9, share=1e-9 if seed == 1 else 0.1)  # pieces of one tile, too
    for update in updates:
        send(net, update)
    net.set_noise_power(1, 0.1)
    wanted = emulate(x, updates, 2, noise_power=(0, 0.1), seed=9)
    assert error_db(in_chunks(net, x, rng), wanted) < LIMIT_DB[precision]


@pytest.mark.parametrize("method", ["direct", "overlap-save"])
def test_new_taps_of_all_links_hold_from_their_sample_on(ops, method):
    net, rng = network(ops, method, "fp32", 512), np.random.default_rng(1)
    x = np.ones((3, 3000), np.complex64)
    tables = [samples(rng, 2, 3, 1) for _ in range(3)]
    for at, gains in zip((0, 1234, 2001), tables, strict=True):
        net.set_network(at, Table(delays=np.zeros((2, 3, 1)), gains=gains))
    y = in_chunks(net, x)
    for a, b, gains in zip((0, 1234, 2001), (1234, 2001, 3000), tables, strict=True):
        np.testing.assert_allclose(y[:, a:b], np.broadcast_to(gains.sum(axis=(1, 2))[:, None], (2, b - a)), atol=2e-5)


@pytest.mark.parametrize("method", ["direct", "overlap-save"])
def test_a_ramp_turns_where_it_is_when_another_interrupts_it(ops, method):
    net = network(ops, method, "fp32", 512)
    net.set_sparse_taps(0, 0, [0], [1.0], 100, 1000)
    net.set_sparse_taps(0, 0, [0], [0.0], 600, 500)
    wanted = np.interp(np.arange(2000), [100, 600, 1100], [0, 0.5, 0])
    np.testing.assert_allclose(in_chunks(net, np.ones((3, 2000), np.complex64))[0], wanted, atol=2e-6)


def test_a_tap_of_one_is_a_copy_to_the_last_bit_in_the_direct_form(ops):
    net = network(ops, "direct", "fp32", 512)
    net.set_sparse_taps(2, 1, [17], [1.0])
    x = samples(np.random.default_rng(2), 3, 1000)
    assert np.array_equal(in_chunks(net, x)[1, 17:], x[2, :-17])


@pytest.mark.parametrize(("method", "precision", "n_bins"), FORMS[:3])
def test_fixed_point_rounds_and_counts_as_the_reference_does(ops, method, precision, n_bins):
    rng = np.random.default_rng(4)
    arithmetic = FixedPoint(bits=10, tap_bits=9, input_full_scale=2.5, output_full_scale=3.0)
    x, updates = samples(rng, 3, 3000), list(random_updates(rng, 8, 3000))
    net = network(ops, method, precision, n_bins)
    net.set_fixed_point(10, 9, 2.5, 3.0)
    for update in updates:
        send(net, update)
    got, wanted = in_chunks(net, x), emulate(x, updates, 2, fixed_point=arithmetic)
    step = 3.0 / 512
    assert np.max(np.abs(got - wanted)) <= 1.5 * step  # rounded the other way
    assert np.mean(np.abs(got - wanted) > step / 2) < 2e-3
    beyond = np.abs(np.stack([wanted.real, wanted.imag])).max(axis=0) >= 3.0 - step
    clipped_in = (np.rint(np.abs(np.stack([x.real, x.imag])) * 512 / 2.5) > 511).any(axis=0).sum()
    assert beyond.sum() > 0 and net.clipped_samples() == pytest.approx(clipped_in + beyond.sum(), rel=0.1)


def test_fixed_point_lets_nothing_pass_that_is_no_number(ops):
    rng = np.random.default_rng(5)
    x, updates = samples(rng, 3, 1000), list(random_updates(rng, 4, 1000))
    x[0, 100:140], x[1, 120:160] = complex(np.nan, 0.1), complex(-np.inf, np.nan)
    net = network(ops, *FORMS[0])
    net.set_fixed_point(10, 9, 2.5, 3.0)
    for update in updates:
        send(net, update)
    arithmetic = FixedPoint(bits=10, tap_bits=9, input_full_scale=2.5, output_full_scale=3.0)
    wanted = emulate(x, updates, 2, fixed_point=arithmetic)
    assert np.max(np.abs(in_chunks(net, x) - wanted)) <= 1.5 * 3.0 / 512 and net.clipped_samples() >= 60


def test_samples_of_sixteen_bits_are_those_of_floats_and_saturate(ops):
    rng = np.random.default_rng(5)
    x16 = rng.integers(-32768, 32768, (3, N_TAPS - 1 + 2000, 2), dtype=np.int16)
    x16[:, : N_TAPS - 1] = 0
    x = (x16[..., 0] + 1j * x16[..., 1]) / 32768 * 2
    updates = list(random_updates(rng, 6, 2000))
    net = network(ops, "overlap-save", "fp16", 512)
    net.set_samples(int16_in=True, int16_out=True, input_full_scale=2.0, output_full_scale=5.0)
    for update in updates:
        send(net, update)
    on_device = ops.upload(x16)
    got = ops.download(net.run(on_device[:, : N_TAPS - 1], on_device[:, N_TAPS - 1 :])) * (5 / 32768)
    wanted = emulate(x[:, N_TAPS - 1 :], updates, 2)
    wanted = np.clip(wanted.real, -5, 5) + 1j * np.clip(wanted.imag, -5, 5)
    assert error_db(got[..., 0] + 1j * got[..., 1], wanted) < -65
    assert net.clipped_samples() > 0


def test_halves_keep_links_that_are_hundred_db_apart(ops):
    """Alone on the air, a link 100 dB below the loudest of its receiver has the same relative error."""
    net = network(ops, "overlap-save", "fp16", 512)
    net.set_sparse_taps(0, 0, [3], [1.0])
    net.set_sparse_taps(1, 0, [5, 40], [1e-5, 0.5e-5j])
    net.set_sparse_taps(1, 1, [7], [1e-9])
    x = samples(np.random.default_rng(6), 3, 2000)
    x[[0, 2]] = 0
    y = in_chunks(net, x)
    wanted = 1e-5 * np.r_[np.zeros(5), x[1, :-5]] + 0.5e-5j * np.r_[np.zeros(40), x[1, :-40]]
    assert error_db(y[0], wanted) < -65
    assert error_db(y[1], 1e-9 * np.r_[np.zeros(7), x[1, :-7]]) < -65


def test_noise_is_the_references_at_any_sample(ops):
    net = network(ops, "direct", "fp32", 512, seed=(3 << 32) + 1)
    net.skip_to(2**33 + 5)
    net.set_noise_power(1, 1.0)
    y = net.process(np.zeros((3, N_TAPS - 1 + 500)))
    np.testing.assert_allclose(y[1], receiver_noise((3 << 32) + 1, 1, 500, 2**33 + 5), atol=5e-6)
    assert not y[0].any()


def test_skipping_leaves_updates_and_ramps_where_processing_does(ops):
    rng = np.random.default_rng(7)
    x, updates = samples(rng, 3, 3000), list(random_updates(rng, 20, 3000))
    net = network(ops, "direct", "fp32", 512)
    for update in updates:
        send(net, update)
    net.skip_to(1700)
    y = net.process(x[:, 1700 - (N_TAPS - 1) :])
    assert error_db(y, emulate(x, updates, 2)[:, 1700:]) < -125


def test_a_late_update_holds_from_the_next_sample_on_and_counts(ops):
    net = network(ops, "direct", "fp32", 512)
    net.process(np.zeros((3, N_TAPS - 1 + 100)))
    net.set_sparse_taps(0, 0, [0], [2.0], 40)
    x = np.ones((3, N_TAPS - 1 + 10), np.complex64)
    assert net.links.late == 1 and np.array_equal(net.process(x)[0], np.full(10, 2))


@pytest.mark.parametrize(
    "wrong", [(0, 2, [0], [1]), (3, 0, [0], [1]), (0, 0, [60], [1]), (0, 0, [0], [np.nan]), (0, 0, [0, 1], [1])]
)
def test_a_malformed_update_is_refused_and_changes_nothing(ops, wrong):
    net = network(ops, "direct", "fp32", 512)
    with pytest.raises(CastError):
        net.set_sparse_taps(*wrong)
    assert not net.process(np.ones((3, N_TAPS - 1 + 10))).any()


@pytest.mark.parametrize("delay", [-1, N_TAPS, 1 << 16, (1 << 16) + 3])
def test_a_delay_that_no_table_holds_is_refused_and_not_wrapped(ops, delay):
    delays = np.zeros((2, 3, 1), int)
    delays[1, 2] = delay
    with pytest.raises(CastError, match=f"delay: got .*{delay}"):
        network(ops, "direct", "fp32", 512).set_network(None, Table(delays=delays, gains=np.ones((2, 3, 1))))


def test_a_network_whose_delays_no_table_holds_is_refused():
    with pytest.raises(CastError, match="taps: got 65537"):
        Form(n_inputs=1, n_outputs=1, n_taps=(1 << 16) + 1, method="direct")
