# SPDX-License-Identifier: GPL-3.0-or-later
"""A corrected twin as a scenario, and a case from recordings: what one world believes the other plays."""

import json

import cast_case
import numpy as np
import pytest
import yaml
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.emulation.reference import emulate, scenario_updates
from gr_cast.scenario import LinkTaps, Scenario
from gr_cast.signals import codes, recording
from gr_cast.twin import make, to_scenario
from gr_cast.twin.document import read_twin
from gr_cast.twin.playback import Conditions, Playback

RATE = 10e6
CODE = {"code": "glfsr", "degree": 7, "samples_per_chip": 1}


def effect(family, level="link", name="a>b", **parameters):
    told = {key: {"value": value, "std": 0.0} for key, value in parameters.items()}
    return {"family": family, "owner": {"level": level, "name": name}, "parameters": told}


def twin_of(folder, taps, *effects):
    document = {
        "cast_twin": 1, "sample_rate_hz": RATE, "center_frequency_hz": 1e9, "waveforms": {"w": CODE},
        "nodes": {"a": {"transmit": "w"}, "b": {}}, "links": [{"tx": "a", "rx": "b", "taps": taps}],
        "recordings": [{"file": "r", "receiver": "b", "transmitters": ["a"]}], "effects": list(effects),
    }  # fmt: skip
    (folder / "twin.yaml").write_text(yaml.safe_dump(document))
    return read_twin(folder / "twin.yaml")


def onto():
    taps = LinkTaps(delay_s=[[0.0, 4e-7, 9e-7]], gain=[[1.0, 0.3j, -0.2]])
    return Scenario(name="place", nodes=("a", "b"), links={("a", "b"): taps, ("b", "a"): taps}, base_loss_db=40.0)


TAPS = [
    {"delay_s": 0.0, "gain_db": -40.0},
    {"delay_s": 4e-7, "gain_db": float(20 * np.log10(0.3) - 40), "phase_rad": np.pi / 2},
    {"delay_s": 9e-7, "gain_db": float(20 * np.log10(0.2) - 40), "phase_rad": np.pi},
]


def test_a_scenario_plays_what_its_corrected_twin_plays(tmp_path):
    """The twin's own playback, interpolated in the frequency domain, beside the emulator's law on the scenario's taps."""
    twin = twin_of(
        tmp_path, TAPS,
        effect("extra_path", delay_s=1.2e-6, gain_db=-50.0, phase_rad=0.7, doppler_hz=0.0),
        effect("missing_path", delay_s=9e-7),
        effect("tap_gain_error", delay_s=0.0, error_db=-2.0, error_rad=0.4),
        effect("tap_delay_error", delay_s=4e-7, error_s=1e-7),
    )  # fmt: skip
    made = to_scenario.corrected(twin, onto())
    n = 127 * 8
    wanted = Playback(twin, twin.observations[0], n, Conditions(noise_power_db=-np.inf)).samples()
    sent = np.tile(codes.from_spec(CODE), 9)
    played = emulate(np.stack([sent, 0 * sent]), scenario_updates(made.scenario, RATE), 2)[1][127:]
    assert np.sum(np.abs(played - wanted) ** 2) / np.sum(np.abs(wanted) ** 2) < 1e-6
    assert made.left_out == () and made.changed == (("a", "b"),)


def test_the_way_back_of_one_channel_is_corrected_too(tmp_path):
    made = to_scenario.corrected(twin_of(tmp_path, TAPS, effect("missing_path", delay_s=9e-7)), onto())
    assert made.scenario.links["b", "a"] == made.scenario.links["a", "b"]
    assert made.scenario.links["a", "b"].gain.shape == (1, 2)


def test_a_doppler_within_its_error_turns_nothing(tmp_path):
    echo = effect("extra_path", delay_s=1.2e-6, gain_db=-50.0, phase_rad=0.7, doppler_hz=1.0)
    echo["parameters"]["doppler_hz"]["std"] = 0.5
    assert to_scenario.corrected(twin_of(tmp_path, TAPS, echo), onto()).scenario.is_static


def test_a_sure_doppler_turns_the_echo_once_a_period(tmp_path):
    echo = effect("extra_path", delay_s=1.2e-6, gain_db=-50.0, phase_rad=0.7, doppler_hz=5.0)
    made = to_scenario.corrected(twin_of(tmp_path, TAPS, echo), onto()).scenario
    _, gain = sc.taps_at(made, ("a", "b"), np.array([0.0, 0.05, 0.1, 0.2]))
    assert np.angle(gain[:, 3]) == pytest.approx([0.7, 0.7 + np.pi / 2, 0.7 + np.pi - 2 * np.pi, 0.7])


def test_what_is_a_radios_stays_with_the_twin_and_is_named(tmp_path):
    offset = effect("carrier_frequency_offset", "rx", "b", offset_hz=100.0)
    made = to_scenario.corrected(twin_of(tmp_path, TAPS, offset), onto())
    assert made.left_out == ("carrier_frequency_offset (b)",) and made.changed == ()


def test_another_scenario_than_the_twins_is_refused(tmp_path):
    other = Scenario(name="other", nodes=("a", "b"), links={("a", "b"): LinkTaps(delay_s=[[0.0]], gain=[[1.0]])})
    with pytest.raises(CastError, match="no tap at 4e-07 s, where the twin has one"):
        to_scenario.corrected(twin_of(tmp_path, TAPS, effect("missing_path", delay_s=4e-7)), other)


def recorded(folder, name="r", **fields):
    samples = np.tile(codes.from_spec(CODE), 20).astype(np.complex64)
    return recording.write(folder / name, samples, sample_rate_hz=RATE, center_frequency_hz=1e9, fields=fields)


KNOWN = {"cast:transmitter": "a", "cast:receiver": "b", "cast:waveform": CODE}


def test_recordings_that_say_all_need_no_argument(tmp_path, monkeypatch):
    sc.save(tmp_path / "place.yaml", onto())
    recorded(tmp_path, **KNOWN, **{"cast:scenario": str(tmp_path / "place.yaml")})
    cast_case.main(["make", str(tmp_path / "r"), "--output", str(tmp_path / "case")])
    (link,) = read_twin(tmp_path / "case/twin.yaml").links.values()
    assert [tap.delay_s for tap in link.taps] == [0.0, 4e-7, 9e-7]
    assert [tap.amplitude for tap in link.taps] == pytest.approx([1e-2, 3e-3j, -2e-3])


def test_a_recording_that_says_nothing_is_told_what_to_type(tmp_path):
    recorded(tmp_path)
    with pytest.raises(CastError) as refused:
        make.heard(tmp_path / "r")
    assert "add --link TX>RX" in str(refused.value)
    with pytest.raises(CastError, match="add --code"):
        make.heard(tmp_path / "r", link=("a", "b"))
    assert make.heard(tmp_path / "r", link=("a", "b"), waveform=CODE).links == [("a", "b")]


def test_a_moving_link_is_a_tap_with_its_doppler():
    clock = np.arange(0, 1.001, 1e-3)
    gain = np.stack([np.exp(2j * np.pi * 20 * clock), 0.5 * np.exp(1j - 2j * np.pi * 7 * clock)], axis=1)
    moving = LinkTaps(delay_s=np.broadcast_to([0.0, 1e-6], gain.shape), gain=gain)
    scenario = Scenario(name="moving", nodes=("a", "b"), links={("a", "b"): moving}, time_s=clock)
    taps, lost_db = make.believed_of(scenario, ("a", "b"), 0.25, 0.05)
    assert [tap["doppler_hz"] for tap in taps] == pytest.approx([20.0, -7.0], abs=1e-6)
    assert [tap["phase_rad"] for tap in taps] == pytest.approx([0.0, 1 - 2 * np.pi * 1.75 + 2 * np.pi * 2], abs=1e-6)
    assert lost_db < -100


def test_a_sounding_is_believed_as_well_as_a_scenario(tmp_path):
    recorded(tmp_path, **KNOWN)
    taps = [{"delay_s": 3e-6, "gain_db": -3.0, "phase_rad": 0.1}, {"delay_s": 4e-6, "gain_db": -9.0, "phase_rad": 0.2}]
    (tmp_path / "s").mkdir()
    (tmp_path / "s/result.json").write_text(json.dumps({"cast_sounding": 1, "taps": taps, "noise_floor_db": -50.0}))
    cast_case.main(["make", str(tmp_path / "r"), "--sounding", str(tmp_path / "s"), "--output", str(tmp_path / "case")])
    twin = read_twin(tmp_path / "case/twin.yaml")
    assert [tap.delay_s for tap in twin.links["a", "b"].taps] == pytest.approx([0.0, 1e-6])
    assert twin.noise_db == {"b": -50.0}


@pytest.mark.parametrize("key", ["cast:tx_amplitude", "cast:scenario_at_s"])
@pytest.mark.parametrize("value", ["x", None, [1]])
def test_what_a_recording_says_of_itself_is_a_number_or_a_fault(tmp_path, key, value):
    about = {"cast:receiver": "b", "cast:waveforms": {"a": CODE}, key: value}
    recording.write(tmp_path / "r", np.ones(300, complex), sample_rate_hz=RATE)
    meta = json.loads((tmp_path / "r.sigmf-meta").read_text())
    meta["global"] |= about
    (tmp_path / "r.sigmf-meta").write_text(json.dumps(meta))
    with pytest.raises(CastError, match=f"{key}: got .*, needs a finite number"):
        make.heard(tmp_path / "r", link=("a", "b"), waveform=CODE)
