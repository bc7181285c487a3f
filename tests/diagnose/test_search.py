# SPDX-License-Identifier: GPL-3.0-or-later
"""Fits that the search relies on: effects that stand still, amplifiers and filters in the forms that suit each other."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from conftest_world import RATE_HZ, World, sent_once
from conftest_world import noise as noise_of
from gr_cast.diagnose import align, diagnose, noise, read_case, search
from gr_cast.diagnose.next_recording import Hypothesis, record_next
from gr_cast.diagnose.ownership import kind_of
from gr_cast.diagnose.search import _colour, _polished, causes, refit
from gr_cast.diagnose.view import View
from gr_cast.signals import recording
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start
from gr_cast.twin.model import predict
from scipy import signal
from scipy.ndimage import gaussian_filter1d


@pytest.fixture
def bent(world, tmp_path):
    """(data, model) of a complex code through a short filter, then compressed at every sample."""
    world.code = {"code": "zadoff_chu", "length": 1021, "root": 7, "samples_per_chip": 1}
    twin = world.twin()
    world.twin = lambda: twin | {"links": [twin["links"][0] | {"taps": [{"delay_s": 0.0}]}]}
    index = np.arange(1021)
    code = np.exp(-1j * np.pi * 7 * index * (index + 1) / 1021)
    sent = sum(tap * np.roll(code, lag) for lag, tap in ((-1, 0.3j), (0, 1.0), (1, 0.5), (2, -0.3)))
    y = np.resize(0.2 * sent * (1 - 0.05 * np.abs(sent) ** 2), len(world.n))
    case = read_case(world.write(tmp_path / "case", world.noisy(y)))
    _, data, model = align.build(case, case.observations[0].part(0, 4000))
    return data, model


def _filter(side, **more):
    aux = {"low": -2, "high": 2, "side": side} | ({"source": 0} if side == "tx" else {})
    return start(FAMILIES["front_end_filter"], np.zeros(8), aux=aux, **more)


def test_numbers_that_are_not_free_stay_whatever_their_prior(bent):
    data, model = bent
    fit = refit(data, model.adding(_filter("rx", free=np.zeros(8, bool), prior=np.ones(8))))
    assert (fit.model.effects[0].p == 0).all()


def test_a_filter_moves_in_front_of_the_amplifier_that_bends_its_peaks(bent):
    data, model = bent
    plain = {"source": 0, "peak": 1.0, "orders": (1,)}
    first = refit(data, model.adding(start(FAMILIES["pa_nonlinearity"], np.zeros(2), aux=plain)).adding(_filter("rx")))
    best = _polished(data, first)
    assert best.evidence > first.evidence
    assert next(e for e in best.model.effects if e.family == "front_end_filter").aux["side"] == "tx"


def test_an_amplifier_remembers_only_what_pays_for_its_memory(bent):
    data, model = bent
    lasting = {"source": 0, "peak": 1.0, "orders": (1,), "lags": (1,)}
    first = refit(data, model.adding(_filter("tx")).adding(start(FAMILIES["pa_nonlinearity"], np.zeros(6), aux=lasting)))
    best = search.eliminate(data, first, [])
    amplifier = next(e for e in best.model.effects if e.family == "pa_nonlinearity")
    assert best.evidence > first.evidence and not amplifier.aux.get("lags")


def test_what_is_read_off_the_samples_takes_no_place_of_what_is_searched_for(bent):
    _, model = bent
    rails = start(FAMILIES["adc_clipping"], [1.0, 0.0], free=[False] * 2, aux={"read": True})
    leak = start(FAMILIES["lo_leakage"], [0.0, 0.0], aux={"source": 0})
    assert [causes(m) for m in (model.adding(rails), model.adding(rails).adding(leak))] == [0, 1]


def test_two_converters_that_clip_are_two_causes_and_an_offset_in_both_is_one():
    scene = SimpleNamespace(transmitters=["tx1"])
    seen = [SimpleNamespace(observation=SimpleNamespace(receiver=name), scene=scene) for name in ("rx1", "rx2")]
    rails = start(FAMILIES["adc_clipping"], [1.0, 0.0], free=[False] * 2, aux={"read": True})
    carrier = start(FAMILIES["carrier_frequency_offset"], [1.0, 0.0])
    assert [len({kind_of(finding, effect) for finding in seen}) for effect in (rails, carrier)] == [2, 1]


def _next(*fits):
    return record_next([Hypothesis.of(fit, like=fits[0]) for fit in fits])


def test_a_filter_and_a_tail_are_told_apart_by_another_link(bent):
    data, model = bent
    tail = start(FAMILIES["diffuse_tail"], np.zeros(12), prior=np.ones(12), aux={"source": 0, "first": 1.0})
    fits = [refit(data, model.adding(effect)) for effect in (_filter("rx"), tail)]
    assert _next(*fits) in ("second_link", "move_carrier")


def test_a_gain_that_is_known_tells_which_of_two_taps_is_wrong_and_not_dc_from_leakage(world, tmp_path):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + 0.02 - 0.1 * world.path(9))))
    _, data, model = align.build(case, case.observations[0])
    weak, strong = (refit(data, model.adding(start(FAMILIES["tap_gain_error"], [0.0, 0.0], aux={"tap": k}))) for k in (1, 0))
    assert _next(weak, strong) == "absolute_calibration"
    dc = start(FAMILIES["dc_offset"], [0.0, 0.0, 0.0], free=[True, True, False])
    leak = start(FAMILIES["lo_leakage"], [0.0, 0.0], aux={"source": 0})
    fits = [refit(data, weak.model.adding(effect)) for effect in (dc, leak)]
    assert _next(*fits) in ("offset_carrier", "mute_transmitter", "second_link")


@pytest.mark.parametrize(("half_width", "tones"), [(1e-9, 1), (0.004, 0)])
def test_peaks_of_a_band_of_noise_are_no_tones(world, tmp_path, half_width, tones):
    n, rng = len(world.n), np.random.default_rng(8)
    band = np.abs(np.fft.fftfreq(n) - 0.21) <= half_width
    draw = np.fft.ifft(np.fft.fft(rng.normal(size=n) + 1j * rng.normal(size=n)) * band)
    draw *= 0.02 / np.sqrt(np.mean(np.abs(draw) ** 2))
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + draw)))
    _, data, model = align.build(case, case.observations[0])
    assert View(refit(data, model)).lines(count=2)[:1] == [0.21 * n] * tones


@pytest.mark.parametrize(("loud", "told"), [(0.0, False), (20.0, True)])
def test_a_line_of_the_signal_at_half_the_rate_has_no_sign_and_is_no_tone_unless_it_is_louder(world, tmp_path, loud, told):
    world.x = signal.resample(world.x.real, 500) + 0.5 * (-1.0) ** np.arange(500)  # an even period
    recording.write(tmp_path / "sent", world.x, sample_rate_hz=RATE_HZ)
    half = signal.resample(world.x, 1000)[1::2]  # half a sample early: of a real wave at half the rate nothing is left then
    assert np.abs(np.fft.fft(half)[250]) < 1e-9 * np.abs(np.fft.fft(world.x)[250])
    tone = loud * 0.3 * np.exp(2j * np.pi * 0.5 * world.n)
    twin = world.twin() | {"waveforms": {"w1": {"file": "sent", "repeat": True}}}
    world.twin = lambda: twin | {"links": [{"tx": "tx1", "rx": "rx1", "taps": [{"delay_s": 0.0}]}]}
    folder = world.write(tmp_path / "case", world.noisy(0.3 * half[world.n % 500] + tone))
    for file in tmp_path.glob("sent.*"):
        file.rename(folder / file.name)
    case = read_case(folder)
    _, data, model = align.build(case, case.observations[0])
    assert bool(View(refit(data, model)).lines(count=2)) == told


@pytest.mark.parametrize("cycles", [2.0, -61.0, 150.0])
def test_an_echo_is_found_however_fast_a_path_may_turn_it(world, tmp_path, cycles):
    """A carrier of 1 GHz, 20 ms: a path that grows by 3 km/s turns by 200 cycles."""
    world.taps = world.taps[:1]
    echo = 0.3 * 0.02 * world.path(23) * np.exp(2j * np.pi * cycles * world.n / len(world.n))
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean() + echo)))
    _, data, model = align.build(case, case.observations[0])
    found = [e for e in FAMILIES["extra_path"].starts(View(refit(data, model))) if e.free[3]]
    assert any(abs(e.p[2] - 23) < 1 and abs(e.p[3] - cycles) <= 0.5 for e in found)


@pytest.mark.parametrize("cycles", [-13.3, 41.0])
def test_an_echo_that_turns_is_found_where_the_waveform_is_known_in_parts(tmp_path, cycles):
    rng, count = np.random.default_rng(4), 30000
    sent = noise_of(rng, count)
    y = sent + 0.03 * np.roll(sent, 14) * np.exp(2j * np.pi * cycles * np.arange(count) / count) + noise_of(rng, count, 0.1)
    for begin, end in ((2000, 9000), (15000, 18000)):
        sent[begin:end] = np.nan
    case = sent_once(tmp_path, y, sent)
    _, data, model = align.build(case, case.observations[0])
    assert data.scene.at is not None
    (delay, found, *_), *_ = View(refit(data, model)).echoes(0, count=1, fastest=100.0)
    assert abs(delay - 14) < 1 and abs(found - cycles) <= 0.5


@pytest.mark.parametrize("a", [-0.4, 0.0, 0.4])
def test_coloured_noise_is_worth_what_its_entropy_lacks_where_it_is_densest_in_the_signals_band(world, tmp_path, a):
    world.x = np.repeat(world.x[::2], 8)
    world.code = world.code | {"samples_per_chip": 8}
    noise = world.noisy(np.zeros(len(world.n)))
    case = read_case(world.write(tmp_path / "case", world.clean() + noise + a * np.roll(noise, 1)))
    _, data, model = align.build(case, case.observations[0])
    # The geometric mean of |1 + a·e^jω|² is 1, its mean 1 + a² (Kolmogorov's formula); densest at ω = 0 for a > 0
    want = data.count * np.log(1 + a**2) - 10 * np.log(data.count) if a > 0 else 0.0
    assert _colour(refit(data, model)) == pytest.approx(want, rel=0.1, abs=50.0)


def test_starts_that_are_elsewhere_are_scored_in_every_size_of_a_course(world, tmp_path, monkeypatch):
    case = read_case(world.write(tmp_path / "case", world.noisy(world.clean())))
    _, data, model = align.build(case, case.observations[0])
    monkeypatch.setattr(search, "ELSEWHERE", -1.0)
    fit = search.refit(data, model.adding(start(FAMILIES["carrier_frequency_offset"], [0.1, 0.0])))
    assert all(np.isfinite(s.net) for s in search.candidates(fit))


@pytest.mark.parametrize(("centre", "told"), [(0.0, False), (0.25, True)])
def test_noise_that_fills_just_the_signals_band_is_no_interference(world, tmp_path, centre, told):
    n = len(world.n)
    f = np.fft.fftfreq(n)
    world.x = np.fft.ifft(np.where(np.abs(np.fft.fftfreq(510)) < 0.1, np.fft.fft(world.x), 0))
    loud = np.fft.ifft(np.fft.fft(world.noisy(np.zeros(n))) * np.where(np.abs(f - centre) < 0.1, 2.0, 0.0))
    folder = world.write(tmp_path / "case", world.noisy(world.clean()) + loud)
    recording.write(folder / "sent", world.x, sample_rate_hz=RATE_HZ)
    twin = world.twin() | {"waveforms": {"w1": {"file": "sent", "repeat": True}}}
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    case = read_case(folder)
    _, data, model = align.build(case, case.observations[0])
    families = [effect.family for _, effect in noise.starts(search.refit(data, model))]
    assert ("narrowband_interference" in families) == told


def test_samples_lost_are_looked_for_in_recordings_of_every_length(world, tmp_path):
    """Also where the last of so many equal segments would be empty: 49 lengths from 41² to 47² samples."""
    y = np.where(world.n < 800, world.clean(), np.roll(world.clean(), -30))
    case = read_case(world.write(tmp_path / "case", world.noisy(y)))
    _, data, model = align.build(case, case.observations[0].part(0, 2300))
    whole = refit(data, model)
    for n in range(1600, 2300):
        scene = data.scene.stretch(0, n, data.scene.sources, {})
        here = SimpleNamespace(**vars(whole) | {"data": replace(data, scene=scene, y=data.y[:n], use=data.use[:n])})
        here.chain, here.residual, here.came = predict(scene, whole.model), data.y[:n] - whole.chain.y[:n], whole.came
        joints = View(here).jumps(lambda lost: start(FAMILIES["sample_loss"], [-np.inf, lost], free=[False, False]))
        assert any(abs(at - 800) <= 1 and (lost - 30) % len(world.x) == 0 for at, lost, _ in joints), n


def test_a_transmitter_that_fades_out_under_steady_noise_is_told_though_the_signal_is_no_louder(world, tmp_path):
    """A receiver's gain would change the noise too, which the noise refuses louder than the signal asks for it."""
    world.noise_rms = 0.3
    fallen = world.clean() * 10 ** (-12.0 * world.n / len(world.n) / 20)
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(fallen)))).document
    (effect,) = document["effects"]
    assert document["verdict"] == "identified" and effect["family"] == "gain_drift" and effect["owner"]["level"] == "tx"
    total = effect["parameters"]["total_db"]
    assert abs(total["value"] + 12.0) < 4 * total["std"] < 2.0


@pytest.mark.parametrize(
    ("cycles", "course", "less"),
    [
        (0.7, lambda u: np.exp(0.3 * u), ["decibels"]),
        (0.3, lambda u: np.exp(-1.2 * (1 - np.exp(-u / 0.18))), ["relaxation"]),
        (3.0, lambda u: 1 + 0.1 * np.cos(6 * np.pi * u), []),
    ],
)
def test_a_hum_of_which_not_one_period_is_seen_is_a_drift(tmp_path, cycles, course, less):
    rng, count, begins, size = np.random.default_rng(4), 20_000, 9000, 7000
    sent = np.fft.ifft(np.fft.fft(rng.normal(size=(size, 2)) @ [1, 1j]) * (np.abs(np.fft.fftfreq(size)) < 0.3))
    y = np.zeros(count, complex)
    y[begins : begins + size] = sent
    y += 0.03 * rng.normal(size=(count, 2)) @ [1, 1j]
    u = np.arange(count) / count
    y *= course(u)
    case = sent_once(tmp_path, y, sent)
    _, data, model = align.build(case, case.observations[0])
    fit = refit(data, model.adding(start(FAMILIES["power_supply_hum"], [0.01, 0.01, cycles])))
    found = search._lesser(data, fit, len(model.effects), [])
    assert {e.family for e in found.model.found} <= {"gain_drift"}
    assert [e.aux["law"] for e in found.model.found] == less and bool(less) == (found.evidence > fit.evidence)


@pytest.mark.parametrize("harmonics", [2, 3, 4])
def test_a_hum_of_even_harmonics_alone_hums_twice_as_fast(tmp_path, harmonics):
    rng, count, cycles = np.random.default_rng(4), 20_000, 8.0
    sent = np.fft.ifft(np.fft.fft(rng.normal(size=(count, 2)) @ [1, 1j]) * (np.abs(np.fft.fftfreq(count)) < 0.3))
    y = sent * (1 + 0.3 * np.cos(2 * np.pi * cycles * np.arange(count) / count)) + 0.1 * rng.normal(size=(count, 2)) @ [1, 1j]
    case = sent_once(tmp_path, y, sent)
    _, data, model = align.build(case, case.observations[0])
    hum = start(FAMILIES["power_supply_hum"], [0.01, 0.01, cycles / 2, 0.3, 0.01, *[0.0] * (2 * harmonics - 4)])
    fit = refit(data, model.adding(hum))
    found = search._lesser(data, fit, len(model.effects), [])
    assert found.evidence > fit.evidence and found.model.found[0].p[2] == pytest.approx(cycles, abs=0.05)


@pytest.mark.parametrize(("lost", "joint", "later"), [(-9, 8000, False), (14, 8000, False), (14, 17_000, True)])
def test_samples_lost_before_anything_is_heard_or_behind_it_are_a_delay(tmp_path, lost, joint, later):
    rng, count, begins, size = np.random.default_rng(4), 20_000, 9000, 7000
    sent = np.fft.ifft(np.fft.fft(rng.normal(size=(size, 2)) @ [1, 1j]) * (np.abs(np.fft.fftfreq(size)) < 0.3))
    y = 0.03 * rng.normal(size=(count, 2)) @ [1, 1j]
    y[begins : begins + size] += sent
    case = sent_once(tmp_path, y, sent)
    _, data, model = align.build(case, case.observations[0])
    late = model.base + (-lost if later else lost) * np.eye(len(model.base))[0]
    loss = start(FAMILIES["sample_loss"], [joint, lost], free=[False, False], aux={"later": later})
    wrong = replace(model, base=late)
    fit, known = refit(data, wrong.adding(loss)), [refit(data, wrong)]  # what a search has fitted of it at the wrong delay
    found = search._lesser(data, fit, len(model.effects), known)
    assert not found.model.found and found.evidence > fit.evidence and found.model.base[0] == pytest.approx(0.0, abs=0.05)


def test_a_burst_under_a_known_carrier_promises_no_more_than_chance(tmp_path):
    """Between its ends a course that turns all of the burst is the carrier itself, and gains nothing beside it."""
    rng, count, silent, offset_hz = np.random.default_rng(4), 20_000, 8000, 50.0
    spectrum = np.fft.fft(rng.normal(size=(count - silent, 2)) @ [1, 1j])
    sent = np.fft.ifft(spectrum * (np.abs(np.fft.fftfreq(len(spectrum))) < 0.3))
    y = np.concatenate([np.zeros(silent), 0.3 * sent]) * np.exp(2j * np.pi * offset_hz * np.arange(count) / RATE_HZ)
    sent_once(tmp_path, y + 5e-4 * rng.normal(size=(count, 2)) @ [1, 1j], sent)
    twin = yaml.safe_load((tmp_path / "twin.yaml").read_text())
    told = {"offset_hz": {"value": offset_hz, "std": 1.0}, "drift_hz_per_s": {"value": 0.0, "std": 1.0}}
    owner = {"level": "rx", "name": "rx1"}
    twin["effects"] = [{"family": "carrier_frequency_offset", "owner": owner, "parameters": told}]
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(twin))
    case = read_case(tmp_path)
    _, data, model = align.build(case, case.observations[0])
    (fit, *_) = search.beginnings(data, model)
    assert max(s.net for s in search.candidates(fit)) < 10


def test_a_lone_echo_that_stands_still_is_no_tail_for_the_dopplers_that_it_might_have_had(tmp_path):
    """80 nats of one tap, integer delay: a tail's many taps explain as much, and only what each pays for tells them apart."""
    world = World(0)
    gain = np.sqrt(80 / len(world.n)) * world.noise_rms * np.exp(3.3j)
    y = world.noisy(world.clean() + gain * world.path(5))
    document = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=300).document
    assert [e["family"] for e in document["effects"]] == ["extra_path"] and not document["ambiguous"]


def test_what_stands_behind_a_promise_that_is_not_kept_is_tried_too(world, tmp_path, monkeypatch):
    """As the colour of impulses promises a filter, on either side, and a path that fades less."""
    fading = gaussian_filter1d(noise_of(world.rng, len(world.n)), 2000, mode="wrap")
    y = world.noisy(world.clean() + 0.005 * world.path(9) * (fading - fading.mean()) / fading.std())
    case = read_case(world.write(tmp_path / "case", y))
    _, data, model = align.build(case, case.observations[0])
    scored, kept = search._candidates, search.plausible

    def lying(fit):
        scores = [replace(s, net=s.net + 1e4 * (s.effect.family == "front_end_filter")) for s in scored(fit)]
        return sorted(scores, key=lambda s: -s.net)

    monkeypatch.setattr(search, "_candidates", lying)
    monkeypatch.setattr(
        search, "plausible", lambda model: "front_end_filter" not in {e.family for e in model.effects} and kept(model)
    )
    best = search.search(data, [refit(data, model)])[0]
    assert [e.family for e in best.model.found] == ["tap_fading"]
