# SPDX-License-Identifier: GPL-3.0-or-later
"""A waveform that is in a recording explains more of it than chance would, one that is not explains what chance does, whatever
else is recorded."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from conftest_world import noise, sent_once
from gr_cast.diagnose import align, diagnose, presence, read_case
from gr_cast.signals import codes

COUNT = 4096


def _ofdm(rng, symbols=32):
    bins = np.zeros((symbols, 128), complex)
    bins[:, np.r_[1:39, 90:128]] = np.exp(0.5j * np.pi * rng.integers(0, 4, (symbols, 76)))
    x = np.fft.ifft(bins, axis=1) * 128 / np.sqrt(76)
    return np.hstack([x[:, -4:], x]).ravel()[:COUNT]


def _on_off(rng):
    bits = rng.integers(0, 2, COUNT // 4)
    return np.repeat(np.stack([bits, 1 - bits], 1).ravel(), 2).astype(complex)


def _repeated(**code):
    return np.resize(codes.from_spec({"samples_per_chip": 1} | code).astype(complex), COUNT)


WAVES = {  # (what is sent, another one of its kind, period or 0)
    "noise": (lambda rng: noise(rng, COUNT), lambda rng: noise(rng, COUNT), 0),
    "ofdm": (_ofdm, _ofdm, 0),
    "on-off": (_on_off, _on_off, 0),
    "code": (
        lambda rng: _repeated(code="glfsr", degree=8, mask=0, seed=1),
        lambda rng: _repeated(code="gold", length=511),
        255,
    ),
    "chirp": (
        lambda rng: _repeated(code="zadoff_chu", length=509, root=7),
        lambda rng: _repeated(code="zadoff_chu", length=509, root=11),
        509,
    ),
}
STRANGERS = {
    "noise": lambda rng, other: noise(rng, COUNT),
    "tone": lambda rng, other: np.exp(2j * np.pi * rng.uniform(-0.5, 0.5) * np.arange(COUNT)) + noise(rng, COUNT, 0.1),
    "other": lambda rng, other: other + noise(rng, COUNT, 0.1),
    "click": lambda rng, other: noise(rng, COUNT) + 100 * (np.arange(COUNT) == rng.integers(COUNT)),
}


def _look(y, sent, period):
    by_places = presence.is_of_one_phase([SimpleNamespace(samples=sent)])
    return presence.look(y, sent[None], np.ones(len(y)), period, tried=period or 2 * COUNT, by_places=by_places)


@pytest.mark.parametrize("stranger", STRANGERS)
@pytest.mark.parametrize("wave", WAVES)
def test_what_was_not_sent_is_not_there(wave, stranger):
    sent, other, period = WAVES[wave]
    for seed in range(2):
        rng = np.random.default_rng(seed)
        y = STRANGERS[stranger](rng, other(np.random.default_rng(99 + seed)))
        assert not _look(y, sent(rng), period).there


def test_two_levels_of_one_phase_which_are_like_themselves_at_every_delay_are_not_there_in_noise():
    for seed in range(2):
        rng = np.random.default_rng(seed)
        sent = np.repeat(rng.choice([0.5, 1.0], COUNT // 4), 4).astype(complex)
        assert not _look(noise(rng, COUNT), sent, 0).there
        assert _look(sent + noise(rng, COUNT, 0.1), sent, 0).there


@pytest.mark.parametrize("snr_db", [0, -6, -12])
@pytest.mark.parametrize("wave", WAVES)
def test_what_was_sent_is_there_below_the_noise(wave, snr_db):
    """4096 samples of a signal 12 dB below the noise are 24 dB above that of its matched filter."""
    sent, _, period = WAVES[wave]
    for seed in range(2):
        rng = np.random.default_rng(seed)
        x = sent(rng)
        x /= np.sqrt(np.mean(np.abs(x) ** 2))
        carrier = rng.uniform(-0.1, 0.1)
        y = x * np.exp(2j * np.pi * carrier * np.arange(COUNT)) + noise(rng, COUNT, 10 ** (-snr_db / 20))
        found = _look(y, x, period)
        assert found.there
        assert found.carrier == pytest.approx(carrier, abs=1 / 16)


@pytest.mark.parametrize("carrier", [0.0, 0.002, 0.0005])
def test_packets_of_pulses_on_a_carrier_that_the_twin_knows_are_there_and_no_others_are(carrier):
    """What is on at the same times and carrier explains no more at the right places than at others."""
    count = 20_000
    turn = np.exp(2j * np.pi * carrier * np.arange(count))

    def packets(rng, on):
        bits = rng.integers(0, 2, count // 6 + 1)
        return np.where(on, np.repeat(np.stack([bits, 1 - bits], 1).ravel(), 3)[:count], 0) * turn

    for seed in range(2):
        rng = np.random.default_rng(seed)
        on = np.zeros(count, bool)
        on[np.add.outer(np.cumsum(rng.integers(2200, 5700, 5)) - 2100, np.arange(720)) % count] = True
        sent, other = packets(rng, on), packets(rng, on)
        right, wrong = (
            presence.look(y + noise(rng, count, 0.3), sent[None], np.ones(count), 0, tried=2 * count) for y in (sent, other)
        )
        assert right.nats > 3 * presence.PRESENT_NATS and not wrong.there


def test_a_waveform_that_is_all_but_a_carrier_keeps_it():
    tone = np.exp(2j * np.pi * 0.07 * np.arange(COUNT))[None]
    inside = np.ones(COUNT)
    inside[1000:1900] = 0.0
    kept = presence._without_envelopes(tone, inside)
    assert np.sum(np.abs(kept) ** 2) > 0.9 * COUNT


def test_where_nothing_is_sent_nothing_is_there():
    rng, count = np.random.default_rng(0), 20_000
    sent = np.where(np.arange(count) < 3000, noise(rng, count), 0.0)
    assert not presence.look(noise(rng, count), sent[None], np.ones(count), 0, tried=2 * count).there
    assert presence.look(sent + noise(rng, count), sent[None], np.ones(count), 0, tried=2 * count).there


@pytest.mark.parametrize("seed", range(2))
def test_a_diagnosis_of_noise_says_that_the_waveform_is_absent_and_claims_nothing(world, tmp_path, seed):
    world.rng = np.random.default_rng(seed)
    world.noise_rms = 0.1
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(0.0 * world.n)))).document
    assert document["verdict"] == "unexplained"
    (where,) = document["residual"]["where"]
    assert where["signal_absent"] is True and "not in this recording" in where["sentence"]
    assert where["record_next"] == "longer_recording"
    assert document["effects"] == []


def test_a_signal_20_db_below_the_noise_is_diagnosed_and_not_called_absent(world, tmp_path):
    world.noise_rms = 10 * np.sqrt(np.mean(np.abs(world.clean()) ** 2))
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(world.clean())))).document
    assert document["verdict"] == "no_mismatch"


def _bursts(rng, bursts=10):
    """Bursts of minimum-shift keying, each with its ramps, 148 bits at 4 samples, and a pause."""
    ramp = np.minimum(1, np.minimum(np.arange(592), np.arange(592)[::-1]) / 16)
    phase = np.cumsum(np.repeat(rng.choice([-1, 1], (bursts, 148)), 4, axis=1), axis=1) * np.pi / 8
    return np.pad(ramp * np.exp(1j * phase), ((0, 0), (0, 33))).ravel()


@pytest.mark.parametrize("first", [None, 12_000])
def test_a_strong_tone_holds_no_waveform_of_which_nothing_falls_into_the_recording(tmp_path, first):
    """Where it would explain a tone best no sample of it is recorded but the tails of its interpolation between samples."""
    rng, count = np.random.default_rng(2), 17_600
    sent = _bursts(rng)
    y = np.exp(2j * np.pi * rng.uniform(-0.4, 0.4) * np.arange(count)) + noise(rng, count, 0.05)
    if first is not None:  # what is recorded of it in part is there
        y = noise(rng, count, 0.05)
        y[first:] += 0.5 * sent[: count - first]
    folder = tmp_path / "case"
    folder.mkdir()
    case = sent_once(folder, y, sent)
    case.document["links"][0]["taps"].append({"delay_s": 9.26e-6, "gain_db": -5.7, "phase_rad": 1.5})
    (folder / "twin.yaml").write_text(yaml.safe_dump(case.document))
    case = read_case(folder)
    _, data, model = align.build(case, case.observations[0])
    assert presence.judge(data, model).there is (first is not None)


def test_a_long_recording_that_loses_samples_holds_what_it_holds_before_or_behind_them():
    """The stretch that is looked at first, for what is sent is loudest there, may lie behind the loss, at another delay."""
    rng, period, count = np.random.default_rng(1), 1760, 99_000
    wave = lambda: np.exp(1j * np.cumsum(np.repeat(rng.choice([-1, 1], period // 4), 4)) * np.pi / 8)  # noqa: E731
    own, other, louder = wave(), wave(), 1 + 1e-6 * np.arange(count)
    sent, behind, strange = (np.resize(np.roll(x, d), count) for x, d in ((own, 0), (own, 1021), (other, 0)))
    for first, there in ((sent, True), (strange, False)):
        y = np.where(np.arange(count) < 27_000, first, behind if there else strange) + noise(rng, count, 0.04)
        assert presence.look(y, louder * sent[None], np.ones(count), period, tried=period).there is there


def test_another_frame_of_the_same_kind_is_not_the_twins(tmp_path):
    rng = np.random.default_rng(5)
    y = np.concatenate([noise(rng, 300, 0.1), _ofdm(rng), noise(rng, 300, 0.1)])
    document = diagnose(sent_once(tmp_path, y, _ofdm(rng))).document
    assert document["verdict"] == "unexplained" and document["effects"] == []
    assert document["residual"]["where"][0]["signal_absent"] is True


def test_a_waveform_that_is_the_same_at_every_delay_is_not_called_absent():
    tone = np.exp(2j * np.pi * 0.1 * np.arange(COUNT))
    assert _look(tone + noise(np.random.default_rng(1), COUNT, 0.1), tone, 10).there


@pytest.mark.parametrize("wave", ["noise", "ofdm"])
def test_another_signal_of_the_same_amplitudes_is_not_there(wave):
    rng = np.random.default_rng(3)
    sent = WAVES[wave][0](rng)
    phases = np.exp(2j * np.pi * rng.uniform(size=COUNT))
    assert not _look(np.conj(sent), sent, 0).there
    assert not _look(np.abs(sent) * phases + noise(rng, COUNT, 0.1), sent, 0).there


@pytest.mark.parametrize("seed", range(8))
def test_a_short_frame_of_pulses_is_there_and_one_with_other_bits_is_not(seed):
    """112 bits by the place of a pulse, two samples each, as of a transponder, 10 dB above what is left of it."""
    rng = np.random.default_rng(seed)
    bits, others = rng.integers(0, 2, (2, 112))
    frame, other = (np.stack([b, 1 - b], 1).ravel() * (1 + 0j) for b in (bits, others))
    turn = np.exp(2j * np.pi * rng.uniform(-0.05, 0.05) * np.arange(224))
    left = noise(rng, 224, 0.5**0.5 / 10**0.5)
    assert _look(frame * turn + left, frame, 0).there
    assert not _look(other * turn + left, frame, 0).there


@pytest.mark.parametrize("seed", range(3))
def test_pulses_in_bursts_are_there_and_other_bits_in_the_same_bursts_are_not(seed):
    """Frames of 112 bits by the place of a soft pulse, two samples each, of several aircraft with silences between them."""
    rng = np.random.default_rng(seed)
    sizes, gaps = rng.uniform(0.6, 1.0, 24), rng.integers(150, 900, 24)

    def frames():
        bits = rng.integers(0, 2, (24, 112))
        pulses = np.repeat(np.stack([bits, 1 - bits], 2).reshape(24, 224), 2, axis=1) * sizes[:, None]
        x = np.concatenate([np.append(burst, np.zeros(gap)) for burst, gap in zip(pulses, gaps, strict=True)])
        return np.convolve(x, [0.15, 0.7, 0.15], "same") + 0j

    frame, other = frames(), frames()
    left = noise(rng, len(frame), 0.1)
    assert _look(frame + left, frame, 0).there
    assert not _look(other + left, frame, 0).there


def test_pulses_of_one_phase_are_there_by_their_places_and_those_of_another_beacon_are_not(tmp_path):
    """Pairs of alike pulses with chance between them, as for measuring distances: there are no phases to compare."""
    rng = np.random.default_rng(1)

    def pairs():
        at = np.cumsum(rng.integers(100, 400, 60))
        times = np.arange(at[-1] + 100)[:, None]
        return sum(np.exp(-(((times - at - later) / 5.0) ** 2) / 2).sum(1) for later in (0, 26))[:12000] + 0j

    sent, other = pairs(), pairs()
    rms = np.sqrt(np.mean(np.abs(sent) ** 2))
    left = noise(rng, 12000, 0.1 * rms)
    for heard, there in ((other, False), (sent, True)):
        _, data, model = align.build(case := sent_once(tmp_path, heard + left, sent), case.observations[0])
        assert presence.judge(data, model).there == there
    click = 1000 * (np.arange(12000) == np.argmax(np.abs(sent)))  # upon a pulse
    for heard, there in ((left, False), (click + left, False), (sent + noise(rng, 12000, rms), True)):
        assert presence.judge(replace(data, y=heard), model).there == there


@pytest.mark.parametrize(("once", "there"), [(True, True), (False, True), (False, False)])
def test_impulses_that_hold_all_of_the_energy_hide_no_waveform(tmp_path, world, once, there):
    """Beside a phase that wanders, a few samples 70 dB over the signal correlate with anything, at the delay that suits them."""
    sent = world.clean() if there else np.resize(0.3 * _ofdm(np.random.default_rng(6)), len(world.n))
    y = world.noisy(sent * np.exp(1j * np.cumsum(world.rng.normal(size=len(sent), scale=0.1))))[:8000]
    y[world.rng.integers(0, len(y), 30)] += noise(world.rng, 30, 1000.0)
    case = sent_once(tmp_path, y, world.path(0)[:8000]) if once else read_case(world.write(tmp_path / "case", y))
    _, data, model = align.build(case, case.observations[0])
    assert presence.judge(data, model).there == there


def test_of_two_that_may_be_there_the_one_that_explains_more_with_its_envelope_is_likelier():
    """A waveform that is mostly a carrier, distorted, and one whose rest is more like what came and whose carrier is not."""
    rng, inside = np.random.default_rng(1), np.ones(COUNT)
    came, own = (0.7 * noise(rng, COUNT) for _ in range(2))
    y = 1 + 0.5 * came + noise(rng, COUNT, 0.3)
    sent, other = (one[None] for one in (1 + 0.5 * came + 0.6 * own, 0.1 + came))
    assert presence.likelier([(y, sent, inside), (y, other, inside)], 0, COUNT) == 0
    assert presence.likelier([(y, own[None], inside), (y, sent, inside)], 0, COUNT) == 1  # what is not there is no rival
