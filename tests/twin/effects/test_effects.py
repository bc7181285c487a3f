# SPDX-License-Identifier: GPL-3.0-or-later
"""Forward models against closed formulas."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast.diagnose.verdict import Words
from gr_cast.twin.basis import course
from gr_cast.twin.chain import Chain
from gr_cast.twin.columns import Courses, Dense, Lags, gram
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.adc_clipping import mean_of_limiter
from gr_cast.twin.effects.base import start
from gr_cast.twin.effects.noise_family import NoiseView
from gr_cast.twin.effects.pa_nonlinearity import bent, of_one_level
from gr_cast.twin.effects.quantization import mean_of_quantizer, variance_of_quantizer
from gr_cast.twin.entries import effect_of
from gr_cast.twin.model import Model, jacobian, predict
from gr_cast.twin.scene import PAD, Path, Scene, Source
from scipy import integrate, stats

RATE_HZ, COUNT, PERIOD = 1e6, 3000, 97
RNG = np.random.default_rng(5)
SPECTRUM = RNG.normal(size=PERIOD) + 1j * RNG.normal(size=PERIOD)
SPECTRUM[30:68] = 0  # band-limited, so that delays between samples have a closed form


def at(t):
    """The waveform at times t in samples: its Fourier series."""
    k = np.fft.fftfreq(PERIOD, 1 / PERIOD)
    return np.exp(2j * np.pi * np.outer(t, k) / PERIOD) @ SPECTRUM / PERIOD


def scene(taps, repeat=True):
    n = np.arange(PERIOD) if repeat else np.arange(-PAD, COUNT + PAD)
    x = at(n)
    known = np.ones(len(x), bool)
    power, peak = float(np.mean(np.abs(x) ** 2)), float(np.abs(x).max())
    source = Source(name="w", samples=x, repeat=repeat, known=known, power=power, peak=peak)
    return Scene(
        name="r",
        sample_rate_hz=RATE_HZ,
        count=COUNT,
        sources=[source],
        taps=taps,
        transmitters=["tx1"],
        receiver="rx1",
        anchor=0,
    )


def predicted(taps, *effects, delay=0.0, repeat=True):
    model = Model(base=np.array([delay, 1.0, 0.0]))
    for effect in effects:
        model = model.adding(effect)
    return predict(scene(taps, repeat), model).y


N = np.arange(COUNT)
ONE = [Path(source=0, delay=0.0, gain=1.0)]


@pytest.mark.parametrize("repeat", [True, False])
def test_paths_add_with_their_delay_gain_and_doppler(repeat):
    taps = [Path(source=0, delay=0.3, gain=1.0), Path(source=0, delay=7.8, gain=0.2j, doppler=4.0)]
    want = at(N - 2.25 - 0.3) + 0.2j * np.exp(2j * np.pi * 4.0 * N / COUNT) * at(N - 2.25 - 7.8)
    got = predicted(taps, delay=2.25, repeat=repeat)
    inner = slice(50, -50)
    # A window cut out of an endless signal is band-limited only away from its ends.
    assert np.abs(got - want)[inner].max() < (1e-9 if repeat else 0.02) * np.abs(want).max()


@pytest.mark.parametrize("gained", [0.01, 0.9, -3.0])
def test_a_fast_clock_compresses_the_waveform(gained):
    got = predicted(ONE, start(FAMILIES["sample_clock_offset"], [gained]))
    want = at(N * (1 + gained / COUNT))
    assert np.abs(got - want).max() < 2e-4 * np.abs(want).max()


def test_carrier_offset_and_drift_turn_the_phase_quadratically():
    family = FAMILIES["carrier_frequency_offset"]
    effect = family.parse(scene(ONE), {"offset_hz": 900.0, "drift_hz_per_s": 2e4}, {})
    t = N / RATE_HZ
    turned = predicted(ONE, effect) / at(N)
    want = np.exp(2j * np.pi * (900 * t + 0.5 * 2e4 * t**2))
    ratio = turned / want
    assert np.allclose(ratio, ratio[0], atol=1e-9) and abs(ratio[0]) == pytest.approx(1)
    values = family.values(scene(ONE), effect, effect.p)
    assert values["offset_hz"] == pytest.approx(900) and values["drift_hz_per_s"] == pytest.approx(2e4)


@pytest.mark.parametrize("cycles", [-60.0, 250.0])
def test_a_transmitters_offset_comes_as_late_as_the_path(cycles):
    taps = [Path(source=0, delay=0.0, gain=1.0), Path(source=0, delay=31.0, gain=0.5j)]
    family = FAMILIES["carrier_frequency_offset"]
    owned = {"side": "tx", "source": 0}
    effect = family.parse(scene(taps), {"offset_hz": cycles / scene(taps).duration_s}, owned)
    turn = np.exp(2j * np.pi * cycles * N / COUNT)
    want = at(N) * turn + 0.5j * at(N - 31) * turn * np.exp(-2j * np.pi * cycles * 31 / COUNT)
    ratio = predicted(taps, effect) / want
    assert np.allclose(ratio, ratio[0], atol=1e-9) and abs(ratio[0]) == pytest.approx(1)


@pytest.mark.parametrize("name", ["power_supply_hum", "phase_noise", "gain_drift"])
def test_what_a_transmitter_does_over_time_comes_as_late_as_the_path(name):
    taps = [Path(source=0, delay=0.0, gain=1.0), Path(source=0, delay=31.0, gain=0.5j)]
    u = lambda n: np.clip(n, 0, None) / COUNT  # noqa: E731
    p, aux, over_time = {
        "power_supply_hum": ([0.1, -0.05, 40.0], {}, lambda n: 1 + 0.1 * np.cos(w(n)) - 0.05 * np.sin(w(n))),
        "phase_noise": ([0.0, 0.0, 0.6], {}, lambda n: np.exp(1j * np.interp(n, N, course(np.array([0.0, 0.0, 0.6]), COUNT)))),
        "gain_drift": ([0.5, -4.0], {"law": "relaxation"}, lambda n: np.exp(0.5 * (1 - np.exp(-u(n) / np.exp(-4.0))))),
    }[name]
    w = lambda n: 2 * np.pi * 40.0 * (n / COUNT - 0.5)  # noqa: E731
    got = predicted(taps, start(FAMILIES[name], p, aux={**aux, "side": "tx", "source": 0}))
    want = at(N) * over_time(N) + 0.5j * at(N - 31) * over_time(N - 31)
    assert np.abs(got - want)[40:].max() < 2e-3 * np.abs(want).max()


def test_what_a_transmitter_does_over_time_is_put_on_what_arrived_and_the_channel_runs_once(monkeypatch):
    taps = [Path(source=0, delay=0.3, gain=1.0), Path(source=0, delay=7.8, gain=0.2j, doppler=4.0)]
    side, place, clock = {"side": "tx", "source": 0}, scene(taps), start(FAMILIES["sample_clock_offset"], [0.9])
    lost = start(FAMILIES["sample_loss"], [1000.0, 37.0], free=[False, False])
    hum, offset = FAMILIES["power_supply_hum"], start(FAMILIES["carrier_frequency_offset"], [60.0, 0.0], aux=side)
    runs, came = [], Chain._came
    monkeypatch.setattr(Chain, "_came", lambda chain, *rest: runs.append(1) or came(chain, *rest))

    def model(*more):
        plain = Model(base=np.array([0.0, 1.0, 0.0])).adding(clock)
        return plain.adding(start(hum, [0.1, *more], aux=side)).adding(lost)

    predict(place, model(-0.05, 40.0))
    assert len(runs) == 2  # one for each movement
    got = predict(place, model(0.03, 41.0))
    assert len(runs) == 2 and got.y == pytest.approx(predict(scene(taps), model(0.03, 41.0)).y, rel=1e-12)
    for other in (model(0.03, 41.0).adding(offset), replace(model(0.03, 41.0), base=np.array([0.2, 1.0, 0.0]))):
        assert predict(place, other).y == pytest.approx(predict(scene(taps), other).y, rel=1e-12)


@pytest.mark.parametrize(("left", "families"), [(0.0, ["missing_path", "tap_gain_error"]), (0.5j, ["tap_gain_error"])])
def test_an_echo_at_a_tap_claims_no_more_than_what_that_tap_lost(left, families):
    taps = [Path(source=0, delay=0.3, gain=1.0), Path(source=0, delay=7.8, gain=0.2j)]
    lost = (left - 1) * 0.2j
    echo = start(FAMILIES["extra_path"], [lost.real, lost.imag, 7.8, 0.0], aux={"source": 0})
    less = list(FAMILIES["extra_path"].less(scene(taps), echo, ()))
    assert [e.family for e in less] == families
    for one in less if left else less[:1]:
        assert predicted(taps, one) == pytest.approx(predicted(taps, echo), abs=1e-9)
    turning = [taps[0], replace(taps[1], doppler=5.0)]
    turned = echo.moved(np.array([-lost.real, -lost.imag, 7.8, 5.0]))  # told at mid-recording, half a turn later
    less = list(FAMILIES["extra_path"].less(scene(turning), turned, ()))
    assert [e.family for e in less] == families
    assert predicted(turning, less[-1 if left else 0]) == pytest.approx(predicted(turning, turned), abs=1e-9)
    assert not list(FAMILIES["extra_path"].less(scene(taps), turned, ()))  # which does not turn
    apart, taken = echo.moved(echo.p + [0.0, 0.0, 0.6, 0.0]), (start(FAMILIES["tap_fading"], [0.0], aux={"tap": 1}),)
    assert not list(FAMILIES["extra_path"].less(scene(taps), apart, ()))
    assert not list(FAMILIES["extra_path"].less(scene(taps), echo, taken))


def test_two_offsets_of_one_transmitter_add_and_a_loss_moves_their_phase_on_either_side():
    family, lost = FAMILIES["carrier_frequency_offset"], start(FAMILIES["sample_loss"], [1000.0, 37.0], free=[False, False])
    side = {"side": "tx", "source": 0}
    sent = predicted(ONE, start(family, [60.0, 0.0], aux=side), start(family, [40.0, 0.0], aux=side), lost)
    received = predicted(ONE, start(family, [100.0, 0.0]), lost)
    assert np.abs(sent - received).max() < 1e-9 * np.abs(received).max()


def test_an_image_rejection_is_the_power_of_the_conjugate():
    effect = FAMILIES["iq_imbalance"].parse(scene(ONE), {"gain_imbalance_db": 0.4, "phase_imbalance_rad": 0.03}, {})
    y, x = predicted(ONE, effect), at(N)
    image = np.vdot(np.conj(x), y) / np.vdot(x, x)
    direct = np.vdot(x, y) / np.vdot(x, x)
    rho = np.vdot(np.conj(x), x) / np.vdot(x, x)
    beta = (image - rho * direct) / (direct - np.conj(rho) * image)
    said = FAMILIES["iq_imbalance"].values(scene(ONE), effect, effect.p)["image_rejection_db"]
    assert -20 * np.log10(abs(beta)) == pytest.approx(said, abs=0.1)


def test_the_mean_and_variance_of_a_quantiser_are_those_of_many_trials():
    value, step, sigma = 0.43, 0.25, 0.3
    noisy = value + sigma * step * np.random.default_rng(1).normal(size=400_000)
    output = np.round(noisy / step) * step
    assert mean_of_quantizer(np.array([value]), step, 0.0, sigma)[0] == pytest.approx(output.mean(), abs=1e-3)
    variance = variance_of_quantizer(np.array([value]), step, 0.0, sigma)[0] * step**2
    assert variance == pytest.approx(output.var(), rel=0.01)


@pytest.mark.parametrize("value", [-1.7, -1.0, -0.4, 0.0, 0.9, 1.1])
def test_the_mean_of_a_limiter_under_noise_is_that_of_its_integral(value):
    level, sigma = 1.0, 0.3
    density = stats.norm(value, sigma).pdf
    parts = (-4, -level), (-level, level), (level, 4)
    mean = sum(integrate.quad(lambda x: np.clip(x, -level, level) * density(x), a, b)[0] for a, b in parts)
    assert mean_of_limiter(np.array([value]), level, sigma)[0] == pytest.approx(mean, abs=1e-5)


def test_lost_samples_move_the_waveform_ahead_from_their_moment_on():
    y = predicted(ONE, start(FAMILIES["sample_loss"], [1000.0, 13.0], free=[False, False]))
    assert np.allclose(y[:1000], at(N[:1000])) and np.allclose(y[1000:], at(N[1000:] + 13))


def test_a_gain_steps_where_something_is_sent_however_little_comes_after_it():
    """So little that sums of its power hold none of it, and sums of what is left some."""
    n, sent = np.arange(1000), np.where(np.arange(1000) < 800, 1.0, 1e-9)
    left = RNG.normal(size=1000) * 1e-2 - np.where(n >= 300, 0.3, 0.0) * sent
    view = SimpleNamespace(amplitude_moments=lambda: (left * sent, sent**2), scene=SimpleNamespace(u=n / 1000, count=1000))
    (found,) = FAMILIES["gain_step"].starts(view)
    assert found.p[1] == pytest.approx(0.3, abs=0.01)


def test_an_amplifier_compresses_by_what_it_reports():
    taps, family = ONE, FAMILIES["pa_nonlinearity"]
    effect = family.parse(scene(taps), {"compression_db": 1.0}, {})
    assert family.values(scene(taps), effect, effect.p)["compression_db"] == pytest.approx(1.0)
    x, y = at(N), predicted(taps, effect)
    top = np.argmax(np.abs(x))
    assert 20 * np.log10(abs(y[top] / x[top])) == pytest.approx(-1.0, abs=0.15)


def test_what_leaks_into_an_amplifier_is_bent_with_the_signal():
    n = np.arange(PERIOD)
    x = 0.6 * np.exp(2j * np.pi * 5 * n / PERIOD) + 0.3j * np.exp(-4j * np.pi * n / PERIOD)
    here, power, peak = scene(ONE), float(np.mean(np.abs(x) ** 2)), float(np.abs(x).max())
    here.sources[0] = replace(here.sources[0], samples=x, power=power, peak=peak)
    leak = start(FAMILIES["lo_leakage"], [0.1, -0.2], aux={"source": 0})
    bends = start(FAMILIES["pa_nonlinearity"], [-0.2, 0.1], aux={"source": 0, "peak": peak, "orders": (1,)})
    y = predict(here, Model(base=np.array([0.0, 1.0, 0.0])).adding(leak).adding(bends)).y
    driven = (x + (0.1 - 0.2j) * np.sqrt(power))[N % PERIOD]
    assert np.allclose(y, driven + (-0.2 + 0.1j) * driven * np.abs(driven / peak) ** 2)


def test_an_amplifier_that_remembers_compresses_by_what_a_thousandth_of_the_amplitude_shows():
    """Of a wave that is nowhere faint (amplitudes of 0.9 to 1) too."""
    n = np.arange(PERIOD)
    x = (0.95 + 0.05 * np.cos(2 * np.pi * 3 * n / PERIOD)) * np.exp(2j * np.pi * 5 * n / PERIOD)

    def sent(wave):
        cubic = wave * np.abs(wave) ** 2
        return wave + (0.05 + 0.02j) * np.roll(wave, 1) - (0.2 + 0.1j) * cubic - 0.08 * np.roll(cubic, 1)

    here = scene(ONE)
    here.sources[0] = replace(here.sources[0], samples=x)
    effect = start(
        FAMILIES["pa_nonlinearity"],
        [-0.2, -0.1, 0.05, 0.02, -0.08, 0.0],
        aux={"source": 0, "peak": 1.0, "orders": (1,), "lags": (1,)},
    )
    strongest = np.argsort(np.abs(x))[-8:]
    gain = lambda wave, part: np.vdot(wave[part], sent(wave)[part]) / np.vdot(wave[part], wave[part])  # noqa: E731
    lost = 20 * np.log10(abs(gain(1e-3 * x, n) / gain(x, strongest)))
    assert FAMILIES["pa_nonlinearity"].values(here, effect, effect.p)["compression_db"] == pytest.approx(lost, abs=1e-3)


@pytest.mark.parametrize("kind, is_one", [("keyed", True), ("keyed, filtered", False), ("chips", False)])
def test_an_amplifier_turns_and_scales_what_is_of_one_level_but_for_its_ramps(kind, is_one):
    """So that it cannot be told from a gain. A keyed tone is; behind a steep filter it is not; chips of one level swing between
    their samples."""
    rng, n = np.random.default_rng(4), np.arange(8_000)
    tones = np.convolve(np.repeat(rng.integers(0, 8, 100), 80), np.hanning(97) / 48, "same")
    ramp = np.clip(np.minimum(n, 7_999 - n) / 60, 0, 1)
    x = ramp * np.exp(2j * np.pi * np.cumsum(tones) / 60) if "keyed" in kind else rng.choice([-1.0, 1.0], 8_000) + 0j
    x = np.convolve(x, [1, 0, 0, 0, 0.5j], "same") if "filtered" in kind else x
    assert of_one_level(x) == is_one
    cubic = bent(x, 1.0, (1,))[1]
    middle = slice(200, 7_800)
    rest = cubic - x * np.vdot(x[middle], cubic[middle]) / np.vdot(x[middle], x[middle])
    assert (np.linalg.norm(rest[middle]) < 0.02 * np.linalg.norm(cubic[middle])) == is_one


def test_noise_that_follows_the_signal_lies_in_its_interval_where_next_to_no_floor_is_heard():
    """A hundred times the floor, under a wave that never falls below a fifth of its power."""
    rng, family, z = np.random.default_rng(8), FAMILIES["signal_dependent_noise"], []
    power = rng.uniform(0.2, 1.8, 10_000)
    for _ in range(60):
        energy = rng.exponential(size=10_000) * (1 + 100 * power / power.mean())
        _, found = family.find(NoiseView(use=np.ones(10_000, bool), energy=energy, wanted_power=power, weighted=None))
        z.append((found.p[0] - np.log(100)) / found.aux["_std"][0])
    assert np.mean(np.abs(z) < 1.96) > 0.9


@pytest.mark.parametrize("inverted", [False, True])
def test_derivatives_are_those_of_the_prediction(inverted):
    taps = [Path(source=0, delay=0.3, gain=1.0), Path(source=0, delay=7.8, gain=0.5j)]
    model = Model(base=np.array([0.2, 0.8, 0.3]))
    for name, p, aux in (
        ("extra_path", [0.1, -0.05, 20.3, 1.2], {"source": 0}),
        ("tap_fading", [0.01, 0.02, -0.01, 0.0], {"tap": 1}),
        ("phase_noise", [0.02, -0.01], {}),
        ("front_end_filter", [0.05, 0.01], {"low": 0, "high": 1, "side": "rx"}),
        ("front_end_filter", [0.02, 0.03], {"low": 0, "high": 1, "side": "tx", "source": 0}),
        ("diffuse_tail", [0.03, -0.02, 0.01, 0.02], {"source": 0, "first": 1.0}),
        ("pa_nonlinearity", [-0.02, 0.01], {"source": 0, "peak": 1.0, "orders": (1,)}),
        *([("spectral_inversion", [], {})] if inverted else []),
    ):
        model = model.adding(start(FAMILIES[name], p, aux=aux))
    world = scene(taps)
    chain, blocks = jacobian(world, model)
    rows = np.concatenate([b.full() for b in blocks])
    vector, step = model.vector(), 1e-5
    for k in range(len(vector)):
        moved = vector.copy()
        moved[k] += step
        slope = (predict(world, model.at(moved)).y - chain.y) / step
        size = np.abs(slope).max()
        assert np.abs(rows[k] - slope)[30:-30].max() < 0.2 * size + 1e-3, k


FORMS = {
    "a tail": ("diffuse_tail", np.full(80, 0.01), {"source": 0, "first": 1.0}),
    "a filter of the transmitter's": ("front_end_filter", np.full(40, 1e-3), {"low": 0, "high": 20, "side": "tx", "source": 0}),
    "a filter of the receiver's": ("front_end_filter", np.full(40, 0.01), {"low": 0, "high": 20, "side": "rx"}),
    "an amplifier": (
        "pa_nonlinearity", np.full(10, 0.01), {"source": 0, "peak": 1.0, "orders": (1,), "lags": (-3, 3)},
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("side", ["rx", "tx", "path"])
@pytest.mark.parametrize("inverted", [False, True])
def test_what_is_late_is_turned_by_what_turns_behind_it_as_it_stands_now(form, side, inverted):
    """A derivative by a late tap is no shifted copy of that by the first: at an offset of 0.084 rad per sample the signal has
    turned by more than half a turn after 40 samples, which the oscillator behind it has not, nor has a path that moves."""
    name, p, aux = FORMS[form]
    model = Model(base=np.array([0.2, 0.8, 0.3])).adding(start(FAMILIES[name], p, aux=aux))
    carrier = start(FAMILIES["carrier_frequency_offset"], [40.0, 0.0], aux={"side": "tx", "source": 0} if side == "tx" else {})
    model = model if side == "path" else model.adding(replace(carrier, free=np.zeros(2, bool)))
    model = model.adding(start(FAMILIES["spectral_inversion"], [])) if inverted else model
    world = scene([Path(source=0, delay=0.3, gain=1.0, doppler=40.0 if side == "path" else 0.0)])
    chain, blocks = jacobian(world, model)
    rows, vector = np.concatenate([b.full() for b in blocks]), model.vector()
    for k in range(3, len(vector)):
        slope = (predict(world, model.at(vector + 1e-5 * np.eye(len(vector))[k])).y - chain.y) / 1e-5
        assert np.abs(rows[k] - slope)[60:-60].max() < 0.02 * np.abs(slope).max(), k


CONTRACT = {
    "carrier_frequency_offset": {"offset_hz": -120.0, "drift_hz_per_s": 4e3},
    "sample_clock_offset": {"offset_ppm": 12.0},
    "iq_imbalance": {"gain_imbalance_db": -0.3, "phase_imbalance_rad": 0.02},
    "dc_offset": {"level_dbc": -31.0, "decay_s": 4e-4},
    "lo_leakage": {"level_dbc": -40.0},
    "pa_nonlinearity": {"compression_db": 1.5},
    "adc_clipping": {"level": 0.4},
    "quantization": {"step": 0.0625},
    "gain_step": {"time_s": 1.2e-3, "step_db": -0.5},
    "gain_drift": {"total_db": 0.8, "time_constant_s": 5e-4},
    "power_supply_hum": {"frequency_hz": 1200.0, "depth": 0.05},
    "extra_path": {"delay_s": 2.1e-5, "gain_db": -20.0, "phase_rad": 1.0, "doppler_hz": 300.0},
    "missing_path": {"delay_s": 9e-6},
    "tap_gain_error": {"delay_s": 9e-6, "error_db": -1.0, "error_rad": 0.2},
    "tap_delay_error": {"delay_s": 9e-6, "error_s": 3e-7},
    "tap_doppler": {"delay_s": 9e-6, "doppler_hz": 80.0},
    "tone_interference": {"frequency_hz": 1.1e5, "power_dbc": -33.0},
    "sample_loss": {"time_s": 1e-3, "samples": -7.0},
}


def test_inserted_zeros_take_the_place_of_all_that_came():
    family = FAMILIES["sample_loss"]
    world = scene([ONE[0]])
    effects = [family.parse(world, {"time_s": 1e-3, "samples": -7.0, "zeros": zeros}, {}) for zeros in (False, True)]
    assert family.constants(world, effects[1]) == {"zeros": True}
    plain, silent = (predicted([ONE[0]], effect) for effect in effects)
    at = round(1e-3 * world.sample_rate_hz) + np.arange(7)
    assert np.all(silent[at] == 0) and np.all(plain[at] != 0)
    assert np.array_equal(np.delete(silent, at), np.delete(plain, at))


@pytest.mark.parametrize("name", list(CONTRACT))
def test_a_diagnosis_read_back_into_a_twin_keeps_its_numbers(name):
    world = scene([ONE[0], Path(source=0, delay=9.0, gain=0.5)])
    family = FAMILIES[name]
    effect = family.parse(world, CONTRACT[name], {})
    values = family.values(world, effect, effect.p)
    assert {k: values[k] for k in CONTRACT[name]} == pytest.approx(CONTRACT[name])


FOUND = {
    "lo_leakage": ([0.03, -0.01], {"source": 0}),
    "pa_nonlinearity": ([-0.1, 0.02, 0.03, 0.01, -0.02, 0.0], {"source": 0, "peak": 0.3, "orders": (1,), "lags": (2,)}),
    "extra_path": ([0.1, -0.05, 20.3, 1.2], {"source": 0}),
    "tap_doppler": ([0.7, 0.4], {"tap": 1}),
    "diffuse_tail": ([0.1, 0.02, -0.03, 0.01], {"source": 0, "first": 1.0}),
    "second_transmitter": ([0.1, 0.2, 3.3, 4.0], {"code": "other"}),
    "front_end_filter": ([0.05, 0.01, 0.02, 0.0], {"low": -1, "high": 1, "side": "rx"}),
    "gain_drift": ([0.1, -1.2], {"law": "relaxation"}),
    "power_supply_hum": ([0.04, 0.03, -17.0, 0.01, -0.02, 0.0, 0.015], {}),
    "dc_offset": ([0.04, 0.03, -1.0], {"decays": True}),
    "tone_interference": ([0.04, 0.03, 517.25], {}),
}


@pytest.mark.parametrize("name", list(FOUND))
def test_what_a_diagnosis_writes_predicts_what_it_found(name):
    world = scene([ONE[0], Path(source=0, delay=9.0, gain=0.5)])
    world.rms, world.extra = 3.0, {"other": replace(world.sources[0], samples=np.conj(world.sources[0].samples))}
    family, (p, aux) = FAMILIES[name], FOUND[name]
    found = start(family, p, aux=aux)
    told = {**family.values(world, found, found.p), **family.constants(world, found)}
    read = family.parse(world, told, family.model(world, found))
    base = Model(base=np.array([0.0, 1.0, 0.0]))
    plain, want, got = (predict(world, m).y for m in (base, base.adding(found), base.adding(read)))
    assert np.abs(want - plain).max() > 0.01 * np.abs(plain).max()
    assert np.abs(got - want).max() < 1e-9 * np.abs(want).max()


TIMED = {
    **{name: FOUND[name] for name in ("extra_path", "tap_doppler", "gain_drift", "power_supply_hum", "dc_offset")},
    "tone_interference": FOUND["tone_interference"],
    "carrier_frequency_offset": ([0.4, 1.5], {}),
    "gain_step": ([0.3, 0.7], {}),
    "sample_loss": ([2100.0, 11.0], {}),
}


def test_pulses_go_on_in_a_later_part():
    family, begins = FAMILIES["pulsed_interference"], 1234
    whole = scene(ONE)
    part = replace(whole, count=500, span=500, begins=begins, whole=COUNT)
    pulses = start(family, [0.5, 97.3, 20.6, 0.21])
    there = family.in_its_part(part, pulses)
    law = family.variance(whole, pulses, np.ones(COUNT))
    assert np.ptp(law) > 1 and (family.variance(part, there, np.ones(500)) == law[begins : begins + 500]).all()


def test_the_end_of_a_relaxation_is_still():
    """Of a gain that warms up within a fiftieth of the recording nothing is left to change in a late part."""
    whole = scene(ONE)
    part = replace(whole, count=500, span=500, begins=2400, whole=COUNT)
    parameters = {"total_db": 3.0, "time_constant_s": 0.02 * COUNT / RATE_HZ}
    entry = {"family": "gain_drift", "owner": {"name": "rx1"}, "parameters": parameters}
    read = effect_of(part, entry)
    assert FAMILIES["gain_drift"].factor(read, part.u) == pytest.approx(10 ** (3 / 20), rel=1e-9)


def test_a_step_tried_far_too_large_still_has_an_energy():
    """A search steps over 710 nepers at times, where exp is infinite."""
    factor = FAMILIES["gain_step"].factor(start(FAMILIES["gain_step"], [900.0, 0.5]), np.array([0.0, 0.5, 1.0]))
    assert factor[0] == 1 and factor[2] > 1e20 and np.isfinite(np.sum(factor**2))


@pytest.mark.parametrize("begins", [600, 1900, 2400])
@pytest.mark.parametrize("name", list(TIMED))
def test_a_twins_effect_is_in_a_part_of_a_recording_what_it_is_in_the_whole(name, begins):
    whole = scene([ONE[0], Path(source=0, delay=9.0, gain=0.5)])
    part = replace(whole, count=500, span=500, begins=begins, whole=COUNT)
    whole.rms = part.rms = 3.0
    family, (p, aux), plain, here = FAMILIES[name], TIMED[name], [1.0, 0.0], slice(begins, begins + 500)
    effect = start(family, p, aux=aux)
    told = {**family.values(whole, effect, effect.p), **family.constants(whole, effect)}
    entry = {"family": name, "owner": {"name": "rx1"}, "parameters": told, "model": family.model(whole, effect)}
    read = effect_of(part, entry)
    got = predict(part, Model(base=np.array([-begins, *plain]), effects=(read,))).y
    without, want = (predict(whole, Model(base=np.array([0, *plain]), effects=e)).y[here] for e in ((), (effect,)))
    if name == "carrier_frequency_offset":  # its phase at the part's beginning is the part's own
        got = got * np.vdot(got, want) / np.vdot(got, got)
    later = name in ("gain_step", "sample_loss") and begins == 600  # than the part
    assert (np.abs(want - without).max() < 1e-9) == later
    assert np.abs(got - want).max() < 1e-6 * np.abs(want).max()
    back = family.since_the_beginning(part, read)
    assert family.values(part, back, back.p) == pytest.approx(family.values(whole, effect, effect.p))
    assert family.model(part, back) == pytest.approx(family.model(whole, effect))


NOISES = {
    "noise_floor": {"change_db": 1.5},
    "signal_dependent_noise": {"slope_db": -4.0},
    "pulsed_interference": {"period_s": 1e-4, "duty_cycle": 0.2, "power_dbc": -12.0},
    "impulsive_noise": {"rate_hz": 3e3, "power_db": -20.0},
    "narrowband_interference": {"frequency_hz": 1e5, "bandwidth_hz": 5e4, "power_dbc": -15.0},
}


@pytest.mark.parametrize("name", list(NOISES))
def test_a_noise_family_read_back_from_what_it_writes_is_as_strong(name):
    world, family = scene(ONE), FAMILIES[name]
    world.rms, world.floor = 0.5, 1e-3
    effect = family.parse(world, NOISES[name], {})
    assert family.values(world, effect, effect.p) == pytest.approx(NOISES[name])
    again = family.parse(world, NOISES[name], family.model(world, effect))
    assert np.allclose(again.p, effect.p) and again.aux == {**effect.aux, **again.aux}
    rng = np.random.default_rng(2)
    white = lambda: (rng.normal(size=COUNT) + 1j * rng.normal(size=COUNT)) / np.sqrt(2)  # noqa: E731
    wanted = np.full(COUNT, 0.5)
    power = np.mean([np.mean(np.abs(family.added(world, again, wanted, white)) ** 2) for _ in range(40)])
    told = {
        "noise_floor": 0.0,
        "signal_dependent_noise": 1e-3 * 10**-0.4,
        "pulsed_interference": 0.25 * 10**-1.2 * 0.2,
        "impulsive_noise": 3e3 / RATE_HZ * 10**-2,
        "narrowband_interference": 0.25 * 10**-1.5,
    }
    assert power == pytest.approx(told[name], rel=0.15)


def test_the_law_of_wandering_is_that_of_a_wiener_process():
    family = FAMILIES["phase_noise"]
    world = scene(ONE)
    law = family.parse(world, {"linewidth_hz": 40.0}, {"highest_hz": 2e5})
    rng, lag = np.random.default_rng(3), 300
    steps = [np.diff(world.course(family.played(world, law, rng).p)[::lag]) for _ in range(200)]
    assert np.var(steps) == pytest.approx(2 * np.pi * 40.0 * lag / RATE_HZ, rel=0.1)


def test_a_wander_is_told_by_its_linewidth_and_of_a_part_by_what_the_whole_is_expected_to_do():
    family, world = FAMILIES["phase_noise"], scene(ONE)
    law = family.parse(world, {"linewidth_hz": 40.0}, {"highest_hz": 2e5})
    part = scene(ONE)
    part.whole = 4 * part.span
    rng, rms, told = np.random.default_rng(3), [], family.values(part, law, law.p)
    for _ in range(300):
        walk = np.cumsum(rng.normal(size=2000)) * np.sqrt(2 * np.pi * 40.0 * part.whole / RATE_HZ / 2000)
        rms.append(np.std(walk - np.polyval(np.polyfit(np.arange(2000), walk, 1), np.arange(2000))))
    assert told["linewidth_hz"] == pytest.approx(40.0) == family.values(world, law, law.p)["linewidth_hz"]
    assert told["rms_rad"] == pytest.approx(np.sqrt(np.mean(np.square(rms))), rel=0.06)
    assert np.std(rms) / told["rms_rad"] < family.spread(part, law, 0.0, 1.0)["rms_rad"] / told["rms_rad"] < 0.5


def test_a_fading_tap_is_drawn_with_its_k_factor_and_doppler():
    family, world = FAMILIES["tap_fading"], scene(ONE)
    told = {"delay_s": 0.0, "k_factor_db": 12.0, "doppler_spread_hz": 2e4}
    law = family.parse(world, told, {})
    rng = np.random.default_rng(3)
    drawn = [family.played(world, law, rng) for _ in range(100)]
    values = [family.values(world, e, e.p) for e in drawn]
    assert np.mean([10 ** (-v["k_factor_db"] / 10) for v in values]) == pytest.approx(10**-1.2, rel=0.1)
    assert np.mean([v["doppler_spread_hz"] for v in values]) == pytest.approx(2e4, rel=0.1)


def test_inner_products_of_derivatives_are_those_of_their_rows():
    rng = np.random.default_rng(3)
    noise = lambda *shape: rng.normal(size=shape) + 1j * rng.normal(size=shape)  # noqa: E731
    blocks = [
        Dense(signals=noise(3, COUNT)),
        Lags(signals=noise(2, COUNT), entries=((0, -2), (1, 0), (1, 5)), window=rng.random(COUNT)),
        Lags(signals=noise(1, COUNT), entries=((0, 0), (0, 3)), paired=-1),
        Courses(signals=noise(2, COUNT), orders=7, scene=scene(ONE)),
        Courses(signals=noise(1, COUNT), orders=4, scene=scene(ONE)),
    ]
    rows = np.concatenate([b.full() for b in blocks])
    want = (np.conj(rows) @ rows.T).real
    miss = np.abs(gram(blocks) - want) / np.abs(want).max()
    assert miss[:13, :13].max() < 1e-8 and miss.max() < 2e-3  # courses are taken over short blocks


def test_a_carrier_of_which_no_drift_is_known_is_not_said_to_drift():
    family = FAMILIES["carrier_frequency_offset"]
    told = {"offset_hz": {"value": 120.0, "std": 1.0}, "drift_hz_per_s": {"value": 0.0, "std": 0.0}}
    assert family.describe(Words(told, {})) == "The carrier lies 120.0 ± 1.0 Hz off."
    told["drift_hz_per_s"] = {"value": 30.0, "std": 2.0}
    assert "drifts by 30.0 ± 2.0 Hz/s" in family.describe(Words(told, {}))
