# SPDX-License-Identifier: GPL-3.0-or-later
"""An effect in another scene: the same physics from the first sample on, and the same as its entry in a twin says there."""

from dataclasses import replace

import numpy as np
import pytest
from gr_cast.twin.effects import FAMILIES, NAMED, stage_of
from gr_cast.twin.effects.base import rms_of, start
from gr_cast.twin.entries import effect_of
from gr_cast.twin.model import Model, predict
from gr_cast.twin.scene import Path, Scene, Source

RATE_HZ, COUNT, PERIOD = 1e6, 1500, 97
RNG = np.random.default_rng(5)
SPECTRUM = RNG.normal(size=PERIOD) + 1j * RNG.normal(size=PERIOD)
SPECTRUM[30:68] = 0
X = np.fft.ifft(SPECTRUM)
CARRIER_HZ = 1e8

SENT = {"source": 0}
FOUND = {  # one effect of every family that predicts, as a search may find it
    "iq_imbalance": ([0.05, -0.02], {"side": "tx", **SENT}),
    "lo_leakage": ([0.03, -0.01], SENT),
    "pa_nonlinearity": ([-0.1, 0.02, 0.03, 0.01, -0.02, 0.0], {**SENT, "peak": 0.3, "orders": (1,), "lags": (2,)}),
    "sample_loss": ([1100.0, 11.0], {}),
    "missing_path": ([], {"tap": 1}),
    "tap_gain_error": ([0.2, 0.4], {"tap": 1}),
    "tap_delay_error": ([0.7], {"tap": 1}),
    "tap_doppler": ([0.7, 0.4], {"tap": 1}),
    "extra_path": ([0.1, -0.05, 20.3, 1.2], SENT),
    "diffuse_tail": ([0.1, 0.02, -0.03, 0.01], {**SENT, "first": 1.0}),
    "sample_clock_offset": ([0.4], {}),
    "second_transmitter": ([0.1, 0.2, 3.3, 4.0], {"code": "other"}),
    "carrier_frequency_offset": ([0.4, 1.5], {}),
    "front_end_filter": ([0.05, 0.01, 0.02, 0.0], {"low": -1, "high": 1, "side": "rx"}),
    "gain_step": ([0.3, 0.7], {}),
    "gain_drift": ([0.1, -1.2], {"law": "relaxation"}),
    "power_supply_hum": ([0.04, 0.03, -17.0, 0.01, 0.02], {}),
    "dc_offset": ([0.04, 0.03, -1.0], {"decays": True}),
    "tone_interference": ([0.04, 0.03, 517.25], {}),
    "spectral_inversion": ([], {}),
    "adc_clipping": ([0.05, 0.0], {}),
    "quantization": ([0.1, 0.3, 0.2], {}),
}
NOISES = {
    "pulsed_interference": ([0.5, 97.3, 20.6, 0.21], {"_floor": 1e-3}),
    "narrowband_interference": ([1.5, 0.1, 0.05], {"_floor": 1e-3}),
    "signal_dependent_noise": ([-1.0], {"_floor": 1e-3}),
    "impulsive_noise": ([3.0, -5.0], {"_floor": 1e-3, "law": "random", "_level": 1e-3}),
    "noise_floor": ([1.5], {"_floor": 1e-3}),
}
RANDOM = {
    "tap_fading": (RNG.normal(size=12) * 0.1, {"tap": 1}),
    "phase_noise": (RNG.normal(size=6) * 0.1, {"law": "flat"}),
}


def scene(count=COUNT, begins=0, rms=3.0, carrier_hz=None):
    source = Source(name="w", samples=X, repeat=True, known=np.ones(PERIOD, bool), power=float(np.mean(np.abs(X) ** 2)), peak=1.0)
    taps = [Path(source=0, delay=0.0, gain=1.0), Path(source=0, delay=9.0, gain=0.5)]
    return Scene(
        name="r",
        sample_rate_hz=RATE_HZ,
        count=count,
        sources=[source],
        taps=taps,
        transmitters=["tx1"],
        receiver="rx1",
        anchor=0,
        extra={"other": replace(source, samples=np.conj(X))},
        rms=rms,
        begins=begins,
        carrier_hz=carrier_hz,
    )


def predicted(world, *effects, delay=0.0):
    return predict(world, Model(base=np.array([delay, 1.0, 0.0]), effects=effects)).y


def entry(name, world, effect):
    family = FAMILIES[name]
    parameters = {**family.values(world, effect, effect.p), **family.constants(world, effect)}
    side = effect.aux.get("side", "rx")
    owner = {"tx": "tx1", "rx": "rx1"}[side]
    if "tap" in effect.aux or name in ("extra_path", "diffuse_tail"):
        owner = "tx1>rx1"
    if family.owners == ("tx",):
        owner = "tx1"
    return {"family": name, "owner": {"name": owner}, "parameters": parameters, "model": family.model(world, effect)}


def made(name):
    p, aux = {**FOUND, **NOISES, **RANDOM}[name]
    prior = np.ones(len(p)) if name in RANDOM else None
    return start(FAMILIES[name], p, aux=aux, prior=prior)


def test_every_family_that_a_twin_may_list_is_moved_here():
    assert {*FOUND, *NOISES, *RANDOM} == {*NAMED}


@pytest.mark.parametrize("share", [0.5, 1.0, 2.0, 3.3])
@pytest.mark.parametrize("name", list(FOUND))
def test_a_moved_effect_predicts_what_its_entry_says_there(name, share):
    here, there, effect = scene(), scene(int(share * COUNT), rms=5.0), made(name)
    predicted(here, effect)  # leaves in the scene what an amplifier is driven with
    moved, read = FAMILIES[name].moved_to(effect, here, there), effect_of(there, entry(name, here, effect))
    want, got, plain = predicted(there, read), predicted(there, moved), predicted(there)
    gone = name in ("sample_loss", "gain_step") and share == 0.5  # it comes later
    assert (np.abs(want - plain).max() < 1e-9) == gone
    assert np.abs(got - want).max() < 1e-9 * np.abs(want).max()
    values = FAMILIES[name].values
    assert values(there, moved, moved.p) == pytest.approx(values(there, read, read.p))


@pytest.mark.parametrize("share", [0.5, 2.0, 3.3])
@pytest.mark.parametrize("name", list(NOISES))
def test_a_moved_law_of_noise_is_what_its_entry_says_there(name, share):
    here, there, effect, family = scene(), scene(int(share * COUNT), rms=5.0), made(name), FAMILIES[name]
    moved, read = family.moved_to(effect, here, there), effect_of(there, entry(name, here, effect))
    wanted = predicted(there)
    for law in (lambda e: family.variance(there, e, wanted), lambda e: family.spectrum(there, e)):
        assert (law(moved) is None and law(read) is None) or np.allclose(law(moved), law(read))
    assert rms_of(there, moved) == pytest.approx(rms_of(there, read))
    assert np.allclose(moved.p, read.p)


@pytest.mark.parametrize("name", list(RANDOM))
def test_of_a_random_course_another_recording_has_another_one(name):
    here, there, effect = scene(), scene(2 * COUNT), made(name)
    assert FAMILIES[name].moved_to(effect, here, there) is None
    read = effect_of(there, entry(name, here, effect))
    assert np.abs(predicted(there, read) - predicted(there)).max() < 1e-12 and (read.prior > 0).all()


@pytest.mark.parametrize("name", [n for n in FOUND if n not in ("front_end_filter", "spectral_inversion")])
def test_what_happens_does_not_depend_on_how_long_it_is_recorded(name):
    here, there, effect = scene(carrier_hz=CARRIER_HZ), scene(2 * COUNT, carrier_hz=CARRIER_HZ), made(name)
    moved = FAMILIES[name].moved_to(effect, here, there)
    got, want = predicted(there, moved)[:COUNT], predicted(here, effect)
    if name == "carrier_frequency_offset":  # its phase is counted from the middle, and any phase is free
        got = got * np.vdot(got, want) / np.vdot(got, got)
    assert np.abs(got - want).max() < 1e-6 * np.abs(want).max()


@pytest.mark.parametrize("begins", [400, 1250])
def test_an_echo_has_come_nearer_where_a_later_part_begins(begins):
    """A path whose Doppler is 500 turns at 100 MHz has moved by five samples at 1 Msample/s."""
    here, effect = scene(carrier_hz=CARRIER_HZ), start(FAMILIES["extra_path"], [0.1, -0.05, 40.3, 500.0], aux=SENT)
    there = scene(250, begins, carrier_hz=CARRIER_HZ)
    moved = FAMILIES["extra_path"].moved_to(effect, here, there)
    want = predicted(here, effect)[begins : begins + 250]
    assert moved.p[2] == pytest.approx(40.3 - 500 * RATE_HZ / CARRIER_HZ * begins / COUNT)
    assert np.abs(predicted(there, moved, delay=-begins) - want).max() < 1e-3 * np.abs(want).max()


@pytest.mark.parametrize("nepers", [0.4, -0.9])
@pytest.mark.parametrize(
    ("law", "course"),
    [
        ("decibels", lambda total, u: np.exp(total * u)),
        ("amplitude", lambda total, u: 1 + (np.exp(total) - 1) * u),
        ("relaxation", lambda total, u: np.exp(total * (1 - np.exp(-u / 0.3)) / (1 - np.exp(-1 / 0.3)))),
    ],
)
def test_a_drift_follows_its_law_in_whole_and_in_part_and_is_read_back(law, course, nepers):
    family, whole, u = FAMILIES["gain_drift"], scene(), np.linspace(0, 1, 50)
    drift = start(family, [nepers, np.log(0.3)], aux={"law": law})
    assert family.factor(drift, u) == pytest.approx(course(nepers, u), rel=1e-12)
    assert family.factor(family.in_time(whole, drift, 0.4, 0.2), u) == pytest.approx(course(nepers, 0.4 + 0.2 * u), rel=1e-9)
    told = family.values(whole, drift, drift.p)
    assert told["total_db"] == pytest.approx(20 * np.log10(course(nepers, 1.0)))
    assert family.factor(family.parse(whole, told, family.model(whole, drift)), u) == pytest.approx(course(nepers, u), rel=1e-9)
    longer = replace(whole, whole=3 * COUNT)  # a recording of which this is the first third
    ends = course(nepers, 3.0) < 0.05  # an amplitude that would end goes on in decibels
    told = family.values(longer, drift, drift.p)
    assert told["total_db"] == pytest.approx(20 * np.log10(np.exp(3 * nepers) if ends else course(nepers, 3.0)), rel=1e-6)
    read = family.parse(longer, told, family.model(longer, drift))
    assert family.factor(read, 1.0) == pytest.approx(np.exp(nepers), rel=1e-9)
    if law != "relaxation":  # which is followed back as far as it can be told
        of_all = family.since_the_beginning(scene(250, begins=750), drift)
        assert 1e-3 < family.factor(of_all, u).min() and family.factor(of_all, u).max() < 1e3


def test_a_relaxation_seen_late_is_not_followed_back_without_end():
    """In the thousandth part of a recording a drift of a hundredth of a part's length tells nothing of the beginning."""
    family, late = FAMILIES["gain_drift"], scene(250, begins=250_000)
    whole = family.since_the_beginning(late, start(family, [1e-3, np.log(0.01)], aux={"law": "relaxation"}))
    assert whole.p[0] == pytest.approx(1e-3 / 0.05) and np.isfinite(whole.aux["before"])


def test_there_is_no_effect_of_a_transmitter_that_is_not_on_the_air():
    here, there = scene(), replace(scene(), transmitters=["tx2"])
    assert FAMILIES["lo_leakage"].moved_to(made("lo_leakage"), here, there) is None
    assert FAMILIES["tap_gain_error"].moved_to(made("tap_gain_error"), here, there) is None


TURNING = {
    name: FOUND[name] for name in ("extra_path", "second_transmitter", "carrier_frequency_offset", "tone_interference")
} | {
    "phase_ramp": ([0.7, 0.2, 0.6], {}),
    "carrier_settling": ([0.7, -1.0], {}),
    "second_order": ([0.2, 0.1, -0.1, 0.05], {}),
    "pulsed_carrier": (
        [0.1, 0.05, -0.02, 0.1, 0.04, 0.0],
        {"period": 600.0, "first": 40.0, "width": 200.0, "frequency": 0.11, "sweep": 2e-4},
    ),
}


@pytest.mark.parametrize("name", TURNING)
def test_behind_no_inversion_what_turns_turns_back(name):
    """Of a real code over one path an inverted recording is that of a radio all of whose rotations go the other way round."""
    real = replace(scene().sources[0], samples=X.real.astype(complex))
    there = replace(scene(), sources=[real], taps=[Path(source=0, delay=0.0, gain=1.0)], extra={"other": real})
    p, aux = TURNING[name]
    both = start(FAMILIES[name], p, aux=aux), start(FAMILIES["spectral_inversion"], [])
    model = Model(base=np.array([3.0, 0.4, 0.3]), effects=tuple(sorted(both, key=stage_of)))
    inverted = predict(there, model)
    assert inverted.facing == -1
    at = next(i for i, e in enumerate(model.effects) if e.family == "spectral_inversion")
    np.testing.assert_allclose(predict(there, model.without(at)).y, inverted.y, atol=1e-9)
