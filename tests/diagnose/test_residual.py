# SPDX-License-Identifier: GPL-3.0-or-later
"""What is left after a fit: jumps that no oscillator makes, errors of a coarse quantiser that are no place of their own,
and what is too fast to be followed."""

from dataclasses import replace

import numpy as np
import pytest
from conftest_world import RATE_HZ
from gr_cast.diagnose import align, diagnose, floor, gate, jitter, noise, policy, read_case, residual, run
from gr_cast.diagnose.finding import Finding
from gr_cast.diagnose.fit import off_the_rails
from gr_cast.diagnose.search import refit, through_the_quantiser
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.effects.phase_noise import shape_of


def _built(world, folder, y):
    case = read_case(world.write(folder, y))
    _, data, model = align.build(case, case.observations[0])
    return data, model


def _followed(world, folder, phase, size=480):
    data, model = _built(world, folder, world.noisy(world.clean() * np.exp(1j * phase)))
    law = {"law": "held", "corner": size / 8}
    prior = 0.01 * shape_of(law, size) / shape_of(law, size).sum()
    return refit(data, model.adding(start(FAMILIES["phase_noise"], np.zeros(size), prior=prior, aux=law)))


def _wander(rng, count, memory):
    white = rng.normal(size=count + 8 * memory)
    phase = np.convolve(white, np.exp(-np.arange(8 * memory + 1) / memory), "valid")
    return phase / phase.std()


def test_a_jump_of_phase_is_no_phase_noise(world, tmp_path):
    (jump,) = residual.jumps(_followed(world, tmp_path / "case", 0.8 * (world.n >= 7000)))
    assert jump.p_value < policy.UNEXPLAINED_P
    assert jump.where["time_s"][0] - 2e-5 <= 7e-3 <= jump.where["time_s"][1] + 2e-5


def test_phase_noise_of_a_held_oscillator_is_no_jump(world, tmp_path):
    phase = 0.1 * _wander(np.random.default_rng(3), len(world.n), 150)
    (jump,) = residual.jumps(_followed(world, tmp_path / "case", phase))
    assert jump.p_value > 0.01


def _faded(world, folder, course, orders=100):
    """The fit of a second tap whose gain goes through a course (n,)."""
    steady, moving = (0.3 * np.exp(0.4j) * a * world.path(d) for d, a in world.taps)
    data, model = _built(world, folder, world.noisy(steady + moving * course))
    fading = start(FAMILIES["tap_fading"], np.zeros(2 * orders), prior=np.full(2 * orders, 0.01), aux={"tap": 1})
    mean = start(FAMILIES["tap_gain_error"], [0.0, 0.0], aux={"tap": 1})
    return refit(data, model.adding(mean).adding(fading))


def test_a_tap_that_hops_does_not_fade(world, tmp_path):
    (jump,) = residual.jumps(_faded(world, tmp_path / "case", np.where(world.n < 12_000, 1.0, 0.7)))
    assert jump.p_value < policy.UNEXPLAINED_P
    assert jump.where["time_s"][0] - 1e-4 <= 12e-3 <= jump.where["time_s"][1] + 1e-4


def test_a_tap_that_fades_does_not_hop(world, tmp_path):
    rng = np.random.default_rng(6)
    course = 1 + 0.4 * (_wander(rng, len(world.n), 800) + 1j * _wander(rng, len(world.n), 800))
    (jump,) = residual.jumps(_faded(world, tmp_path / "case", course))
    assert jump.p_value > 0.01


def test_phase_noise_too_fast_to_follow_is_noise_across_the_signal_alone(world, tmp_path):
    rng = np.random.default_rng(4)
    fast = 0.02 * rng.normal(size=len(world.n))
    fit = _followed(world, tmp_path / "case", 0.03 * _wander(rng, len(world.n), 400) + fast)
    follows = start(FAMILIES["signal_dependent_noise"], [0.0], free=[False])
    settled = jitter.of_a_wander(refit(fit.data, fit.model.adding(follows), near=fit))
    assert [e.family for e in settled.model.found] == ["phase_noise"]
    assert settled.model.found[0].aux["_jitter"] == pytest.approx(np.mean(fast**2), rel=0.2)


def _at_random(rng, count):
    return rng.uniform(0, 40_000, count)


def _sparks(rng, count, gap=40.0, each=6):
    """Sparks of up to a dozen samples in trains of so many that come at random."""
    places = [first + np.cumsum(rng.exponential(gap, each)) for first in _at_random(rng, count)]
    return np.concatenate([p + np.arange(rng.integers(1, 13)) for p in np.concatenate(places)])


def _flashes(rng, count):
    """A few strokes each."""
    return np.concatenate([first + rng.uniform(30, 180) * np.arange(3) for first in _at_random(rng, count)])


TRAINS = {"alone": _at_random, "sparks": _sparks, "flashes": _flashes}
CROWDS = {
    "in one stretch": lambda rng, count: rng.uniform(0.3, 0.4, 4 * count) * 40_000,
    "in one stretch, and some elsewhere": lambda rng, count: np.append(
        _at_random(rng, count), rng.uniform(0.3, 0.32, 3 * count) * 40_000
    ),
    "bursts": lambda rng, count: np.concatenate([f + np.flatnonzero(rng.random(300) < 0.8) for f in _at_random(rng, count)]),
}


@pytest.mark.parametrize("kind", [*TRAINS, *CROWDS])
def test_impulses_come_at_random_alone_or_in_trains_and_are_something_else_where_they_crowd(kind):
    rng = np.random.default_rng(8)
    draw = (TRAINS | CROWDS)[kind]
    places = [np.unique(np.clip(draw(rng, int(rng.integers(16, 60))).astype(int), 0, 39_999)) for _ in range(100)]
    crowding = [residual.crowded(at, 40_000) < policy.CROWDED_P for at in places]
    assert np.mean(crowding) == pytest.approx(float(kind in CROWDS), abs=0.05)


@pytest.mark.parametrize("band", [0.0, 0.7])
def test_sparks_in_trains_leave_nothing_of_their_colour_and_hide_no_noise_of_a_band(world, tmp_path, band):
    rng, count = world.rng, len(world.n)
    trains = [first + np.cumsum(rng.exponential(40.0, 6)) for first in rng.uniform(0, count, 25)]
    hit = np.zeros(count + 40, complex)
    for at in np.concatenate(trains).astype(int):
        if at < count:
            burst = (rng.normal(size=32) + 1j * rng.normal(size=32)) * np.exp(-np.arange(32) / 6)
            burst = np.convolve(burst, [0.25, 0.75, 1.0, 0.75, 0.25])
            hit[at : at + 36] += burst / np.abs(burst).max()
    f = np.fft.fftfreq(count)
    hiss = np.sqrt(count / 2) * np.fft.ifft(
        (np.abs(f - 0.2) < 0.1) * np.fft.fft(rng.normal(size=count) + 1j * rng.normal(size=count))
    )
    y = world.clean() + world.noise_rms * (7 * hit[:count] + band * hiss)
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(y))), budget_s=3000).document
    assert document["verdict"] == ("unexplained" if band else "identified")
    assert band or [e["family"] for e in document["effects"]] == ["impulsive_noise"]


@pytest.mark.parametrize("is_one", [True, False])
def test_pulses_have_any_one_colour(world, tmp_path, is_one):
    """Bursts of a packet radio that fills a part of the band; half of them in another part are something else."""
    rng, count = world.rng, len(world.n)
    f, white = np.fft.fftfreq(count), rng.normal(size=(2, count)) + 1j * rng.normal(size=(2, count))
    first, second = (np.fft.ifft((np.abs(f - middle) < 0.2) * np.fft.fft(w)) for w, middle in zip(white, (0.0, 0.3), strict=True))
    burst = np.where((np.arange(count) < count // 2) | is_one, first, second)
    gate = (np.arange(count) + 0.3 * count / 9) % (count / 9) < 0.3 * count / 9
    y = world.clean() + 1.2 * world.noise_rms * gate * burst
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(y))), budget_s=3000).document
    assert document["verdict"] == ("identified" if is_one else "unexplained")
    assert not is_one or [e["family"] for e in document["effects"]] == ["pulsed_interference"]


@pytest.mark.parametrize("apart", [0.0, 0.02, 0.3])
def test_pulses_that_are_white_have_no_colour_whether_or_not_rows_tell_them(apart):
    """Many pulses to a row are on for the same share of each: nothing tells their colour then."""
    random, rows, bins = np.random.default_rng(3), 48, 32
    on = np.clip(0.3 + apart * random.normal(size=(rows, 1)), 0, 1)
    count = np.full((rows, bins), 20.0)
    energy = random.gamma(20.0, size=(rows, bins))
    for is_white in (True, False):
        level, few = residual._coloured(energy, count, on, is_white)
        assert level == pytest.approx(1.0) and few == pytest.approx(1.0)


@pytest.mark.parametrize("is_white", [True, False])
def test_a_colour_of_pulses_is_told_where_rows_differ(is_white):
    random, rows, bins = np.random.default_rng(4), 48, 32
    on, own = random.random((rows, 1)), 1 + 0.8 * np.cos(2 * np.pi * np.arange(bins) / bins)
    count = np.full((rows, bins), 40.0)
    level, few = residual._coloured((mean := 1 - on + on * own) * random.gamma(40.0, size=mean.shape), count, on, is_white)
    shape = mean / (mean.mean(axis=0) if is_white else 1)
    assert np.abs(level / shape - 1).mean() < 0.06
    assert (few < 1 + 1e-9).all() and few.min() > 0.1


@pytest.mark.parametrize("seed", range(6))
def test_a_grid_in_a_file_of_floats_is_told_no_finer_than_they_are_written(seed):
    """A level is written to 24 bits and says no more of its step, however often it is met."""
    rng = np.random.default_rng(seed)
    step = rng.uniform(0.01, 0.03)
    grid = np.round(rng.normal(size=(20_000, 2)) * 0.1 / step).clip(-16, 16) * step
    *_, (effect, stds) = gate.discrete(np.float32(grid).astype(float) @ [1, 1j], "cf32_le")
    assert abs(effect.p[0] - step) < 4 * stds["step"] < 1e-5 * step


def test_a_quantiser_grid_of_few_steps_leaves_nothing_unexplained(world, tmp_path):
    world.code = {"code": "zadoff_chu", "length": 1021, "root": 7, "samples_per_chip": 1}
    index, step = np.arange(1021), 1 / 32
    world.x = np.exp(-1j * np.pi * 7 * index * (index + 1) / 1021)
    world.noise_rms = 0.004
    y = world.noisy(world.clean())
    coarse = step * (np.round(y.real / step) + 1j * np.round(y.imag / step))
    data, model = _built(world, tmp_path / "case", coarse)
    ((grid, _),) = gate.discrete(coarse, "cf32_le")
    fit = refit(data, through_the_quantiser(data, model.adding(grid)))
    for rest in residual.leftovers(fit, off_the_rails(fit)):
        assert rest.p_value > policy.UNEXPLAINED_P or rest.nats < policy.UNEXPLAINED_NATS


def test_a_quantiser_grid_and_lost_samples_are_all_that_is_found_of_both(world, tmp_path):
    world.taps = [(0, 1.0), (9, 0.5 * np.exp(0.7j)), (31, 0.4 * np.exp(2j)), (40, 0.3 * np.exp(-1j))]
    world.code = {"code": "zadoff_chu", "length": 509, "root": 7, "samples_per_chip": 1}
    index, step = np.arange(509), 1 / 32
    world.x = np.exp(-1j * np.pi * 7 * index * (index + 1) / 509)
    world.noise_rms = 0.004
    y = world.noisy(np.where(world.n < 17_000, world.clean(), np.roll(world.clean(), 155)))
    coarse = step * (np.round(y.real / step) + 1j * np.round(y.imag / step))
    document = diagnose(read_case(world.write(tmp_path / "case", coarse)), budget_s=3000).document
    assert document["verdict"] == "identified"
    assert {e["family"] for e in document["effects"]} == {"sample_loss", "quantization"}


def test_a_grid_whose_error_the_noise_hides_is_read_off_the_samples_all_the_same(world, tmp_path):
    step, world.noise_rms = 1 / 64, 1 / 48
    y = world.noisy(world.clean() * np.where(world.n < 11_000, 1.0, 0.97))
    coarse = step * (np.round(y.real / step) + 1j * np.round(y.imag / step))
    document = diagnose(read_case(world.write(tmp_path / "case", coarse)), budget_s=3000).document
    assert document["verdict"] == "identified"
    assert {e["family"]: e["confidence"] > 0.9 for e in document["effects"]} == {"gain_step": True, "quantization": True}


def test_the_mean_of_a_tap_that_fades_is_no_cause_of_its_own(world, tmp_path):
    fit = _faded(world, tmp_path / "case", 1 + 0.3 * np.cos(world.n / 800))
    finding = Finding(observation=None, scene=fit.data.scene, data=fit.data, twin=fit, fit=fit)
    others = [start(FAMILIES["spectral_inversion"], []), start(FAMILIES["carrier_frequency_offset"], [1.0, 0.0])]
    for more in others:
        finding.fit = replace(finding.fit, model=finding.fit.model.adding(more))
    found = finding.fit.model.found
    assert len(found) == 4 and [finding.is_cause(e) for e in found].count(True) == 3


def test_noise_in_a_band_raises_no_floor_and_leaves_nothing_beside_it(world, tmp_path):
    rng, n = np.random.default_rng(9), len(world.n)
    taps = np.sinc((np.arange(401) - 200) * 0.012) * np.hanning(401)  # a band with skirts
    band = np.convolve(rng.normal(size=n + 400) + 1j * rng.normal(size=n + 400), taps, "valid")
    band *= 0.012 / np.sqrt(np.mean(np.abs(band) ** 2)) * np.exp(2j * np.pi * 0.2 * world.n)
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + band)))
    scene, data, model = align.build(case, case.observations[0])
    plain = refit(data, model)
    _, interference = FAMILIES["narrowband_interference"].find(noise.view_of(plain))
    fit = refit(data, model.adding(interference), near=plain)
    finding = Finding(observation=case.observations[0], scene=scene, data=data, twin=plain, fit=fit)
    floor.compare(finding)
    run._look_for_rest(finding)
    assert [e.family for e in finding.fit.model.found] == ["narrowband_interference"]
    assert not finding.left


@pytest.mark.parametrize(("frequency", "told"), [(0.498, False), (0.398, True)])
def test_what_interpolation_cannot_know_is_not_told_as_left(world, tmp_path, frequency, told):
    rng, n = world.rng, len(world.n)
    band = (np.abs(np.abs(np.fft.fftfreq(n)) - frequency) < 0.002) * (rng.normal(size=n) + 1j * rng.normal(size=n))
    y = world.noisy(world.clean() + 2 * world.noise_rms * np.sqrt(n / 2) * np.fft.ifft(band))
    fit = refit(*_built(world, tmp_path / "case", y))
    rest = next(rest for rest in residual.leftovers(fit, off_the_rails(fit)) if rest.test == "frequency")
    assert (rest.p_value < 1e-5) == told


@pytest.mark.parametrize("side", ["tx", "rx"])
def test_an_image_may_change_the_floor_by_what_unequal_gains_can(world, tmp_path, side):
    world.noise_rms *= 10 ** (-0.16 / 20)
    y, told = world.noisy(world.clean()), world.noise_rms * 10 ** (0.16 / 20)
    world.noise_rms = told
    case = read_case(world.write(tmp_path / "case", y))
    scene, data, model = align.build(case, case.observations[0])
    for effects, floors in (([], 1), ([start(FAMILIES["iq_imbalance"], [1e-4, -0.011], aux={"side": side, "source": 0})], 0)):
        fit = refit(data, model)
        for effect in effects:
            fit = replace(fit, model=fit.model.adding(effect))
        finding = Finding(observation=case.observations[0], scene=scene, data=data, twin=fit, fit=fit)
        floor.compare(finding)
        assert [e.family for e in finding.fit.model.found].count("noise_floor") == floors


@pytest.mark.parametrize("family", ["noise_floor", "signal_dependent_noise"])
def test_noise_beside_phase_noise_has_the_law_that_it_has(world, tmp_path, family):
    world.taps = [(0, 1.0), (9, 0.8 * np.exp(0.7j))]  # a signal whose power changes
    clean = world.clean() * np.exp(0.05j * _wander(world.rng, len(world.n), 400))
    extra = 0.5 if family == "noise_floor" else 0.5 * np.abs(clean) ** 2 / np.mean(np.abs(clean) ** 2)
    noise = world.noisy(np.zeros(len(world.n)))
    case = read_case(world.write(tmp_path / "case", clean + noise * np.sqrt(1 + extra)))
    document = diagnose(case, budget_s=3000).document
    assert [e["family"] for e in document["effects"]] == ["phase_noise", family]


def test_rails_under_a_quantiser_grid_that_has_the_noise_in_it_are_hard(world, tmp_path):
    step = 1 / 32
    y = world.noisy(world.clean())
    coarse = step * (np.round(y.real / step) + 1j * np.round(y.imag / step))
    data, model = _built(world, tmp_path / "case", np.clip(coarse.real, -0.25, 0.25) + 1j * np.clip(coarse.imag, -0.25, 0.25))
    rails = start(FAMILIES["adc_clipping"], [0.25, 0.01], free=[False] * 2)
    grid = start(FAMILIES["quantization"], [step, 0.0, 0.3], free=[False] * 3)
    assert refit(data, model.adding(rails)).model.found[0].p[1] > 0
    assert refit(data, model.adding(rails).adding(grid)).model.found[0].p[1] == 0


@pytest.mark.parametrize("raised_db", [0.0, 0.5])
def test_a_floor_beside_phase_noise_is_told_from_what_is_too_fast_to_follow(world, tmp_path, raised_db):
    told = world.noise_rms
    world.noise_rms = told * 10 ** (raised_db / 20)
    y = world.noisy(world.clean() * np.exp(0.03j * _wander(world.rng, len(world.n), 60)))
    world.noise_rms = told
    document = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document
    assert [e["family"] for e in document["effects"]] == ["phase_noise"] + ["noise_floor"] * (raised_db > 0)


def test_every_sample_is_in_the_map_of_what_is_left(world, tmp_path):
    y = world.noisy(world.clean())
    y[-60:] += 30 * world.noise_rms  # less than the last row of a map
    fit = refit(*_built(world, tmp_path / "case", y))
    rest = residual.leftovers(fit, off_the_rails(fit))[0]
    assert rest.p_value < 1e-5 and rest.where["time_s"][1] == pytest.approx(len(y) / RATE_HZ)


def test_an_impulse_that_a_filter_draws_out_counts_once_and_a_burst_with_every_sample():
    drawn_out, burst = [100, 101, 103], list(range(500, 512))
    assert list(residual._beginnings(np.array([7, *drawn_out, *burst]))) == [7, 100, *burst]
