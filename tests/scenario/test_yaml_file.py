# SPDX-License-Identifier: GPL-3.0-or-later
import math
import time

import numpy as np
import pytest
import yaml
from gr_cast import scenario as sc
from gr_cast.core.documents import Reader
from gr_cast.core.errors import CastError
from gr_cast.scenario import yaml_file
from hypothesis import given, settings
from hypothesis import strategies as st

HEAD = "cast_scenario: 1\nnodes: 2\n"


def written(tmp_path, text):
    path = tmp_path / "a.yaml"
    path.write_text(text)
    return path


def test_a_doppler_turns_the_phase_by_its_cycles_per_second(tmp_path):
    text = HEAD + "duration_s: 0.1\nall_links: {taps: [{delay_s: 1e-6, gain_db: -6, phase_rad: 0.3, doppler_hz: 7}]}\n"
    scenario = yaml_file.read(written(tmp_path, text))
    t = np.arange(101) / 1e3
    np.testing.assert_allclose(scenario.time_s, t, atol=1e-15)
    expected = 10 ** (-6 / 20) * np.exp(1j * (0.3 + 2 * np.pi * 7 * t))
    np.testing.assert_allclose(scenario.links["1", "2"].gain[:, 0], expected, rtol=1e-12)


def test_links_are_reciprocal_unless_the_file_says_not(tmp_path):
    link = "links: [{tx: 1, rx: 2, base_loss_db: 3, taps: [{delay_s: 0.0, gain_db: 0.0}]}]\n"
    both = yaml_file.read(written(tmp_path, HEAD + link))
    assert both.links["1", "2"] == both.links["2", "1"] and sc.base_loss_db(both, ("2", "1")) == 3
    assert set(yaml_file.read(written(tmp_path, HEAD + "reciprocal: false\n" + link)).links) == {("1", "2")}


def test_all_faults_of_a_file_come_at_once_with_their_place(tmp_path):
    text = """
cast_scenario: 2
nodes: [a, b]
color: red
base_loss_db: "12 dB"
interpolation: cubic
links:
  - {tx: a, rx: c, taps: [{delay_s: 0.0, gain_db: .nan}]}
  - {tx: a, rx: b, taps: [{delay: 0.0, gain_db: 0.0}, {delay_s: 0.0, gain_db: 0.0, doppler_hz: 10}]}
  - {tx: a, rx: b, taps: []}
"""
    with pytest.raises(CastError) as error:
        yaml_file.read(written(tmp_path, text))
    text = str(error.value)
    for place in (
        "cast_scenario: got 2", "unknown key 'color'", "base_loss_db: got '12 dB'", "interpolation", "links[0].rx: got 'c'",
        "links[0].taps[0].gain_db", "links[1].taps[0]: unknown key 'delay'", "links[1].taps[0]: delay_s is missing",
        "links[1].taps[1].doppler_hz", "links[2].taps: is empty", "a>b is given twice",
    ):  # fmt: skip
        assert place in text, text


@pytest.mark.parametrize(
    "text, says",
    [
        ("", "needs a mapping"),
        ("a: [", "not YAML"),
        ("nodes: 2\nnodes: 3\n", "given twice"),
        (HEAD, "neither all_links nor links"),
        ("cast_scenario: 1\nnodes: {a: {position_m: [1, 2, 3, 4]}, b: {}}\nlinks: []\n", "needs three numbers"),
        ("cast_scenario: 1\nnodes: {a: {position_m: [1, 2]}, b: {}}\nlinks: []\n", "needs three numbers"),
        (HEAD + "duration_s: 1e9\nlinks: []", "limit 1000000 steps"),
        (HEAD + "duration_s: 1\nall_links: {taps: [{delay_s: 0, gain_db: 0, doppler_hz: 501}]}", "limit +-500 Hz"),
        (HEAD + "all_links: {taps: [{delay_s: 5.12e-6, gain_db: 0}]}", "tap index 512"),
    ],
)
def test_a_file_that_cannot_be_meant_is_refused(tmp_path, text, says):
    with pytest.raises(CastError) as error:
        yaml_file.read(written(tmp_path, text))
    assert says in str(error.value) and "a.yaml" in str(error.value)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("cast_scenario: 1\nnodes: [" + ", ".join(f"n{k}" for k in range(20_000)) + "]\nall_links: {taps: []}\n", "limit 256"),
        ("cast_scenario: 1\nnodes: {../../evil: {}, b: {}}\nlinks: []\n", "needs a name"),
        (
            HEAD + "duration_s: 900\nlinks:\n - {tx: 1, rx: 2, taps: &t ["
            + ", ".join(["{delay_s: 0, gain_db: 0, doppler_hz: 1}"] * 15) + "]}\n - {tx: 2, rx: 1, taps: *t}\n",
            "got 27000030 taps over all links and instants, limit 25000000",
        ),
    ],
    ids=["nodes", "name", "aliases"],
)  # fmt: skip
def test_what_would_fill_the_memory_or_leave_a_folder_is_refused_before_it_is_built(tmp_path, text, says):
    began = time.process_time()
    with pytest.raises(CastError) as error:
        yaml_file.read(written(tmp_path, text))
    assert says in str(error.value)
    assert time.process_time() - began < 5


def test_bytes_that_are_not_text_and_missing_files_are_refused(tmp_path):
    path = tmp_path / "b.yaml"
    with pytest.raises(CastError, match="no such file"):
        yaml_file.read(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(CastError, match="not UTF-8"):
        yaml_file.read(path)


@st.composite
def scenarios(draw):
    instants = draw(st.integers(1, 4))
    nodes = tuple("abc"[: draw(st.integers(1, 3))])
    number = st.floats(-60, 20, allow_subnormal=False)
    links = {}
    for key in draw(st.sets(st.tuples(st.sampled_from(nodes), st.sampled_from(nodes)))):
        shape = (draw(st.sampled_from([1, instants])), draw(st.integers(1, 5)))
        values = draw(
            st.lists(
                st.tuples(st.integers(0, 511), number, st.floats(-3, 3)),
                min_size=shape[0] * shape[1],
                max_size=shape[0] * shape[1],
            )
        )
        grid, gain_db, phase = (np.reshape(column, shape) for column in zip(*values, strict=True))
        links[key] = sc.LinkTaps(delay_s=grid * 1e-8, gain=10 ** (gain_db / 20) * np.exp(1j * phase))
    return sc.Scenario(
        name=draw(st.sampled_from(["x", "four taps", "ü"])), nodes=nodes, links=links, time_s=np.arange(instants) * 0.5,
        base_loss_db=draw(number), link_base_loss_db={key: 1.5 for key in links if key[0] == "a"},
        interpolation=draw(st.sampled_from(["hold", "linear"])), center_frequency_hz=draw(st.sampled_from([None, 1e9])),
        bandwidth_hz=draw(st.sampled_from([None, 20e6])),
    )  # fmt: skip


@settings(max_examples=100, deadline=None)
@given(scenarios())
def test_what_is_written_reads_back_the_same(tmp_path_factory, scenario):
    path = tmp_path_factory.mktemp("yaml") / "a.yaml"
    yaml_file.write(path, scenario)
    back = yaml_file.read(path)
    assert (back.name, back.nodes, back.interpolation) == (scenario.name, scenario.nodes, scenario.interpolation)
    assert (back.base_loss_db, back.bandwidth_hz) == (scenario.base_loss_db, scenario.bandwidth_hz)
    assert back.center_frequency_hz == scenario.center_frequency_hz
    assert back.link_base_loss_db == scenario.link_base_loss_db and set(back.links) == set(scenario.links)
    clock = np.linspace(0, 2, 9)
    for key in scenario.links:
        for got, expected in zip(sc.taps_at(back, key, clock), sc.taps_at(scenario, key, clock), strict=True):
            np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-20)


KEYS = sorted(yaml_file.KEYS | yaml_file.LINK_KEYS | yaml_file.TAP_KEYS)
VALUES = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8),
        st.sampled_from([1, 2, 0.0, 1e-6, -3.0, "a", "b", "hold", math.nan]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(KEYS), inner, max_size=4)
    ),
    max_leaves=12,
)  # fmt: skip


def test_faults_of_every_tap_come_at_once_each_at_its_place(tmp_path):
    taps = "{delay_s: -1, gain_db: 3}, {delay_s: 0, gain_db: 3000}, {delay_s: x, gain_db: 0}"
    (tmp_path / "s.yaml").write_text(f"cast_scenario: 1\nnodes: 2\nlinks: [{{tx: 1, rx: 2, taps: [{taps}]}}, 3]\n")
    with pytest.raises(CastError) as refused:
        yaml_file.read(tmp_path / "s.yaml")
    places = [fault.split(": ")[1] for fault in refused.value.faults]
    assert {"links[0].taps[0]", "links[0].taps[1].gain_db", "links[0].taps[2].delay_s", "links[1]"} <= set(places)


def test_values_that_are_not_one_per_instant_are_one_fault_and_lay_nothing_to_the_doppler(tmp_path):
    tap = "{delay_s: 0, gain_db: [0, 1, 2], doppler_hz: 1}"
    text = f"cast_scenario: 1\nnodes: 2\nduration_s: 1\ntime_s: [0, 1]\nlinks: [{{tx: 1, rx: 2, taps: [{tap}]}}]\n"
    with pytest.raises(CastError) as refused:
        yaml_file.read(written(tmp_path, text.replace("duration_s: 1\n", "")))
    (fault,) = refused.value.faults
    assert "gain_db: got 3 values, time_s has 2" in fault


def test_megahertz_without_their_unit_are_questioned_as_on_the_command_line(tmp_path):
    text = (
        "cast_scenario: 1\nnodes: 2\ncenter_frequency_hz: %s\nbandwidth_hz: 20M\nall_links: {taps: [{delay_s: 0, gain_db: 0}]}\n"
    )
    (tmp_path / "s.yaml").write_text(text % 2400)
    with pytest.raises(CastError, match="center_frequency_hz: got 2400, 2400 Hz: is 2400M meant?"):
        yaml_file.read(tmp_path / "s.yaml")
    (tmp_path / "s.yaml").write_text(text % "2400Hz")
    scenario = yaml_file.read(tmp_path / "s.yaml")
    assert (scenario.center_frequency_hz, scenario.bandwidth_hz) == (2400.0, 20e6)
    yaml_file.write(tmp_path / "again.yaml", scenario)
    assert yaml_file.read(tmp_path / "again.yaml") == scenario


@settings(max_examples=1500, deadline=None)
@given(st.dictionaries(st.sampled_from(sorted(yaml_file.KEYS)), VALUES, max_size=8))
def test_any_mapping_is_read_or_refused_but_never_crashes(document):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(yaml_file, "yaml_file", lambda path: Reader(str(path), {"cast_scenario": 1} | document))
        try:
            yaml_file.read("fuzz.yaml")
        except CastError as error:
            assert all("fuzz.yaml" in fault for fault in error.faults)


@settings(max_examples=3000, deadline=None)
@given(st.data())
def test_any_text_is_read_or_refused_but_never_crashes(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "fuzz.yaml"
    good = b"cast_scenario: 1\nnodes: 3\nlinks:\n - {tx: 1, rx: 2, taps: [{delay_s: 1e-6, gain_db: -3, phase_rad: 1}]}\n"
    start = data.draw(st.integers(0, len(good)))
    stop = data.draw(st.integers(start, min(len(good), start + 6)))
    middle = data.draw(st.one_of(st.binary(max_size=6), st.text("{}[]&*!|>%@:,-?#'\"\n\t 0e.", max_size=6).map(str.encode)))
    path.write_bytes(good[:start] + middle + good[stop:])
    try:
        yaml_file.read(path)
    except CastError as error:
        assert error.faults and all("fuzz.yaml" in fault for fault in error.faults)


LINK = "all_links: {taps: [{delay_s: 0, gain_db: 0}]}\n"
BESIDES = "time_s: is given besides duration_s or update_s, needs one or the other"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("nodes: 0\n" + LINK, "nodes: got 0, needs 1 to 256"),
        ("nodes: 257\n" + LINK, "nodes: got 257, needs 1 to 256"),
        ("nodes: true\n" + LINK, "nodes: got true, needs a count, a list of names, or a mapping of names"),
        ("nodes: [a, 3.5]\n" + LINK, "nodes[1]: got 3.5, needs text"),
        ("nodes: {a: {place: 1}}\n" + LINK, "nodes.a: unknown key 'place', knows position_m"),
        ("nodes: {a: {position_m: [1, 2, x]}}\n" + LINK, "nodes.a.position_m: got 'x', needs a finite number of m"),
        ("nodes: 2\nreciprocal: 1\n" + LINK, "reciprocal: got 1, needs true or false"),
        ("nodes: 2\nlinks: {}\n", "links: got {}, needs a list"),
        ("nodes: 2\ntime_s: [0, 1]\nduration_s: 1\n" + LINK, BESIDES),
        ("nodes: 2\ntime_s: [0, 1]\nupdate_s: 1\n" + LINK, BESIDES),
        ("nodes: 2\ntime_s: [0, 1, 1]\n" + LINK, "time_s: needs seconds that ascend from 0"),
        ("nodes: 2\ntime_s: [1, 2]\n" + LINK, "time_s: needs seconds that ascend from 0"),
        ("nodes: 2\ntime_s: []\n" + LINK, "time_s: needs seconds that ascend from 0"),
        ("nodes: 2\ntime_s: [0, -1]\n" + LINK, "time_s[1]: got -1, needs a finite number of s of 0 or more"),
        ("nodes: 2\nduration_s: -1\n" + LINK, "duration_s: got -1, needs a finite number of s of 0 or more"),
        ("nodes: 2\nduration_s: 1\nupdate_s: 0.9e-6\n" + LINK, "update_s: got 9e-07, needs a finite number of s of 1e-06"),
        ("nodes: 2\nduration_s: 1000\n" + LINK, "duration_s: got 1000 s in steps of 0.001 s, limit 1000000 steps"),
        ("nodes: 2\nall_links: {taps: [{delay_s: 0, gain_db: 0}], tx: 1}\n", "all_links: unknown key 'tx', knows taps"),
        ("nodes: 2\nall_links: {taps: [{delay_s: 0, gain_db: 120.1}]}\n",
         "all_links.taps[0].gain_db: got 120.1, needs a finite number of dB in -10000 to 120"),
        ("nodes: 2\nall_links: {taps: [{delay_s: 0, gain_db: -10001}]}\n",
         "all_links.taps[0].gain_db: got -10001, needs a finite number of dB in -10000 to 120"),
        ("nodes: 2\nall_links: {taps: [{delay_s: -.inf, gain_db: 0}]}\n",
         "all_links.taps[0].delay_s: got -inf, needs a finite number of s"),
        ("nodes: 2\nall_links: {taps: [{delay_s: 0, gain_db: []}]}\n", "all_links.taps[0].gain_db: got 0 values, time_s has 1"),
        ("nodes: 2\nduration_s: 1\nall_links: {taps: [{delay_s: 0, gain_db: 0, doppler_hz: 500.1}]}\n",
         "all_links.taps[0].doppler_hz: got 500.1 Hz, limit +-500 Hz at these updates"),
        ("nodes: 2\nduration_s: 1\nall_links: {taps: [{delay_s: 0, gain_db: 0, doppler_hz: -500.1}]}\n",
         "all_links.taps[0].doppler_hz: got -500.1 Hz, limit +-500 Hz at these updates"),
        ("nodes: 2\nall_links: {taps: [{delay_s: 0, gain_db: 0, doppler_hz: 1}]}\n",
         "all_links.taps[0].doppler_hz: turns over time: the file needs duration_s or time_s"),
        ("nodes: 2\ntime_s: [0, 1]\nall_links: {taps: [{delay_s: 0, gain_db: 0, doppler_hz: [0.1, 0.2]}]}\n",
         "all_links.taps[0].doppler_hz: needs one number: a Doppler that changes is a phase_rad over time"),
        ("nodes: 2\nlinks: [{tx: 1, rx: 2, base_loss_db: x, taps: [{delay_s: 0, gain_db: 0}]}]\n",
         "links[0].base_loss_db: got 'x', needs a finite number of dB"),
        ("nodes: 2\nlinks: [{tx: 1, rx: 2, taps: [{delay_s: 0, gain_db: 0}, {delay_s: 5.2e-6, gain_db: 0}]}]\n",
         "links[0].taps[1]: link 1>2: tap 2: delay_s: got 5.2e-06 s (tap index 520 on the 10 ns grid)"),
        ("nodes: 2\ncenter_frequency_hz: 2T\n" + LINK, "center_frequency_hz: "),
        ("nodes: 2\ncenter_frequency_hz: 1.1e12\n" + LINK,
         "center_frequency_hz: got 1100000000000.0, needs a frequency above 0, at most 1e+12 Hz"),
    ],
)  # fmt: skip
def test_one_fault_is_one_line_at_its_place(tmp_path, text, fault):
    with pytest.raises(CastError) as refused:
        yaml_file.read(written(tmp_path, "cast_scenario: 1\n" + text))
    (line,) = refused.value.faults
    assert line.split("a.yaml: ")[1].startswith(fault)


def test_clocks_come_as_instants_or_as_duration_and_steps_of_a_millisecond(tmp_path):
    for text, clock_s in (
        ("", [0.0]),
        ("duration_s: 0\n", [0.0]),
        ("duration_s: 0.003\n", [0, 1e-3, 2e-3, 3e-3]),
        ("duration_s: 1\nupdate_s: 0.25\n", [0, 0.25, 0.5, 0.75, 1]),
        ("duration_s: 1\nupdate_s: 0.3\n", [0, 0.3, 0.6, 0.9]),
        ("time_s: [0, 0.1, 7]\n", [0, 0.1, 7]),
    ):
        np.testing.assert_allclose(yaml_file.read(written(tmp_path, HEAD + text + LINK)).time_s, clock_s, rtol=1e-12)


def test_as_many_instants_and_taps_as_there_may_be_are_read(tmp_path, monkeypatch):
    monkeypatch.setattr(yaml_file, "MAX_INSTANTS", 10)
    assert yaml_file.read(written(tmp_path, HEAD + "duration_s: 9\nupdate_s: 1\n" + LINK)).time_s.size == 10
    with pytest.raises(CastError, match="limit 10 steps"):
        yaml_file.read(written(tmp_path, HEAD + "duration_s: 10\nupdate_s: 1\n" + LINK))
    still, turning = "{delay_s: 0, gain_db: 0}", "{delay_s: 0, gain_db: 0, doppler_hz: 0.1}"
    links = f"links: [{{tx: 1, rx: 2, taps: [{still}, {turning}]}}, {{tx: 2, rx: 1, taps: [{still}]}}]\n"
    text = HEAD + "time_s: [0, 1, 2]\n" + links  # two taps of three instants, and one
    monkeypatch.setattr(yaml_file, "MAX_TAPS", 7)
    assert len(yaml_file.read(written(tmp_path, text)).links) == 2
    monkeypatch.setattr(yaml_file, "MAX_TAPS", 6)
    for more in (text, text.replace("doppler_hz: 0.1", "phase_rad: [0, 1, 2]")):
        with pytest.raises(CastError, match="got 7 taps over all links and instants, limit 6"):
            yaml_file.read(written(tmp_path, more))


def test_a_doppler_may_turn_half_a_cycle_in_the_longest_step(tmp_path):
    text = "time_s: [0, 0.1, 0.3]\nall_links: {taps: [{delay_s: 0, gain_db: 0, phase_rad: [0, 1, 2], doppler_hz: 2.5}]}\n"
    gain = yaml_file.read(written(tmp_path, HEAD + text)).links["1", "2"].gain[:, 0]
    np.testing.assert_allclose(gain, np.exp(1j * (np.arange(3) + 2 * np.pi * 2.5 * np.array([0, 0.1, 0.3]))), atol=1e-12)


def test_values_over_time_stand_beside_those_that_stay(tmp_path):
    text = "time_s: [0, 1]\nall_links: {taps: [{delay_s: [0, 1e-6], gain_db: -6}, {delay_s: 2e-6, gain_db: [0, -.inf]}]}\n"
    scenario = yaml_file.read(written(tmp_path, HEAD + text))
    taps = scenario.links["2", "1"]
    np.testing.assert_allclose(taps.delay_s, [[0, 2e-6], [1e-6, 2e-6]])
    np.testing.assert_allclose(taps.gain, [[10**-0.3, 1], [10**-0.3, 0]])
    assert set(scenario.links) == {("1", "2"), ("2", "1")} and scenario.nodes == ("1", "2")


def test_a_named_link_stands_in_the_place_of_that_of_all(tmp_path):
    text = "nodes: 3\n" + LINK + "links: [{tx: 1, rx: 2, base_loss_db: 3, taps: [{delay_s: 1e-6, gain_db: -9}]}]\n"
    scenario = yaml_file.read(written(tmp_path, "cast_scenario: 1\n" + text))
    assert len(scenario.links) == 6
    delays = {key: taps.delay_s[0, 0] for key, taps in scenario.links.items()}
    assert {key for key, delay in delays.items() if delay == 1e-6} == {("1", "2"), ("2", "1")}
    assert scenario.link_base_loss_db == {("1", "2"): 3.0, ("2", "1"): 3.0}


def test_losses_of_both_ways_may_differ(tmp_path):
    taps = "taps: [{delay_s: 0, gain_db: 0}]"
    text = f"links: [{{tx: 1, rx: 2, base_loss_db: 3, {taps}}}, {{tx: 2, rx: 1, base_loss_db: 4, {taps}}}]\n"
    assert yaml_file.read(written(tmp_path, HEAD + text)).link_base_loss_db == {("1", "2"): 3.0, ("2", "1"): 4.0}


def test_names_positions_and_words_are_kept(tmp_path):
    text = "cast_scenario: 1\nname: hall\ndescription: ' - two halls\n - '\nnodes: {a: {position_m: [1, 2, 3]}, b: }\n" + LINK
    scenario = yaml_file.read(written(tmp_path, text))
    assert (scenario.name, scenario.description) == ("hall", "two halls")
    assert scenario.position_m["a"].tolist() == [[1, 2, 3]] and list(scenario.position_m) == ["a"]
    yaml_file.write(tmp_path / "again.yaml", scenario)
    again = yaml_file.read(tmp_path / "again.yaml")
    assert (again.name, again.description, again.nodes) == ("hall", "two halls", ("a", "b"))
    assert again.position_m["a"].tolist() == [[1, 2, 3]] and list(again.position_m) == ["a"]
    assert yaml_file.read(written(tmp_path, HEAD + LINK)).name == "a"  # the file's own, without one


def test_one_file_is_written_for_people_one_number_where_nothing_changes(tmp_path):
    taps = sc.LinkTaps(delay_s=[[0.0, 1e-6], [0.0, 2e-6]], gain=[[1.0, 0.1j], [1.0, 0.1j]])
    scenario = sc.Scenario(
        name="s", nodes=("1", "2"), links={("1", "2"): taps}, time_s=[0, 1], link_base_loss_db={("1", "2"): 4.0}
    )
    document = yaml.safe_load(yaml_file.to_text(scenario))
    assert document["cast_scenario"] == 1 and document["time_s"] == [0, 1] and document["reciprocal"] is False
    (entry,) = document["links"]
    first, second = entry["taps"]
    assert (entry["tx"], entry["rx"], entry["base_loss_db"]) == ("1", "2", 4.0)
    assert first == {"delay_s": 0.0, "gain_db": 0.0, "phase_rad": 0.0}
    assert second["delay_s"] == [1e-6, 2e-6] and second["gain_db"] == pytest.approx(-20)
    assert second["phase_rad"] == pytest.approx(np.pi / 2)


def test_a_scenario_of_more_numbers_than_are_read_again_is_not_written(tmp_path, monkeypatch):
    taps = sc.LinkTaps(delay_s=np.zeros((2, 3)), gain=np.ones((2, 3)))
    scenario = sc.Scenario(name="s", nodes=("1", "2"), links={("1", "2"): taps}, time_s=[0, 1])  # 3·6 and two instants
    monkeypatch.setattr(yaml_file, "MAX_VALUES", 40)
    yaml_file.write(tmp_path / "a.yaml", scenario)
    monkeypatch.setattr(yaml_file, "MAX_VALUES", 38)
    with pytest.raises(CastError, match="got 20 numbers, limit 19 in YAML: write it as .zarr"):
        yaml_file.write(tmp_path / "b.yaml", scenario)
    assert not (tmp_path / "b.yaml").exists()
