# SPDX-License-Identifier: GPL-3.0-or-later
"""A network on a card, measured: alone, with all samples coming and going beside bare copies of them, its error, its energy."""

import time
from dataclasses import dataclass

import numpy as np
from gr_cast.emulation.gpu.form import DELAY_TYPE
from gr_cast.emulation.gpu.links import Table
from gr_cast.emulation.gpu.network import DeviceNetwork
from gr_cast.emulation.gpu.planner import error_db
from gr_cast.emulation.gpu.stream import Stream

N_TAPS, TAPS = 512, 4
TABLES = 8  # of taps, taken in turns
TURNS = 5  # of every measurement; the best counts
FEWEST = 6  # chunks of a turn
LATE = 20  # chunks that are alone on their way
ENERGY_S = 2.0  # over which joules are counted: a card tells them some ten times a second


def random_table(ops, rng, nodes: int) -> Table:
    shape = (nodes, nodes, TAPS)
    delays, gains = ops.pinned(shape, DELAY_TYPE), ops.pinned(shape, np.complex64)
    delays[...] = np.sort(rng.integers(0, N_TAPS, shape), axis=-1)
    gains[...] = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2 * TAPS)
    return Table(delays=delays, gains=gains)


@dataclass(frozen=True, kw_only=True)
class Setup:
    """A network with a stream of int16 chunks through it, and the taps that it gets in turns, every `period` samples."""

    network: DeviceNetwork
    stream: Stream
    tables: list[Table]
    period: int
    full_scale: float  # of samples out

    @property
    def shape(self) -> tuple[int, int]:
        return self.stream.take().shape[:2]

    def new_taps(self) -> None:
        """Others for every period of the next chunk."""
        begin = self.network.position
        for at in range(begin, begin + self.shape[1], self.period):
            self.network.set_network(at, self.tables[at // self.period % TABLES])

    def emptied(self) -> None:
        while self.stream.under_way:
            self.stream.wait()


def set_up(ops, form, period: int, periods: int, is_int16_out: bool) -> Setup:
    network = DeviceNetwork(ops, form)
    # Transmitters of a fifth of full scale meet in a receiver: five times their root mean square is full scale there.
    full_scale = float(np.sqrt(form.n_inputs))
    network.set_samples(int16_in=True, int16_out=is_int16_out, output_full_scale=full_scale)
    rng = np.random.default_rng(3)
    tables = [random_table(ops, rng, form.n_inputs) for _ in range(TABLES)]
    return Setup(network=network, stream=Stream(network, periods * period), tables=tables, period=period, full_scale=full_scale)


def noise16(rng, shape):
    return np.rint(np.clip(0.2 / np.sqrt(2) * rng.standard_normal((*shape, 2), np.float32), -1, 0.99) * 32768).astype(np.int16)


def check(setup: Setup) -> float:
    """Error in dB of a fresh chunk whose taps change at its beginning, and which hears the end of the chunk before."""
    setup.emptied()
    rng, network, past = np.random.default_rng(), setup.network, N_TAPS - 1
    sent = [noise16(rng, setup.shape) for _ in range(2)]
    for samples, table in zip(sent, setup.tables, strict=False):
        network.set_network(None, table)
        setup.stream.take()[...] = samples
        setup.stream.push()
        heard = setup.stream.wait()
    if network.ends.int16_out:
        heard = (heard[..., 0] + 1j * heard[..., 1].astype(np.float32)) * np.float32(setup.full_scale / 32768)
    samples = np.concatenate([sent[0][:, -past:], sent[1]], axis=1)
    return error_db(heard, samples, past, setup.tables[1].delays, setup.tables[1].gains, seed=None)


def on_card(setup: Setup, seconds: float):
    """Chunks per second, and joules per chunk if the card tells, of samples that lie on the card; taps come from outside."""
    network, ops, rng = setup.network, setup.network.ops, np.random.default_rng(4)
    inputs = [ops.upload(noise16(rng, setup.shape)) for _ in range(2)]
    outs = [network.run(*inputs) for _ in range(2)]
    ways = ops.ways(1)

    def turn(n):
        with ways.computing(0):
            for k in range(n):
                setup.new_taps()
                network.run(inputs[(k + 1) % 2], inputs[k % 2], outs[k % 2])
            ops.synchronize()

    (rates,) = paced(seconds, turn)
    return max(rates), joules(turn, max(rates))


class NoNetwork:
    """Leaves samples where they are: what remains of a stream are its copies, a chunk's way down behind its way up."""

    def run(self, before, now, out) -> None:
        pass


def there_and_back(setup: Setup, seconds: float) -> dict:
    """The same from pinned memory to pinned memory, beside bare copies of the samples: chunks per second; seconds that a chunk
    is on its way: median and worst, and alone."""
    stream, took, alone, rng = setup.stream, [], [], np.random.default_rng(5)
    setup.emptied()
    for _ in range(stream.depth):  # samples to be sent again and again: to make them takes longer than to send them
        stream.take()[...] = noise16(rng, setup.shape)
        stream.push()
    setup.emptied()

    def turn(n):
        took.clear()
        for _ in range(n):
            if stream.under_way == stream.depth:
                stream.wait()
                took.append(stream.took_s())
            setup.new_taps()
            stream.push()
        setup.emptied()

    def bare(n):
        stream.network = NoNetwork()
        for _ in range(n):
            if stream.under_way == stream.depth:
                stream.wait()
            stream.push()
        setup.emptied()
        stream.network = setup.network

    both, copies = paced(seconds, turn, bare)
    turn(max(LATE, round(max(both) * seconds / TURNS)))
    for _ in range(LATE):
        setup.new_taps()
        stream.push()
        stream.wait()
        alone.append(stream.took_s())
    later = took[len(took) // 2 :]
    return {
        "chunks_per_s": max(both), "copies_per_s": max(copies), "share": np.median(np.divide(both, copies)),
        "late_s": np.median(later), "worst_s": max(later), "alone_s": np.median(alone),
    }  # fmt: skip


def paced(seconds: float, *turns) -> list[list[float]]:
    """How often per second each of `turns`, asked by turn(n) for n, does it: TURNS figures of each, turn about."""
    counts = []
    for turn in turns:
        turn(3)
        begin = time.perf_counter()
        turn(FEWEST)
        counts.append(int(np.clip(FEWEST * seconds / (time.perf_counter() - begin) / TURNS, FEWEST, 20000)))
    rates = [[] for _ in turns]
    for _ in range(TURNS):
        for turn, n, found in zip(turns, counts, rates, strict=True):
            begin = time.perf_counter()
            turn(n)
            found.append(n / (time.perf_counter() - begin))
    return rates


def joules(turn, rate: float):
    """What one of turn(n)'s n takes, over ENERGY_S; None where the card does not count."""
    before = energy_j()
    if before is None:
        return None
    n = max(1, round(rate * ENERGY_S))
    turn(n)
    return (energy_j() - before) / n


def energy_j():
    """Joules that the card has taken since it was started; None where it does not tell."""
    try:
        import pynvml

        pynvml.nvmlInit()
        return pynvml.nvmlDeviceGetTotalEnergyConsumption(pynvml.nvmlDeviceGetHandleByIndex(0)) * 1e-3
    except Exception:
        return None


def parts(setup: Setup) -> dict:
    """Milliseconds of every step of a period, each waited for, in the last of ten turns; {} in the direct form."""
    ops, form, ends, period = setup.network.ops, setup.network.form, setup.network.ends, setup.period
    if form.method != "overlap-save":
        return {}
    table = np.array([[0, period, 1, 0.0]])
    now = ops.upload(noise16(np.random.default_rng(6), (form.n_inputs, period)))
    taps = ops.upload(setup.tables[0].delays[None]), ops.upload(setup.tables[0].gains[None])
    shape = (form.n_outputs, period, 2) if ends.int16_out else (form.n_outputs, period)
    out = ops.empty(shape, np.int16 if ends.int16_out else np.complex64)
    clipped = ops.upload(np.zeros(1, np.int64))
    for _ in range(10):
        took, lap = {}, ops.clock()
        filters, scale = ops.filters(*taps, form)
        took["taps"] = lap()
        spectra = ops.forward(now, now, table, form.blocks(period), form, ends)
        took["forward"] = lap()
        product = ops.product(filters, spectra, form)
        took["product"] = lap()
        ops.inverse(product, scale, table, form, ends, 0, out, None, True, True, clipped)
        took["inverse"] = lap()
    return {name: round(1e3 * seconds, 4) for name, seconds in took.items()}
