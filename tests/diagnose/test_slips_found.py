# SPDX-License-Identifier: GPL-3.0-or-later
"""Where a delay moves: losses of whole periods under a carrier, signals that are silent or filtered, a clock in steps."""

import json

import numpy as np
import pytest
import yaml
from conftest_world import RATE_HZ, World, sent_once
from gr_cast.diagnose import align, diagnose, read_case, search
from gr_cast.diagnose.view import View
from gr_cast.signals import recording
from gr_cast.twin.effects import FAMILIES
from gr_cast.twin.effects.base import start

OFFSET_HZ = 700.0  # turns by a third of a cycle in a period of 510 samples


def _everywhere(lost):
    return start(FAMILIES["sample_loss"], [-np.inf, lost], free=[False, False])


def _fitted(world, folder, y):
    case = read_case(world.write(folder, world.noisy(y)))
    _, data, model = align.build(case, case.observations[0])
    return search.refit(data, model)


def _known_carrier(world):
    twin, owner = world.twin(), {"level": "rx", "name": "rx1"}
    told = {"offset_hz": {"value": OFFSET_HZ, "std": 0.0}, "drift_hz_per_s": {"value": 0.0, "std": 0.0}}
    return twin | {"effects": [{"family": "carrier_frequency_offset", "owner": owner, "parameters": told}]}


@pytest.mark.parametrize("periods", [-1, 1, 2])
def test_a_loss_is_as_many_periods_of_the_waveform_as_the_oscillator_went_on(world, tmp_path, periods):
    """The delay tells a loss within a period alone; the carrier's phase tells the rest, and a wrong count explains nothing."""
    twin, lost = _known_carrier(world), 100 + periods * len(world.x)
    world.twin = lambda: twin
    at = world.n + lost * (world.n >= 15_000)
    turned = np.exp(2j * np.pi * OFFSET_HZ * at / RATE_HZ)
    world.n = at
    y = world.clean() * turned
    document = diagnose(read_case(world.write(tmp_path / "case", world.noisy(y)))).document
    (effect,) = document["effects"]
    assert document["verdict"] == "identified" and effect["family"] == "sample_loss"
    assert effect["parameters"]["samples"]["value"] == lost


@pytest.mark.parametrize("periods", [1, 2, 6])
def test_samples_that_are_lost_count_modulo_the_period_of_what_a_file_holds_several_of(world, tmp_path, periods):
    world.n = world.n + 3 * (world.n >= 9000)
    twin = world.twin() | {"waveforms": {"w1": {"file": "sent"}}}
    world.twin = lambda: twin
    folder = world.write(tmp_path / "case", world.noisy(world.clean()))
    recording.write(folder / "sent", np.tile(world.x, periods), sample_rate_hz=RATE_HZ)
    case = read_case(folder)
    assert len(case.waveforms["w1"].samples) == len(world.x)
    (effect,) = diagnose(case).document["effects"]
    assert effect["family"] == "sample_loss" and effect["parameters"]["samples"]["value"] == 3


@pytest.mark.parametrize(("first", "count"), [(150, 163), (9000, 40), (15_000, 900)])
@pytest.mark.parametrize("datatype", ["cf32_le", "ci16_le"])
def test_zeros_that_a_receiver_wrote_are_inserted_samples_and_nothing_else(world, tmp_path, first, count, datatype):
    """As many as they are, more than the waveform's period too, and the corrected twin has them; noise has none."""
    y = world.noisy(world.clean())
    y = np.concatenate([y[:first], np.zeros(count), y[first:]])[: len(y)]
    found = diagnose(read_case(world.write(tmp_path / "case", y, datatype=datatype)), budget_s=3000)
    (effect,) = found.document["effects"]
    assert found.document["verdict"] == "identified" and effect["family"] == "sample_loss"
    assert effect["parameters"]["samples"]["value"] == -count and effect["parameters"]["zeros"] is True
    assert effect["parameters"]["time_s"]["value"] == pytest.approx(first / RATE_HZ, abs=0.5 / RATE_HZ)
    twin = world.twin() | {"effects": json.loads(json.dumps(found.document["effects"]))}
    world.twin = lambda: twin
    assert diagnose(read_case(world.write(tmp_path / "again", y))).document["verdict"] == "no_mismatch"


def test_zeros_in_the_place_of_samples_of_which_none_are_lost_are_left_and_placed(world, tmp_path):
    y = world.noisy(world.clean())
    y[9000:9100] = 0
    document = diagnose(read_case(world.write(tmp_path / "case", y)), budget_s=3000).document
    (left,) = document["residual"]["where"]
    assert document["verdict"] == "unexplained" and document["effects"] == []
    assert left["test"] == "zeros in the place of samples"
    assert left["time_s"] == pytest.approx([9000 / RATE_HZ, 9099 / RATE_HZ])


def test_no_loss_is_looked_for_where_a_filter_bends_a_loud_signal(tmp_path):
    """A few samples at an end look more like another part of the waveform than like the bare one; the fit knows the filter."""
    world = World()
    world.noise_rms, world.code["samples_per_chip"] = 1e-4, 12
    world.x = np.repeat(world.x[::2], 12)
    y = np.convolve(world.clean(), [1.0, 0.3, -0.1])[: len(world.n)]
    fit = _fitted(world, tmp_path / "case", y)
    taps = start(FAMILIES["front_end_filter"], np.zeros(8), aux={"low": 0, "high": 4, "side": "rx"})
    fit = search.refit(fit.data, fit.model.adding(taps), near=fit)
    assert View(fit).jumps(_everywhere) == [] and View(fit).steps_of_lag()[1] == []


def test_a_silence_of_the_signal_is_at_no_other_delay(tmp_path):
    """What noise correlates with a loud part of the waveform is compared with the energy of that part, not of the silence."""
    world = World()
    world.noise_rms = 0.1
    world.x = world.x * (np.arange(-250, 260) % 510 < 120)  # silent where the recording begins
    recording.write(tmp_path / "sent", world.x, sample_rate_hz=RATE_HZ)
    twin = world.twin() | {"waveforms": {"w1": {"file": "sent", "repeat": True}}}
    folder = world.write(tmp_path / "case", world.noisy(world.clean()))
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    for part in tmp_path.glob("sent.*"):
        part.rename(folder / part.name)
    case = read_case(folder)
    _, data, model = align.build(case, case.observations[0])
    assert View(search.refit(data, model)).jumps(_everywhere) == []


def test_a_fast_clock_is_one_though_each_of_its_steps_looks_like_a_loss(world, tmp_path):
    """Under an offset as strong as the signal the first score of a clock says little, and losses, one by one, explain much."""
    ppm = 320.0
    at = world.n * (1 + ppm * 1e-6)
    spectrum, f = np.fft.fft(world.x), np.fft.fftfreq(len(world.x))
    band = np.abs(f) < 0.3
    wave = sum(c * np.exp(2j * np.pi * g * (at - 37)) for c, g in zip(spectrum[band] / len(world.x), f[band], strict=True))
    echo = sum(c * np.exp(2j * np.pi * g * (at - 46)) for c, g in zip(spectrum[band] / len(world.x), f[band], strict=True))
    recording.write(tmp_path / "sent", np.fft.ifft(spectrum * band), sample_rate_hz=RATE_HZ)
    y = 0.3 * (wave + 0.5 * np.exp(0.7j) * echo) + 0.35 * np.exp(-world.n / 8000)
    world.noise_rms = 0.1
    folder = world.write(tmp_path / "case", world.noisy(y))
    (folder / "twin.yaml").write_text(yaml.safe_dump(world.twin() | {"waveforms": {"w1": {"file": "sent", "repeat": True}}}))
    for part in tmp_path.glob("sent.*"):
        part.rename(folder / part.name)
    document = diagnose(read_case(folder), budget_s=100).document
    found = {e["family"]: e["parameters"] for e in document["effects"]}
    assert set(found) == {"sample_clock_offset", "dc_offset"}
    assert found["sample_clock_offset"]["offset_ppm"]["value"] == pytest.approx(ppm, abs=1.0)


def test_a_loss_stands_out_beside_a_louder_tone_that_is_known(world, tmp_path):
    """What the fit explains of the tone says nothing of where the waveform is."""
    lost = np.where(world.n < 12_000, world.clean(), np.roll(world.clean(), -30))
    tone = np.exp(2j * np.pi * 0.1234 * world.n)
    fit = _fitted(world, tmp_path / "case", lost + tone)
    cycles = round(0.1234 * len(world.n))
    fit = search.refit(fit.data, fit.model.adding(start(FAMILIES["tone_interference"], [0.0, 0.0, cycles])), near=fit)
    assert any(abs(at - 12_000) <= 16 and samples == 30 for at, samples, _ in View(fit).jumps(_everywhere))
    assert [round(samples) for _, samples in View(fit).steps_of_lag()[1]] == [30]


def test_a_sample_that_comes_twice_is_found_though_many_paths_are_as_loud(tmp_path):
    """A waveform that is sent once: where it is later is asked of the whole link, of which one path is a sixth."""
    rng, count = np.random.default_rng(3), 12_000
    sent = np.convolve(rng.normal(size=count) + 1j * rng.normal(size=count), np.hanning(11), "same")
    taps = [(9 * k, np.exp(2j * np.pi * rng.uniform())) for k in range(6)]
    link = sum(gain * np.concatenate([np.zeros(late), sent[: count - late]]) for late, gain in taps)
    heard = np.insert(link, 7000, link[7000])[:count]
    noisy = heard + 0.1 * (rng.normal(size=count) + 1j * rng.normal(size=count))
    sent_once(tmp_path, noisy, sent)
    twin = yaml.safe_load((tmp_path / "twin.yaml").read_text())
    twin["links"][0]["taps"] = [{"delay_s": late / RATE_HZ, "phase_rad": float(np.angle(gain))} for late, gain in taps]
    (tmp_path / "twin.yaml").write_text(yaml.safe_dump(twin))
    document = diagnose(read_case(tmp_path), budget_s=60).document
    (effect,) = document["effects"]
    assert document["verdict"] == "identified" and effect["family"] == "sample_loss"
    assert effect["parameters"]["samples"]["value"] == -1
    assert abs(effect["parameters"]["time_s"]["value"] - 7000 / RATE_HZ) < 4 / RATE_HZ
