# SPDX-License-Identifier: GPL-3.0-or-later
"""Powers of the ports in the emulator's status, and noise that refers to them."""

import threading
import time

import numpy as np
import pytest
from gnuradio import blocks as stock
from gnuradio import gr
from gr_cast.blocks.control import obey
from gr_cast.blocks.emulation import Emulation
from gr_cast.core.units import db_from_power
from gr_cast.scenario import LinkTaps, Scenario

RATE_HZ = 500e3
LOUD = 10 ** (80 / 20)  # srsRAN's tx_gain in its examples multiplies samples by as much
RNG = np.random.default_rng(1)
SENT = (LOUD * 0.17 * RNG.normal(size=(1000, 2)) @ (1, 1j)).astype(np.complex64)  # again and again


class Throttled(gr.hier_block2):
    def __init__(self, samples):
        super().__init__("throttled", gr.io_signature(0, 0, 0), gr.io_signature(1, 1, gr.sizeof_gr_complex))
        self.source = stock.vector_source_c(samples.tolist(), True)
        self.throttle = stock.throttle(gr.sizeof_gr_complex, RATE_HZ)
        self.connect(self.source, self.throttle, self)


@pytest.fixture
def running():
    """An emulation of a>b at −40 dB, the receiver's newest samples, and what ends it."""
    link = LinkTaps(delay_s=[[0.0]], gain=[[0.01]])
    scenario = Scenario(name="s", nodes=("a", "b"), links={("a", "b"): link})
    started = []

    def start(sent=SENT, **options):
        heard = stock.vector_sink_c()
        ends = {("a", "tx"): Throttled(sent), ("b", "rx"): heard}
        emulation, ended = Emulation(scenario, [], RATE_HZ, ends=ends, seed=3, **options), threading.Event()
        thread = threading.Thread(target=emulation.run_until, args=(ended,), daemon=True)
        thread.start()
        started.append((ended, thread))
        return emulation, heard

    yield start
    for ended, thread in started:
        ended.set()
        thread.join()


def when(holds, *, seconds: float = 20.0):
    until = time.monotonic() + seconds
    while not (found := holds()):
        assert time.monotonic() < until
        time.sleep(0.05)
    return found


def test_the_status_tells_power_and_peak_of_every_port(running):
    emulation, _ = running()
    assert emulation.status()["power"]["a:tx"] == {"mean_db": None, "peak_db": None}
    power = when(lambda: (p := emulation.status()["power"])["b:rx"]["mean_db"] is not None and p)
    assert set(power) == {"a:tx", "b:rx"}
    mean_db, peak_db = db_from_power(np.mean(np.abs(SENT) ** 2)), db_from_power(np.max(np.abs(SENT) ** 2))
    # A report holds whole repetitions but for one.
    assert power["a:tx"]["mean_db"] == pytest.approx(mean_db, abs=0.1) and power["a:tx"]["peak_db"] == pytest.approx(
        peak_db, abs=1e-3
    )
    assert power["b:rx"]["mean_db"] == pytest.approx(mean_db - 40, abs=0.1)
    assert power["b:rx"]["peak_db"] == pytest.approx(peak_db - 40, abs=1e-3)


def test_an_snr_refers_to_what_is_sent_and_not_to_one(running):
    emulation, heard = running(snr_db=50.0)
    when(lambda: emulation.status()["noise_power_db"] is not None)
    sent = np.mean(np.abs(SENT) ** 2)
    assert emulation.status()["noise_power_db"] == pytest.approx(db_from_power(sent) - 50, abs=0.1)
    for command, power_db in (({"snr_db": 30}, db_from_power(sent) - 30), ({"power_db": 7.0}, 7.0)):
        answer = obey(emulation, threading.Event(), {"command": "set_noise", **command})
        assert answer["status"]["noise_power_db"] == pytest.approx(power_db, abs=0.1)
    for bad in ({}, {"snr_db": 1, "power_db": 1}, {"snr_db": "auto"}, {"power_db": 1e6}, {"snr_db": True}):
        assert not obey(emulation, threading.Event(), {"command": "set_noise", **bad})["ok"]
    emulation.set_noise(snr_db=30)
    count = len(heard.data())
    when(lambda: len(heard.data()) > count + 300_000)  # what lay in buffers is through
    samples = np.array(heard.data())
    first, samples = len(samples) - 100_000, samples[-100_000:]
    rest = samples - 0.01 * SENT[np.arange(first, first + len(samples)) % len(SENT)]
    assert db_from_power(np.mean(np.abs(rest) ** 2)) == pytest.approx(db_from_power(sent) - 30, abs=0.1)


def test_an_snr_waits_for_somebody_who_sends(running):
    emulation, _ = running(np.zeros(1000, np.complex64), snr_db=20.0)
    when(lambda: emulation.status()["samples"] > RATE_HZ)
    status = emulation.status()
    assert status["noise_power_db"] is None and status["power"]["a:tx"]["mean_db"] is None
    answer = obey(emulation, threading.Event(), {"command": "set_noise", "snr_db": 3})
    assert not answer["ok"] and "no transmitter" in answer["errors"][0]
