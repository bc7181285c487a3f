# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings of which only stretches are known, like the pilots of a cell: what is left out changes nothing that is fitted,
and carrier, clock and delay are found before anything is."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from conftest_world import RATE_HZ as WORLD_HZ
from conftest_world import noise, sent_once
from gr_cast.diagnose import align, diagnose, offsets, read_case, search
from gr_cast.signals import recording
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.model import predict

RATE_HZ, CARRIER_HZ, COUNT = 2e6, 1e9, 100_000
OFFSET_HZ, CLOCK_PPM, DELAY = -9_700.0, -25.0, 37


@pytest.fixture(scope="module")
def pilots(tmp_path_factory):
    """A case: one stretch of 600 in 4000 samples is known; carrier and clock are of different oscillators; two echoes."""
    rng = np.random.default_rng(2)
    folder = tmp_path_factory.mktemp("pilots")
    spectrum = np.where(np.abs(np.fft.fftfreq(COUNT)) < 0.3, rng.normal(size=COUNT) + 1j * rng.normal(size=COUNT), 0)
    x = np.fft.ifft(spectrum) * np.sqrt(COUNT)
    fine = np.fft.ifft(np.concatenate([spectrum[: COUNT // 2], np.zeros(7 * COUNT), spectrum[COUNT // 2 :]])) * 8 * np.sqrt(COUNT)
    n = np.arange(COUNT)
    at = lambda t: np.interp(t % COUNT, np.arange(8 * COUNT) / 8, fine)  # noqa: E731
    t = n * (1 + CLOCK_PPM * 1e-6) - DELAY
    y = (at(t) + 0.5j * at(t - 3.4)) * np.exp(2j * np.pi * OFFSET_HZ / RATE_HZ * n)
    y = 0.1 * y + 0.03 * (rng.normal(size=COUNT) + 1j * rng.normal(size=COUNT))
    x[n % 4000 >= 600] = np.nan
    for stem, samples in (("recording", y), ("sent", x)):
        recording.write(folder / stem, samples.astype(np.complex64), sample_rate_hz=RATE_HZ)
    twin = {
        "cast_twin": 1,
        "sample_rate_hz": RATE_HZ,
        "center_frequency_hz": CARRIER_HZ,
        "waveforms": {"w1": {"file": "sent", "repeat": False}},
        "nodes": {"tx1": {"transmit": "w1"}, "rx1": {}},
        "links": [{"tx": "tx1", "rx": "rx1", "taps": [{"delay_s": 0.0}]}],
        "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1"]}],
    }
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    return read_case(folder)


def test_carrier_clock_and_delay_are_found_from_the_known_stretches(pilots):
    scene, data, model = align.build(pilots, pilots.observations[0])
    alone, both = offsets.find(scene, model.base, data.y * data.use)
    assert alone.gained == 0.0
    assert both.cycles / scene.duration_s == pytest.approx(OFFSET_HZ, abs=2.0)
    assert both.gained / scene.span * 1e6 == pytest.approx(CLOCK_PPM, abs=1.0)
    assert both.delay + scene.anchor == DELAY


def test_the_model_of_carrier_and_clock_explains_what_it_can_before_a_fit(pilots):
    _, data, model = align.build(pilots, pilots.observations[0])
    started = offsets.models(data, model)[1]
    used = data.use > 0
    left = np.abs(data.y - predict(data.scene, started).y)[used] ** 2
    # the echo, a quarter of the main path's power, and the noise are not in it yet
    assert np.mean(left) == pytest.approx(0.1**2 * 0.25 * 1.2 + 2 * 0.03**2, rel=0.1)


def test_behind_an_inversion_carrier_and_clock_are_those_in_front_of_it(pilots):
    _, data, model = align.build(pilots, pilots.observations[0])
    mirrored = replace(data, y=np.conj(data.y)), model.adding(start(FAMILIES["spectral_inversion"], []))
    for straight, other in zip(offsets.models(data, model), offsets.models(*mirrored), strict=True):
        assert np.allclose(predict(data.scene, other).y, np.conj(predict(data.scene, straight).y))
        for effect in straight.found:
            assert np.array_equal(effect.p, next(e.p for e in other.found if e.family == effect.family))


def test_samples_that_are_left_out_change_no_prediction(pilots, monkeypatch):
    observation = pilots.observations[0]
    scene, data, model = align.build(pilots, observation)
    monkeypatch.setattr(align, "LEAST_GATHERED", 2 * COUNT)
    whole, every, _ = align.build(pilots, observation)
    assert scene.count < 0.2 * whole.count and scene.span == whole.span
    assert data.use.sum() == every.use.sum() and np.array_equal(data.y, every.y[scene.at])
    effects = [
        start(FAMILIES["carrier_frequency_offset"], [-485.0, 0.3]),
        start(FAMILIES["sample_clock_offset"], [-2.5]),
        start(FAMILIES["extra_path"], [0.2, 0.3, 3.4, 1.5], aux={"source": 0}),
        start(FAMILIES["front_end_filter"], [0.1, -0.2, 0.05, 0.3], aux={"side": "rx", "low": -1, "high": 1}),
        start(FAMILIES["phase_noise"], np.linspace(0.1, -0.1, 12), prior=np.ones(12), aux={"law": "flat"}),
    ]
    for effect in effects:
        model = model.adding(effect)
    used, full = data.use > 0, every.use > 0
    got, want = predict(scene, model).y[used], predict(whole, replace(model)).y[full]
    assert np.abs(got - want).max() < 0.02 * np.abs(want).max()


@pytest.mark.parametrize("carrier", [0.09, 0.031, -0.0123])
def test_of_carriers_that_regular_stretches_make_alike_the_right_one_is_found(tmp_path, carrier):
    """Stretches of 200 in 1000 samples turn alike under carriers 1/1000 apart; within them they do not."""
    rng, n = np.random.default_rng(0), np.arange(20_000)
    spectrum = np.where(np.abs(np.fft.fftfreq(len(n))) < 0.4, noise(rng, len(n)), 0)
    x = np.fft.ifft(spectrum) * np.sqrt(len(n))
    y = x * np.exp(2j * np.pi * carrier * n) + noise(rng, len(n), 0.1)
    case = sent_once(tmp_path, y, np.where(n // 200 % 5 == 0, x, np.nan))
    _, data, model = align.build(case, case.observations[0], near=(0, False))
    for started in offsets.models(data, model):
        (found,) = (e for e in started.effects if e.family == "carrier_frequency_offset")
        assert found.p[0] / data.scene.span == pytest.approx(carrier, abs=0.3e-3)


@pytest.mark.parametrize(("cycles", "drift"), [(3.0, 20.0), (-60.0, -200.0), (0.0, -5.0)])
def test_a_carrier_that_smears_over_many_lines_is_an_offset_that_drifts(world, tmp_path, cycles, drift):
    u = world.n / len(world.n)
    y = world.noisy(world.clean() * np.exp(2j * np.pi * (cycles * u + drift / 2 * u**2)))
    (told,) = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document["effects"]
    assert told["family"] == "carrier_frequency_offset"
    duration_s = len(world.n) / WORLD_HZ
    for name, true in (("offset_hz", cycles / duration_s), ("drift_hz_per_s", drift / duration_s**2)):
        number = told["parameters"][name]
        assert abs(number["value"] - true) < 4 * number["std"]


@pytest.mark.parametrize("what", ["a loss", "a clock", "an offset"])
def test_a_delay_that_moves_is_gone_on_with_beside_an_offset_that_holds_a_little_more(tmp_path, what):
    """Five paths of a shaped code, half of a recording at another delay or under a clock of 160 ppm: what they are brings the
    twin further than any offset; where the offset is what it is, nothing else does."""
    rng, count, period = np.random.default_rng(21), 60_000, 1921
    spectrum = np.fft.fft(np.repeat(np.exp(2j * np.pi * rng.integers(0, 4, period // 6 + 1) / 4), 6)[:period])
    spectrum *= np.abs(np.fft.fftfreq(period)) < 0.2
    sent, n = np.fft.ifft(spectrum), np.arange(count)
    at = n + 3.0 * (n >= count // 2) if what == "a loss" else n * (1 + 160e-6 * (what == "a clock"))
    k = np.fft.fftfreq(period, 1 / period)
    taps = [(0.0, 1.0), (3.3, 0.6j), (11.8, -0.5), (17.1, 0.4 - 0.2j), (29.6, 0.3j)]
    heard = sum(a * np.exp(-2j * np.pi * k * d / period) for d, a in taps) * spectrum / period
    live = np.abs(heard) > 0
    y = np.concatenate([np.exp(2j * np.pi * np.outer(part, k[live]) / period) @ heard[live] for part in np.array_split(at, 60)])
    twin = {
        "cast_twin": 1, "sample_rate_hz": 1e6, "waveforms": {"w1": {"file": "sent"}},
        "nodes": {"tx1": {"transmit": "w1"}, "rx1": {}}, "links": [{"tx": "tx1", "rx": "rx1", "taps": [
            {"delay_s": d * 1e-6, "gain_db": float(20 * np.log10(abs(a))), "phase_rad": float(np.angle(a))} for d, a in taps]}],
        "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1"]}], "unknown": ["delay", "phase", "gain"],
    }  # fmt: skip
    y = y * np.exp(2j * np.pi * 0.6 * n / count * (what == "an offset"))
    y = y + 0.02 * np.std(y) / np.sqrt(2) * (rng.normal(size=count) + 1j * rng.normal(size=count))
    for name, samples in (("recording", y), ("sent", sent)):
        recording.write(tmp_path / name, samples, sample_rate_hz=1e6)
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(twin))
    case = read_case(tmp_path)
    _, data, model = align.build(case, case.observations[0])
    first, offset = search.refit(data, model), start(FAMILIES["carrier_frequency_offset"], [0.6, 1.6])
    best = search.refit(data, model.adding(offset))
    assert search._leaps_further(first, best) == (what != "an offset") and not search._leaps_further(first, first)
