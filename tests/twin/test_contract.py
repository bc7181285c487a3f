# SPDX-License-Identifier: GPL-3.0-or-later
"""A twin is checked by the contract before anything is played or diagnosed: all faults at once, each with its place."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from gr_cast.core.errors import CastError
from gr_cast.twin.document import read_twin
from gr_cast.twin.effects import FAMILIES, NAMED
from gr_cast.twin.playback import Conditions, Playback

APPS = Path(__file__).resolve().parents[2] / "apps"
OWNER = {
    "tx": {"level": "tx", "name": "tx1"},
    "rx": {"level": "rx", "name": "rx1"},
    "link": {"level": "link", "name": "tx1>rx1"},
    "environment": {"level": "environment", "name": "environment"},
}
TELLING = {  # of families that tell one of several, or whose forward model is in `model`
    "carrier_frequency_offset": ({"offset_hz": 100.0}, {}),
    "iq_imbalance": ({"gain_imbalance_db": 0.3}, {}),
    "front_end_filter": ({"ripple_db": 1.0}, {"low": -1, "taps": [0.1, 0.0, 0.0, 0.1]}),
    "diffuse_tail": ({"decay_s": 1e-5}, {"taps": [0.01, 0.0, 0.0, 0.01]}),
    "pa_nonlinearity": ({"compression_db": 1.0, "memory": False}, {}),
    "phase_noise": ({"rms_rad": 0.05}, {"law": "held", "corner_hz": 3e3}),
    "tap_gain_error": ({"delay_s": 0.0, "error_db": 1.0}, {}),
    "second_transmitter": ({"code": "w2", "delay_s": 0.0, "gain_db": -20.0}, {}),
    "sample_loss": ({"time_s": 1e-3, "samples": 40}, {}),
    "pulsed_interference": ({"period_s": 1e-4, "duty_cycle": 0.3, "power_dbc": -20.0}, {}),
    "missing_path": ({"delay_s": 7e-6}, {}),
}
CODE = {"code": "glfsr", "degree": 8, "mask": 0, "seed": 1, "samples_per_chip": 2}


def entry(family: str, **change) -> dict:
    declared = FAMILIES[family]
    parameters, model = TELLING.get(family, ({name: 1.0 for name, value in declared.parameters.items() if value.needed}, {}))
    return {"family": family, "owner": OWNER[declared.level], "parameters": parameters, "model": model} | change


def written(folder: Path, effects=(), **change) -> Path:
    taps = [{"delay_s": 0.0}, {"delay_s": 7e-6, "gain_db": -6.0}]
    document = {
        "cast_twin": 1,
        "sample_rate_hz": 1e6,
        "center_frequency_hz": 1e9,
        "waveforms": {"w1": CODE, "w2": CODE | {"seed": 3, "degree": 9}},
        "nodes": {"tx1": {"transmit": "w1"}, "rx1": {}},
        "links": [{"tx": "tx1", "rx": "rx1", "taps": taps}],
        "recordings": [{"file": "recording", "receiver": "rx1", "transmitters": ["tx1"]}],
        "noise": {"rx1": {"power_db": -40.0}},
        "effects": list(effects),
    } | change
    path = folder / "twin.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


def faults(path) -> list[str]:
    with pytest.raises(CastError) as error:
        read_twin(path)
    return [line.removeprefix(f"{path}: ") for line in error.value.faults]


@pytest.mark.parametrize("family", NAMED)
def test_what_a_family_writes_of_an_effect_is_what_its_entry_may_hold(tmp_path, family):
    case = read_twin(written(tmp_path, [entry(family)]))
    playback = Playback(case, case.observations[0], 2000, Conditions(seed=1))
    (effect,) = playback.model.effects
    told, scene = FAMILIES[family], playback.scene
    scene.count = scene.span
    assert {*told.constants(scene, effect)} <= {*told.parameters}
    assert {*told.model(scene, effect)} <= {*told.remembered}
    values = {*told.values(scene, effect, effect.p)} if family != "front_end_filter" else {"ripple_db"}
    assert values <= {*told.parameters}


@pytest.mark.parametrize("family", [name for name in NAMED if FAMILIES[name].parameters])
def test_a_name_that_no_parameter_has_an_empty_list_and_nan_are_refused(tmp_path, family):
    parameters = entry(family)["parameters"]
    name = next(name for name, value in parameters.items() if isinstance(value, float))
    bent = {k: v for k, v in parameters.items() if k != name} | {name.rpartition("_")[0] or "x": 1.0}
    lines = faults(written(tmp_path, [entry(family, parameters=bent)]))
    assert any("effects[0].parameters: unknown key" in line for line in lines), lines
    assert any(line.startswith("effects[0].parameters: is empty, needs some of") for line in
               faults(written(tmp_path, [entry(family, parameters={})])))  # fmt: skip
    for wrong in (float("nan"), float("inf"), True, "1.0", None, [1.0]):
        for form in (wrong, {"value": wrong, "std": 0.0}, {"per_recording": {"recording": {"value": wrong, "std": 0.0}}}):
            lines = faults(written(tmp_path, [entry(family, parameters=parameters | {name: form})]))
            assert any(f"effects[0].parameters.{name}" in line and "got" in line for line in lines), (form, lines)


def test_all_faults_of_all_entries_come_at_once_with_their_place(tmp_path):
    effects = [
        entry("carrier_frequency_offset", parameters={"offset": {"value": 100.0, "std": 1.0}}),
        entry("dc_offset", owner={"level": "receiver", "name": "rx1"}),
        entry("dc_offset", owner={"level": "rx", "name": "rx9"}, parameters={"level_dbc": {"value": -30.0, "std": -1.0}}),
        entry("dc_offset", owner=OWNER["link"]),
        entry("extra_path", parameters={"delay_s": 100.0, "gain_db": 5000.0}),
        entry("front_end_filter", model={"taps": [0.1, float("nan")], "lowest": 1}),
        entry("dc_offset") | {"family": "magic"},
    ]  # fmt: skip
    text = "\n".join(faults(written(tmp_path, effects, sample_rate_hz=-1.0, center_frequency_hz=True)))
    for place in (
        "sample_rate_hz: got -1.0", "center_frequency_hz: got true", "effects[0].parameters: unknown key 'offset'",
        "effects[1].owner.level: got 'receiver', needs one of rx", "effects[2].owner.name: got 'rx9'",
        "effects[2].parameters.level_dbc.std: got -1.0", "effects[3].owner.level: got 'link'",
        "effects[4].parameters.gain_db: got 5000.0, needs a finite number of dB in -400 to 400",
        "effects[5].model: unknown key 'lowest'", "effects[5].model.taps[1]: got nan", "effects[6].family: got 'magic'",
    ):  # fmt: skip
        assert place in text, text


@pytest.mark.parametrize(
    ("family", "change", "says"),
    [
        ("phase_noise", {"model": {"law": "held"}}, "needs model.corner_hz"),
        ("pa_nonlinearity", {"model": {"orders": [1, 2], "coefficients": [0.1]}}, "needs 4 for its 2 orders"),
        ("front_end_filter", {"model": {"taps": [0.1]}}, "needs Re and Im"),
        ("second_transmitter", {"parameters": {"code": "w9", "delay_s": 0.0, "gain_db": 0.0}}, "got 'w9', needs one of w1, w2"),
        ("power_supply_hum", {"model": {"depth_2": 0.1}}, "needs depth_k and phase_k_rad"),
        ("extra_path", {"parameters": {"delay_s": 50.0, "gain_db": 0.0}}, "in -33.5544 to 33.5544"),
        ("tap_fading", {"parameters": {"delay_s": 0.0, "k_factor_db": 9.0, "doppler_spread_hz": 1e9}}, "in 0 to 2e+06"),
    ],
)  # fmt: skip
def test_numbers_that_contradict_each_other_or_the_sample_rate_are_refused(tmp_path, family, change, says):
    assert says in "\n".join(faults(written(tmp_path, [entry(family, **change)])))


def test_a_std_that_nobody_knows_is_null_and_1e6_is_a_number(tmp_path):
    parameters = {"offset_hz": {"value": 100.0, "std": None}}
    path = written(tmp_path, [entry("carrier_frequency_offset", parameters=parameters)])
    path.write_text(path.read_text().replace("1000000.0", "1e6"))
    case = read_twin(path)
    assert case.sample_rate_hz == 1e6
    assert len(Playback(case, case.observations[0], 100, Conditions()).samples()) == 100


@pytest.mark.parametrize("name", ["../../evil", "/tmp/evil", "a/../../b", ".", "", "a\0b", "x" * 200])
def test_no_name_in_a_twin_leads_out_of_its_folder(tmp_path, name):
    there = [{"file": name, "receiver": "rx1", "transmitters": ["tx1"]}]
    assert any("recordings[0].file" in line for line in faults(written(tmp_path, recordings=there)))
    assert any("waveforms.w1.file" in line for line in faults(written(tmp_path, waveforms={"w1": {"file": name}})))
    assert any("nodes: got" in line for line in faults(written(tmp_path, nodes={"tx1": {"transmit": "w1"}, "rx1": {}, name: {}})))


@pytest.mark.parametrize(
    "program", ["cast_emulator.py play --twin {twin} --output {out}", "cast_diagnose.py {case} --output {out}"]
)
def test_both_programs_refuse_a_twin_by_the_same_check_and_write_nothing(tmp_path, program):
    path = written(tmp_path, [entry("carrier_frequency_offset", parameters={"offset": 100.0})])
    words = program.format(twin=path, case=tmp_path, out=tmp_path / "out").split()
    done = subprocess.run([sys.executable, APPS / words[0], *words[1:]], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2 and "effects[0].parameters: unknown key 'offset'" in done.stderr, done.stderr
    assert "Traceback" not in done.stderr and not list(tmp_path.glob("out/*"))


def test_levels_that_no_sample_can_have_are_refused_before_one_is_written(tmp_path):
    case = read_twin(
        written(
            tmp_path, [entry("lo_leakage", parameters={"level_dbc": 400.0}), entry("dc_offset", parameters={"level_dbc": 399.0})]
        )
    )
    assert np.isfinite(Playback(case, case.observations[0], 100, Conditions()).samples()).all()
    loud = Conditions(gain_db=500.0, noise_power_db=-np.inf)
    with pytest.raises(CastError, match="levels of lo_leakage, dc_offset are too large"):
        Playback(case, case.observations[0], 100, loud).samples()


@pytest.mark.parametrize("family", NAMED)
def test_an_entry_with_the_contracts_own_parameters_is_read_and_played(tmp_path, family):
    """`model` is what a diagnosis remembers beside the contract: without it a twin of other people's hand is a twin, too."""
    case = read_twin(written(tmp_path, [entry(family, model={})]))
    assert np.isfinite(Playback(case, case.observations[0], 2000, Conditions(seed=1)).samples()).all()


@pytest.mark.parametrize("family", ["front_end_filter", "diffuse_tail"])
def test_what_an_entry_does_not_tell_is_said_when_it_is_played(tmp_path, family):
    case = read_twin(written(tmp_path, [entry(family, model={})]))
    (line,) = Playback(case, case.observations[0], 2000, Conditions(seed=1)).warnings
    assert family in line and "model.taps" in line


def test_an_image_is_played_at_its_level_where_that_alone_is_told(tmp_path):
    case = read_twin(written(tmp_path, [entry("iq_imbalance", parameters={"image_rejection_db": 30.0})]))
    playback = Playback(case, case.observations[0], 2000, Conditions(seed=1))
    (effect,) = playback.model.effects
    assert FAMILIES["iq_imbalance"].values(playback.scene, effect, effect.p)["image_rejection_db"] == pytest.approx(30.0)
