# SPDX-License-Identifier: GPL-3.0-or-later
"""Results of soundings become a campaign of a place case."""

import json

import numpy as np
import pytest
from gr_cast.core import arrays
from gr_cast.core.errors import CastError
from gr_cast.signals.recording import Recording
from gr_cast.signals.waveform import waveform_from_text
from gr_cast.sounding import collect
from gr_cast.sounding.result import about_recording, as_document
from gr_cast.sounding.sound import SoundingOptions, sound

RATE_HZ = 100e6
PATHS = {("a", "b"): ([3, 10, 31], [0.01, 0.004j, -0.002]), ("b", "c"): ([7, 9], [0.02j, 0.005])}


def entry(**changes):
    tap = dict(delay_s=1e-7, gain_db=-40.0, phase_rad=0.3, delay_std_s=1e-11, gain_std_db=0.01, phase_std_rad=1e-3)
    return {
        "cast_sounding": 1, "transmitter": "a", "receiver": "b", "begins_s": 1.5, "band_hz": 8e7, "set_up_db": 0.0,
        "smallest_detectable_gain_db": -80.0, "taps": [tap],
    } | changes  # fmt: skip


def written(folder, document):
    folder.mkdir(exist_ok=True)
    (folder / "result.json").write_text(json.dumps(document))
    return folder


def sounded(link, seed, noise_db=-90.0):
    """A GLFSR over paths on whole samples, in noise: result.json's content."""
    waveform, rng = waveform_from_text("glfsr:9"), np.random.default_rng(seed)
    sent = np.tile(waveform.samples, 20)
    heard = sum(g * np.roll(sent, d) for d, g in zip(*PATHS[link], strict=True))
    heard = heard + 10 ** (noise_db / 20) * (rng.standard_normal((2, len(sent))) / np.sqrt(2) * [[1], [1j]]).sum(axis=0)
    file = Recording(
        samples=heard.astype(np.complex64),
        sample_rate_hz=RATE_HZ,
        metadata={"cast:transmitter": link[0], "cast:receiver": link[1]},
    )
    options = SoundingOptions(correct_offset=False, carrier_offset_hz=0.0)
    return as_document(sound(file, waveform, options), about_recording(file, "x", {"samples_per_chip": 1}, options))


def true_response(link, frequency_hz):
    return sum(g * np.exp(-2j * np.pi * frequency_hz * d / RATE_HZ) for d, g in zip(*PATHS[link], strict=True))


def test_responses_are_those_of_the_paths_within_the_noise_that_is_stated(tmp_path):
    ratios = []
    for seed in range(12):
        ones = [collect.read(written(tmp_path / "x", sounded(link, 100 * seed + k))) for k, link in enumerate(PATHS)]
        frequency_hz = collect.frequencies_hz(ones)
        made = collect.campaign(ones, frequency_hz)
        assert list(zip(made["tx"], made["rx"], strict=True)) == list(PATHS) and made["response"].shape == (2, 1, 64)
        for row, link in enumerate(PATHS):
            error = made["response"][row, 0] - true_response(link, frequency_hz)
            ratios.append(np.mean(np.abs(error) ** 2) / made["noise_power"][row])
    assert 0.6 < np.mean(ratios) < 1.6, ratios


def test_frequencies_fill_the_band_in_equal_steps_round_the_carrier(tmp_path):
    one = collect.read(written(tmp_path / "x", entry()))
    frequency_hz = collect.frequencies_hz([one], 40)
    np.testing.assert_allclose(np.diff(frequency_hz), 8e7 / 40)
    assert frequency_hz.mean() == pytest.approx(0, abs=1e-6) and np.ptp(frequency_hz) < 8e7
    assert np.ptp(collect.frequencies_hz([one], 40, 1e7)) < 1e7
    for wrong in (dict(band_hz=9e7), dict(count=1)):
        with pytest.raises(CastError):
            collect.frequencies_hz([one], **wrong)


def test_what_a_set_up_adds_is_taken_off_and_what_was_not_heard_is_missing(tmp_path):
    # 40 dB below what was sent as received, of which the set-up gave 15 dB
    ones = [collect.read(written(tmp_path / "x", document)) for document in (entry(set_up_db=15.0), entry(begins_s=2.0, taps=[]))]
    made = collect.campaign(ones, np.zeros(1))
    assert made["time_s"].tolist() == [1.5, 2.0] and np.isnan(made["response"][0, 1]).all()
    assert made["response"][0, 0, 0] == pytest.approx(10 ** (-55 / 20) * np.exp(0.3j), rel=1e-6)


def test_a_file_is_read_back_as_a_campaign(tmp_path):
    one = collect.read(written(tmp_path / "x", entry()))
    collect.write(tmp_path / "monday.npz", collect.campaign([one], collect.frequencies_hz([one])))
    assert {*arrays.read(tmp_path / "monday.npz")} == {"tx", "rx", "time_s", "frequency_hz", "response", "noise_power"}


@pytest.mark.parametrize(
    "changes, says",
    [
        (dict(transmitter=None), "transmitter: is not said"),
        (dict(cast_sounding=2), "cast_sounding: got 2, needs 1"),
        (dict(band_hz=None), "band_hz: got null, needs a finite number of Hz"),
        (dict(taps=[{"delay_s": 1}]), "taps[0].gain_db: got null"),
        (dict(set_up_db="much"), "set_up_db: got 'much', needs a finite number of dB"),
    ],
)
def test_what_is_no_result_is_refused_with_its_place(tmp_path, changes, says):
    with pytest.raises(CastError) as error:
        collect.read(written(tmp_path / "x", entry(**changes)))
    assert any(says in fault for fault in error.value.faults)


def test_two_results_of_one_link_and_time_are_refused(tmp_path):
    one = collect.read(written(tmp_path / "x", entry()))
    with pytest.raises(CastError, match="a>b: two soundings at 1.5 s: one file holds one of each time"):
        collect.campaign([one, one], np.zeros(2))


def test_a_link_that_was_never_heard_is_nothing_within_what_would_have_been(tmp_path):
    documents = (entry(taps=[], set_up_db=5.0), entry(taps=[], set_up_db=5.0, begins_s=2.0), entry(receiver="c", begins_s=9.0))
    made = collect.campaign([collect.read(written(tmp_path / "x", one)) for one in documents], np.zeros(2))
    assert (made["response"][0, :2] == 0).all() and np.isnan(made["response"][0, 2]).all()
    assert made["noise_power"][0] == pytest.approx(10**-8.5)


def test_the_variance_of_an_entry_is_that_of_taps_that_err_as_stated():
    """Taps drawn anew with their deviations of delay, gain and phase: mean |ΔH|² over the band."""
    rng = np.random.default_rng(2)
    taps = {"delay_s": np.array([1e-7, 3e-7]), "gain": np.array([0.1, 0.05j])}
    deviations = {"delay_std_s": np.array([2e-10, 1e-9]), "gain_std": np.array([0.02, 0.05])}
    one = collect.Snapshot(transmitter="a", receiver="b", time_s=0.0, band_hz=8e7, unheard_power=0.0, **taps, **deviations)
    frequency_hz = collect.frequencies_hz([one])
    clean, variance = collect.response(one, frequency_hz)
    errors = []
    for _ in range(4000):
        late = taps["delay_s"] + deviations["delay_std_s"] * rng.standard_normal(2)
        wrong = deviations["gain_std"] / np.sqrt(2) * (rng.standard_normal(2) + 1j * rng.standard_normal(2))
        heard = np.exp(-2j * np.pi * np.outer(frequency_hz, late)) @ (taps["gain"] * (1 + wrong))
        errors.append(np.mean(np.abs(heard - clean) ** 2))
    assert variance == pytest.approx(np.mean(errors), rel=0.05)
    sure = collect.Snapshot(transmitter="a", receiver="b", time_s=0.0, band_hz=8e7, unheard_power=0.0, **taps,
                            delay_std_s=np.zeros(2), gain_std=np.zeros(2))  # fmt: skip
    assert collect.response(sure, frequency_hz)[1] == pytest.approx(1e-12 * 0.0125)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (dict(set_up_db=400.1), "set_up_db"), (dict(set_up_db=-400.1), "set_up_db"), (dict(band_hz=0.9), "band_hz"),
        (dict(band_hz=1.1e10), "band_hz"), (dict(smallest_detectable_gain_db=400.1), "smallest_detectable_gain_db"),
        (dict(smallest_detectable_gain_db=-400.1), "smallest_detectable_gain_db"), (dict(begins_s="x"), "begins_s"),
        (dict(receiver=3.5), "receiver"), (dict(taps=4), "taps"), (dict(taps=[4]), r"taps\[0\]"),
        (dict(set_up_db=400, band_hz=1e10, smallest_detectable_gain_db=-400), None),
        (dict(set_up_db=-400, band_hz=1.0, smallest_detectable_gain_db=400), None),
    ],
)  # fmt: skip
def test_numbers_of_a_result_have_limits(changes, says):
    if says is None:
        assert collect.of_document(entry(**changes), "here").band_hz == changes["band_hz"]
    else:
        with pytest.raises(CastError, match=f"here: {says}"):
            collect.of_document(entry(**changes), "here")


def test_what_a_result_says_becomes_linear_numbers():
    one = collect.of_document(entry(set_up_db=10.0, begins_s=2.5), "here")
    assert (one.transmitter, one.receiver, one.time_s, one.band_hz) == ("a", "b", 2.5, 8e7)
    assert one.gain[0] == pytest.approx(10**-2.5 * np.exp(0.3j)) and one.unheard_power == pytest.approx(1e-9)
    assert one.gain_std[0] == pytest.approx(np.hypot(0.01 * np.log(10) / 20, 1e-3))
    assert (one.delay_s[0], one.delay_std_s[0]) == (1e-7, 1e-11)
    none = entry()
    del none["begins_s"]
    assert collect.of_document(none, "here").time_s == 0


@pytest.mark.parametrize(("count", "fits"), [(1, False), (2, True), (65536, True), (65537, False)])
def test_there_are_2_to_65536_frequencies_over_the_narrowest_band(count, fits):
    wide, narrow = (collect.of_document(entry(band_hz=band_hz), "here") for band_hz in (8e7, 2e7))
    if fits:
        frequency_hz = collect.frequencies_hz([wide, narrow], count)
        assert len(frequency_hz) == count and frequency_hz[-1] - frequency_hz[0] == pytest.approx(2e7 * (1 - 1 / count))
        assert collect.frequencies_hz([wide, narrow], count, 2e7)[0] == frequency_hz[0]
    else:
        with pytest.raises(CastError, match=f"frequencies: got {count}, limit 2 to 65536"):
            collect.frequencies_hz([wide], count)
    for wrong_hz in (0.0, -1.0, 2.01e7):
        with pytest.raises(CastError, match="the soundings have 2e.07 Hz"):
            collect.frequencies_hz([wide, narrow], 64, wrong_hz)


def test_the_noise_of_a_link_is_the_mean_over_its_times():
    (tap,) = entry()["taps"]
    stds_db = {2.0: 0.1, 1.0: 0.3}
    ones = [collect.of_document(entry(begins_s=t, taps=[tap | {"gain_std_db": std}]), "here") for t, std in stds_db.items()]
    frequency_hz = np.zeros(2)
    made = collect.campaign(ones, frequency_hz)
    assert made["time_s"].tolist() == [1.0, 2.0]
    assert made["noise_power"][0] == pytest.approx(np.mean([collect.response(one, frequency_hz)[1] for one in ones]))
