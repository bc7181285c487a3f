# SPDX-License-Identifier: GPL-3.0-or-later
"""The block against the NumPy reference, in real flowgraphs."""

import time

import numpy as np
import pmt
import pytest
from gnuradio import blocks as stock
from gnuradio import gr
from gr_cast import blocks
from gr_cast.emulation.reference import FixedPoint, LinkUpdate, emulate

N_TAPS = 512


def noise(rng, *shape):
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def tag(offset, key, value):
    made = gr.tag_t()
    made.offset, made.key, made.value = offset, pmt.intern(key), pmt.to_pmt(value)
    return made


def post(emulator, message):
    emulator.to_basic_block()._post(pmt.intern("taps"), pmt.to_pmt(message))


def play(emulator, inputs, tags=None, chunk=None):
    """Run the block over `inputs`; outputs (M, samples) and the sinks, for their tags."""
    if chunk:
        emulator.set_max_noutput_items(chunk)
    top = gr.top_block()
    tags = tags or {}
    sources = [stock.vector_source_c(x.tolist(), False, 1, tags.get(i, [])) for i, x in enumerate(inputs)]
    sinks = [stock.vector_sink_c() for _ in range(emulator.output_signature().max_streams())]
    for i, source in enumerate(sources):
        top.connect(source, (emulator, i))
    for j, sink in enumerate(sinks):
        top.connect((emulator, j), sink)
    top.run()
    return np.array([sink.data() for sink in sinks], dtype=np.complex64), sinks


def relative_error(got, expected):
    return np.max(np.abs(got - expected)) / np.max(np.abs(expected))


def update_message(update):
    message = {"tx": update.tx, "rx": update.rx, "offset": update.at_sample, "ramp": update.ramp_samples}
    return message | {"taps": np.asarray(update.taps, dtype=np.complex64)}


def random_network(rng, n_inputs, n_outputs, n_samples, n_updates):
    updates = []
    for tx in range(n_inputs):
        for rx in range(n_outputs):
            for k in range(n_updates):
                taps = np.zeros(N_TAPS, complex)
                taps[rng.choice(N_TAPS, 4, replace=False)] = noise(rng, 4)
                at = 0 if k == 0 else int(rng.integers(n_samples))
                updates.append(LinkUpdate(tx=tx, rx=rx, at_sample=at, taps=taps, ramp_samples=int(rng.choice([0, 700]))))
    return updates


def test_unit_tap_is_a_copy_to_the_last_bit():
    rng = np.random.default_rng(1)
    x = noise(rng, 1, 10_007)
    x[0, 17] = complex(np.nan, np.inf)
    x[0, 18] = complex(-0.0, 1e-40)
    emulator = blocks.channel_emulator(1, 1)
    emulator.set_taps(0, 0, [1])
    y, _ = play(emulator, x)
    assert y.tobytes() == x.tobytes()


def test_nothing_passes_without_a_tap():
    y, _ = play(blocks.channel_emulator(2, 3), noise(np.random.default_rng(1), 2, 5000))
    assert y.shape == (3, 5000) and not y.any()


@pytest.mark.parametrize("chunk", [1, 37, 1000, None])
@pytest.mark.parametrize("n_threads", [1, 3])
def test_block_equals_the_reference_for_any_chunking_and_threads(chunk, n_threads):
    rng = np.random.default_rng(7)
    x = noise(rng, 3, 20_011 if chunk != 1 else 1500)
    updates = random_network(rng, 3, 2, x.shape[1], 6)
    emulator = blocks.channel_emulator(3, 2, n_threads=n_threads)
    for update in updates:
        emulator.set_taps(update.tx, update.rx, update.taps, update.at_sample, update.ramp_samples)
    y, _ = play(emulator, x, chunk=chunk)
    assert y.shape == (2, x.shape[1])
    assert relative_error(y, emulate(x, updates, 2)) < 1e-6
    assert emulator.late_updates() == 0


def test_tags_and_messages_change_taps_at_their_sample():
    rng = np.random.default_rng(3)
    x = noise(rng, 2, 9000)
    updates = [
        LinkUpdate(tx=0, rx=1, taps=[0, 1j]),
        LinkUpdate(tx=0, rx=1, at_sample=1234, taps=[0.5, 0, 2]),
        LinkUpdate(tx=1, rx=0, at_sample=4321, taps=[-1j], ramp_samples=555),
        LinkUpdate(tx=1, rx=1, at_sample=8000, taps=[3]),
    ]
    emulator = blocks.channel_emulator(2, 2, sample_rate_hz=1e6)
    post(emulator, [update_message(updates[0]), update_message(updates[2])])
    timed = {"tx": 1, "rx": 1, "delays": [0], "gains": np.array([3], np.complex64), "time": (7, 0.007)}
    at_tag = {"rx": 1, "taps": np.array([0.5, 0, 2], np.complex64)}
    clock = tag(0, "rx_time", (6, 0.999))
    post(emulator, {"tx": 0, "rx": 0, "taps": np.zeros(1, np.complex64)})
    y, _ = play(emulator, x, {0: [clock, tag(1234, "taps", at_tag), tag(100, "taps", timed)]})
    assert relative_error(y, emulate(x, updates, 2)) < 1e-6
    assert emulator.late_updates() == 0 and emulator.refused_updates() == 0


@pytest.mark.parametrize("chunk", [100, None])
def test_late_update_in_a_tag_is_counted_and_holds_from_the_tag(chunk):
    x = np.ones((1, 6000), np.complex64)
    emulator = blocks.channel_emulator(1, 1)
    late = {"tx": 0, "rx": 0, "taps": np.array([1], np.complex64), "offset": 10}
    y, _ = play(emulator, x, {0: [tag(5000, "taps", late)]}, chunk=chunk)
    assert emulator.late_updates() == 1
    assert np.array_equal(np.flatnonzero(y), np.arange(5000, 6000))


@pytest.mark.parametrize(
    "bad",
    [
        7,
        {},
        {"tx": 0, "rx": 0},
        {"tx": 0, "rx": 9, "taps": np.ones(1, np.complex64)},
        {"tx": -1, "rx": 0, "taps": np.ones(1, np.complex64)},
        {"tx": 0, "rx": 0, "taps": np.ones(N_TAPS + 1, np.complex64)},
        {"tx": 0, "rx": 0, "taps": np.array([np.nan], np.complex64)},
        {"tx": 0, "rx": 0, "taps": "x"},
        {"tx": 0, "rx": 0, "delays": [1, 2], "gains": np.ones(1, np.complex64)},
        {"tx": 0, "rx": 0, "delays": [-1], "gains": np.ones(1, np.complex64)},
        {"tx": 0, "rx": 0, "delays": [1]},
        {"tx": 0, "rx": 0, "taps": np.ones(1, np.complex64), "offset": -1},
        {"tx": 0, "rx": 0, "taps": np.ones(1, np.complex64), "time": 1.5},
        {"tx": 0, "rx": 0, "taps": np.ones(1, np.complex64), "ofset": 3},
        {"tx": 0, "rx": 0, "enabled": 1},
        [{"tx": 0, "rx": 0, "taps": np.zeros(1, np.complex64)}, {"tx": 0}],
    ],
)
def test_malformed_update_is_refused_and_the_flow_goes_on(bad):
    x = np.ones((1, 6000), np.complex64)
    emulator = blocks.channel_emulator(1, 1)
    emulator.set_taps(0, 0, [1])
    post(emulator, bad)
    y, _ = play(emulator, x, {0: [tag(10, "taps", bad)]})
    assert emulator.refused_updates() == 2
    assert np.array_equal(y, x)


def test_link_switches_off_and_on_at_the_sample():
    x = np.ones((1, 9000), np.complex64)
    emulator = blocks.channel_emulator(1, 1)
    emulator.set_taps(0, 0, [2])
    emulator.enable_link(0, 0, False, 1000)
    emulator.enable_link(0, 0, True, 7001)
    y, _ = play(emulator, x)
    assert np.array_equal(np.flatnonzero(y[0] == 0), np.arange(1000, 7001))


def test_stream_tags_reach_every_receiver_once_and_others_follow_their_node():
    x = np.ones((2, 5000), np.complex64)
    emulator = blocks.channel_emulator(2, 3)
    time = tag(4, "rx_time", (1, 0.5))
    _, sinks = play(emulator, x, {0: [time, tag(9, "burst", 0)], 1: [time, tag(9, "burst", 1)]})
    seen = [[(t.offset, str(t.key), str(t.value)) for t in sink.tags()] for sink in sinks]
    stream = (4, "rx_time", "{1 0.5}")
    assert seen == [[stream, (9, "burst", "0")], [stream, (9, "burst", "1")], [stream]]


def test_status_says_scenario_plan_and_samples():
    emulator = blocks.channel_emulator(1, 1, 512, 1e6, 1, "four taps")
    emulator.set_sparse_taps(0, 0, [0, 3], [1, 0.5])
    top = gr.top_block()
    store = stock.message_debug(False)
    top.connect(stock.vector_source_c([1] * 1000), emulator, stock.null_sink(8))
    top.msg_connect(emulator, "status", store, "store")
    top.run()
    first = pmt.to_python(store.get_message(0))
    assert first["scenario"] == "four taps" and first["samples"] == 0
    assert "sparse" in first["plan"] and first["active_links"] == 1 and first["active_taps"] == 2


@pytest.mark.parametrize("chunk", [777, None])
def test_noise_and_base_loss_are_those_of_the_reference(chunk):
    x = noise(np.random.default_rng(3), 1, 9001)
    updates = [
        LinkUpdate(tx=0, rx=1, taps=[0.5, 1j], base_loss_db=6),
        LinkUpdate(tx=0, rx=1, at_sample=4000, base_loss_db=20),
    ]
    emulator = blocks.channel_emulator(1, 2, seed=2**40 + 7)
    emulator.set_taps(0, 1, [0.5, 1j])
    emulator.set_base_loss(0, 1, 6)
    emulator.set_base_loss(0, 1, 20, 4000)
    emulator.set_noise_power(0, 4.0)
    emulator.set_noise_power(1, 0.01)
    y, _ = play(emulator, x, chunk=chunk)
    expected = emulate(x, updates, 2, noise_power=[4.0, 0.01], seed=2**40 + 7)
    assert np.max(np.abs(y - expected)) < 1e-5


def test_fixed_point_is_that_of_the_reference_and_counts_what_it_cuts_off():
    rng = np.random.default_rng(4)
    x = 0.2 * noise(rng, 2, 20_000)
    x[0, 100:110] = 5
    updates = [LinkUpdate(tx=i, rx=0, taps=noise(rng, 3) / 3) for i in range(2)]
    emulator = blocks.channel_emulator(2, 1)
    for update in updates:
        emulator.set_taps(update.tx, 0, update.taps)
    emulator.set_fixed_point(12, 14, 1.0, 2.0)
    y, _ = play(emulator, x, chunk=3000)
    expected = emulate(x, updates, 1, fixed_point=FixedPoint(bits=12, tap_bits=14, output_full_scale=2.0))
    step = 2.0 / 2**11
    away = np.maximum(np.abs(y.real - expected.real), np.abs(y.imag - expected.imag)) / step
    assert np.max(away) < 1.01 and np.mean(away > 0.5) < 1e-2  # a sum within rounding of a half may go either way
    beyond = np.maximum(np.abs(x.real), np.abs(x.imag)) >= 1
    assert emulator.clipped_samples() >= np.count_nonzero(beyond) >= 10


def test_fixed_point_lets_nothing_pass_that_is_no_number():
    """A receiver of any later sample would hear it through the filter."""
    x = 0.2 * noise(np.random.default_rng(5), 2, 6000)
    x[0, 100:140] = complex(np.nan, 0.1)
    x[1, 120:160] = complex(-np.inf, np.nan)
    taps = np.array([0.5, 0, 0.25j])
    emulator = blocks.channel_emulator(2, 1)
    for tx in range(2):
        emulator.set_taps(tx, 0, taps)
    emulator.set_fixed_point(12, 14, 1.0, 2.0)
    y, _ = play(emulator, x, chunk=1000)
    updates = [LinkUpdate(tx=tx, rx=0, taps=taps) for tx in range(2)]
    expected = emulate(x, updates, 1, fixed_point=FixedPoint(bits=12, tap_bits=14, output_full_scale=2.0))
    assert np.isfinite(y).all() and np.max(np.abs(y - expected)) <= 1.5 * 2.0 / 2**11
    assert emulator.clipped_samples() == 80


def test_flowgraph_that_starts_again_keeps_its_links_and_counts_from_zero():
    emulator = blocks.channel_emulator(1, 1)
    emulator.set_taps(0, 0, [0, 1j])
    source, sink = stock.vector_source_c([1] * 5000), stock.vector_sink_c()
    top = gr.top_block()
    top.connect(source, emulator, sink)
    top.run()
    source.rewind()
    sink.reset()
    assert pmt.to_python(emulator.status())["samples"] == 5000
    emulator.set_taps(0, 0, [2], 3000)
    top.run()
    assert np.array_equal(sink.data(), np.r_[0, np.full(2999, 1j), np.full(2000, 2)])
    assert emulator.late_updates() == 0


@pytest.mark.parametrize("arguments", [(0, 1), (1, 0), (1, 1, 0), (1, 1, 512, 0.0), (1, 1, 512, 1.0, -1)])
def test_parameters_out_of_range_are_refused(arguments):
    with pytest.raises(ValueError):
        blocks.channel_emulator(*arguments)
    with pytest.raises(ValueError):
        blocks.channel_emulator(1, 1).set_taps(0, 1, [1])


def test_no_sample_passes_the_horizon_until_it_moves():
    emulator = blocks.channel_emulator(1, 1)
    emulator.set_sparse_taps(0, 0, [0], [1])
    emulator.set_horizon(70_001)
    top = gr.top_block()
    sink = stock.vector_sink_c()
    top.connect(stock.vector_source_c(np.arange(100_000).tolist()), emulator, sink)
    top.start()
    limit = time.monotonic() + 30
    while emulator.nitems_written(0) < 70_001 and time.monotonic() < limit:
        time.sleep(0.01)
    time.sleep(0.1)  # long enough to run on, if it would
    at_horizon = emulator.nitems_written(0)
    emulator.set_sparse_taps(0, 0, [0], [2], 70_001)
    emulator.set_horizon(None)
    top.wait()
    assert at_horizon == 70_001 and emulator.late_updates() == 0
    np.testing.assert_array_equal(np.real(sink.data()), np.arange(100_000) * np.repeat([1, 2], [70_001, 29_999]))


class LockStep(gr.sync_block):
    """Sends a few samples, and no more before `heard` tells that they have all come through."""

    def __init__(self, heard, turns, per_turn=100):
        gr.sync_block.__init__(self, "lock step", None, [np.complex64])
        self.heard, self.turns, self.per_turn, self.sent = heard, turns, per_turn, 0
        self.limit = time.monotonic() + 20

    def work(self, input_items, output_items):
        if self.sent == self.turns * self.per_turn or time.monotonic() > self.limit:
            return -1
        if self.heard() < self.sent:
            time.sleep(1e-3)
            return 0
        output_items[0][: self.per_turn] = 1
        self.sent += self.per_turn
        return self.per_turn


def test_what_is_there_passes_without_waiting_for_more():
    emulator = blocks.channel_emulator(1, 1)
    emulator.set_taps(0, 0, [1])
    top, sink = gr.top_block(), stock.vector_sink_c()
    source = LockStep(lambda: len(sink.data()), turns=30)
    top.connect(source, emulator, sink)
    top.run()
    assert len(sink.data()) == 30 * source.per_turn


def test_a_flowgraph_that_waits_at_the_horizon_stops_when_told():
    emulator = blocks.channel_emulator(1, 1)
    emulator.set_horizon(0)
    top = gr.top_block()
    top.connect(stock.null_source(8), emulator, stock.null_sink(8))
    top.start()
    top.stop()
    top.wait()
    assert emulator.nitems_written(0) == 0
