# SPDX-License-Identifier: GPL-3.0-or-later
import struct
import zlib

import cast_scenario
import numpy as np
import pytest
import scipy.io
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario import colosseum, mat_file
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

NO_LINK = {"delay": np.zeros((1, 4)), "iq": np.zeros((1, 4), complex)}


def cells(nodes, instants, taps):
    """chMatrix as MATLAB holds it: a cell array with `taps[(row, column, instant)]`, elsewhere no link."""
    matrix = np.empty((nodes, nodes, instants), object)
    for place in np.ndindex(matrix.shape):
        matrix[place] = taps.get(place, NO_LINK)
    return matrix


def tap(delay_s, iq):
    pad = 4 - len(delay_s)
    return {"delay": np.array([list(delay_s) + [0.0] * pad]), "iq": np.array([list(iq) + [0j] * pad], complex)}


def refused(tmp_path, content):
    path = tmp_path / "a.mat"
    scipy.io.savemat(path, content)
    with pytest.raises(CastError) as error:
        colosseum.read(path)
    assert "a.mat" in str(error.value)
    return str(error.value)


def test_time_varying_cells_are_read_with_the_transmitter_in_the_row(tmp_path):
    taps = {(0, 1, 0): tap([0.0, 1.28e-6], [0.5, 0.1j]), (0, 1, 1): tap([1e-8], [0.25])}
    content = {"chMatrix": cells(2, 2, taps), "time": [[0.0, 1000.0]], "coordinates": np.arange(12.0).reshape(2, 3, 2)}
    scipy.io.savemat(tmp_path / "a.mat", content)
    scenario = sc.load(tmp_path / "a.mat")
    assert set(scenario.links) == {("1", "2")} and scenario.interpolation == "hold"
    delay_s, gain = sc.taps_at(scenario, ("1", "2"), [0.999, 1.0])
    np.testing.assert_array_equal(gain, [[0.5, 0.1j], [0.25, 0]])
    np.testing.assert_array_equal(delay_s[gain != 0], [0.0, 1.28e-6, 1e-8])
    np.testing.assert_array_equal(scenario.position_m["2"], [[6, 8, 10], [7, 9, 11]])


def test_the_static_form_is_one_tap_at_1_ns_of_the_path_gain(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"chMatrix": np.array([[-np.inf, -20.0], [-43.0, -np.inf]])})
    scenario = sc.load(tmp_path / "a.mat")
    assert scenario.links["1", "2"].delay_s[0, 0] == 1e-9
    assert abs(scenario.links["1", "2"].gain[0, 0]) == pytest.approx(0.1)
    assert sc.path_gain_matrix_db(scenario)[1, 0] == pytest.approx(-43.0) and len(scenario.links) == 2


def test_taps_left_at_the_formats_default_are_unused(tmp_path):
    default = {"delay": np.full((1, 4), 1e-9), "iq": np.ones((1, 4), complex)}
    mixed = {"delay": np.array([[0.0, 1e-9, 1e-9, 1e-9]]), "iq": np.array([[0.5, 1, 1, 1]], complex)}
    scipy.io.savemat(tmp_path / "a.mat", {"chMatrix": cells(2, 1, {(0, 1, 0): default, (1, 0, 0): mixed})})
    scenario = sc.load(tmp_path / "a.mat")
    assert sc.tap_power_db(scenario, ("1", "2"))[0] == pytest.approx(0.0)  # one tap of 0 dB at 1 ns
    assert sc.tap_power_db(scenario, ("2", "1"))[0] == pytest.approx(20 * np.log10(0.5))


def test_the_last_taps_stay_until_the_whole_second(tmp_path):
    taps = {(0, 1, 0): tap([0.0], [0.5]), (0, 1, 1): tap([0.0], [0.25])}
    scipy.io.savemat(tmp_path / "a.mat", {"chMatrix": cells(2, 2, taps), "time": [[0.0, 1500.0]]})
    scenario = sc.load(tmp_path / "a.mat")
    np.testing.assert_array_equal(scenario.time_s, [0, 1.5, 2.0])
    np.testing.assert_array_equal(scenario.links["1", "2"].gain[:, 0], [0.5, 0.25, 0.25])


@pytest.mark.parametrize("delay_s, gain_db", [(0.0, 0.0), (5.11e-6, -43.0)])
def test_a_tap_at_the_limits_is_read(tmp_path, delay_s, gain_db):
    iq = 10 ** (gain_db / 20) * np.exp(2j)
    scipy.io.savemat(tmp_path / "a.mat", {"chMatrix": cells(2, 1, {(0, 1, 0): tap([delay_s], [iq])})})
    assert sc.tap_power_db(sc.load(tmp_path / "a.mat"), ("1", "2"))[0] == pytest.approx(gain_db)


def test_every_tap_past_a_limit_is_named_at_once(tmp_path):
    taps = {
        (3, 4, 0): tap([0, 1.28e-6, 2.56e-6, 5.12e-6], [1, 0.8, 0.6, 0.4]),
        (0, 1, 0): tap([0.0, 1e-6], [1.0, 10 ** (0.5 / 20)]),
        (1, 0, 0): tap([-1e-9], [1.01]),
        (2, 0, 0): tap([np.nan], [1.0]),
    }
    text = refused(tmp_path, {"chMatrix": cells(5, 1, taps)})
    assert "link 4>5: tap 4: delay: got 5.12e-06 s (tap index 512 on the 10 ns grid)" in text and "5.11 us" in text
    assert "link 1>2: tap 2: iq" in text and "0.50 dB" in text and "limit 0 dB" in text
    assert "link 2>1: tap 1: iq" in text and "link 2>1: tap 1: delay" in text and "link 3>1: tap 1: delay" in text
    assert len(text.splitlines()) == 5


@pytest.mark.parametrize("name", ["90003", "90004", "90005", "90006", "90007", "90008", "90009"])
def test_colosseums_own_scenarios_convert_with_a_warning(tmp_path, name, capsys):
    """Their weakest taps lie below the documented -43 dB; what SciPy reads of the file is what the scenario holds."""
    cast_scenario.main(["convert", name, str(tmp_path / "a.mat")])
    assert "warning: link " in capsys.readouterr().err
    weakest = min(np.abs(taps.gain).min() for taps in sc.load(name).links.values())
    matrix = scipy.io.loadmat(tmp_path / "a.mat", struct_as_record=False, squeeze_me=True)["chMatrix"]
    assert min(np.abs(cell.iq[cell.iq != 0]).min(initial=1.0) for cell in matrix.flat) == pytest.approx(weakest)
    with pytest.raises(CastError, match="documented are -43 to 0 dB"):
        cast_scenario.main(["convert", name, str(tmp_path / "b.mat"), "--strict"])
    assert not (tmp_path / "b.mat").exists()


def test_maps_name_any_srn_once(tmp_path):
    files = ["--radio-map", str(tmp_path / "radio.json"), "--node-map", str(tmp_path / "node.json")]
    target = ["convert", "90001", str(tmp_path / "a.mat"), *files]
    cast_scenario.main([*target, "--srn", "1=77", "--srn", "5=none"])
    radios = colosseum.read_radio_map(tmp_path / "radio.json")
    assert radios["1"]["SRN"] == 77 and radios["2"]["SRN"] == 2 and radios["5"] is None
    assert colosseum.read_node_map(tmp_path / "node.json") == {"1": 77, "2": 2, "3": 3, "4": 4}
    with pytest.raises(CastError, match="SRN 2 serves two nodes"):
        cast_scenario.main([*target, "--srn", "1=2"])
    with pytest.raises(CastError, match="got '9=1', needs NODE=SRN"):
        cast_scenario.main([*target, "--srn", "9=1"])


def test_a_file_of_the_wrong_shape_says_what_is_wrong(tmp_path):
    five = {"delay": np.zeros((1, 5)), "iq": np.ones((1, 5), complex)}
    assert "limit 4 taps" in refused(tmp_path, {"chMatrix": cells(2, 1, {(0, 1, 0): five})})
    assert "chMatrix{1,2,1}" in refused(tmp_path, {"chMatrix": cells(2, 1, {(0, 1, 0): np.zeros(3)})})
    assert "chMatrix: missing" in refused(tmp_path, {"other": 1.0})
    assert "chMatrix" in refused(tmp_path, {"chMatrix": np.zeros((2, 3))})
    assert "link 1>2: tap 1" in refused(tmp_path, {"chMatrix": np.array([[0.0, 0.5], [0.0, 0.0]])})
    assert "whole ms" in refused(tmp_path, {"chMatrix": cells(1, 2, {}), "time": [[0.0, 0.5]]})
    assert "time" in refused(tmp_path, {"chMatrix": cells(1, 3, {}), "time": [[0.0, 1000.0]]})
    assert "coordinates" in refused(tmp_path, {"chMatrix": cells(2, 1, {}), "coordinates": np.zeros((2, 2))})


def test_a_written_file_has_colosseums_structure_for_other_readers(tmp_path):
    scenario = sc.load("four_tap")
    sc.save(tmp_path / "a.mat", scenario)
    content = scipy.io.loadmat(tmp_path / "a.mat")
    assert content["chMatrix"].shape == (2, 2, 2) and content["time"].tolist() == [[0.0, 1000.0]]
    cell = content["chMatrix"][0, 1, 1]
    np.testing.assert_allclose(cell["delay"][0, 0].ravel(), [0, 1.28e-6, 2e-6, 4e-6])
    np.testing.assert_allclose(20 * np.log10(np.abs(cell["iq"][0, 0].ravel())), [-3, -20, -15, -8])
    assert not content["chMatrix"][0, 0, 0]["iq"][0, 0].any()
    sc.save(tmp_path / "s.mat", sc.load("1009"), form="static")
    np.testing.assert_array_equal(scipy.io.loadmat(tmp_path / "s.mat")["chMatrix"] == 0, ~np.eye(10, dtype=bool))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_what_is_written_reads_back_the_same(tmp_path_factory, data):
    instants, step_s = data.draw(st.integers(1, 3)), data.draw(st.sampled_from([1e-3, 0.25, 1.0]))
    links = {}
    for key in data.draw(st.sets(st.tuples(st.sampled_from("123"), st.sampled_from("123")), min_size=1)):
        shape = (data.draw(st.sampled_from([1, instants])), data.draw(st.integers(1, 4)))
        rng = np.random.default_rng(data.draw(st.integers(0, 2**32)))
        gain = 10 ** (rng.uniform(-43, 0, shape) / 20) * np.exp(1j * rng.uniform(-3, 3, shape))
        links[key] = sc.LinkTaps(delay_s=rng.integers(0, 512, shape) * 1e-8, gain=gain * (rng.random(shape) < 0.8))
    scenario = sc.Scenario(name="a", nodes=tuple("123"), links=links, time_s=np.arange(instants) * step_s)
    path = tmp_path_factory.mktemp("mat") / "a.mat"
    sc.save(path, scenario)
    back = sc.load(path)
    clock = np.arange(instants) * step_s
    for key in [(a, b) for a in "123" for b in "123"]:
        expected = np.zeros((instants, 512)) if key not in links else sampled(scenario, key, clock)
        got = np.zeros((instants, 512)) if key not in back.links else sampled(back, key, clock)
        np.testing.assert_allclose(got, expected, rtol=1e-12)


def sampled(scenario, key, clock):
    delay_s, gain = sc.taps_at(scenario, key, clock)
    return sc.impulse_response(sc.LinkTaps(delay_s=delay_s, gain=gain))


def test_linear_taps_are_written_out_at_1_ms(tmp_path):
    taps = sc.LinkTaps(delay_s=[[0.0], [0.0]], gain=[[0.1], [1.0]])
    scenario = sc.Scenario(name="a", nodes=("1", "2"), links={("1", "2"): taps}, time_s=[0, 1], interpolation="linear")
    sc.save(tmp_path / "a.mat", scenario)
    back = sc.load(tmp_path / "a.mat")
    np.testing.assert_allclose(back.links["1", "2"].gain[:, 0].real, np.linspace(0.1, 1.0, 1001), atol=1e-6)


def test_what_the_format_cannot_hold_is_refused_and_nothing_is_written(tmp_path):
    five = sc.LinkTaps(delay_s=np.arange(5)[None] * 1e-8, gain=np.full((1, 5), 0.1))
    loud = sc.LinkTaps(delay_s=[[0.0]], gain=[[1.5]])
    scenario = sc.Scenario(name="a", nodes=("1", "2"), links={("1", "2"): five, ("2", "1"): loud})
    with pytest.raises(CastError) as error:
        sc.save(tmp_path / "a.mat", scenario)
    assert "link 1>2: got 5 taps, limit 4" in str(error.value) and "link 2>1: tap 1: iq" in str(error.value)
    with pytest.raises(CastError, match="one constant tap"):
        sc.save(tmp_path / "a.mat", sc.load("four_tap"), form="static")
    fine = sc.LinkTaps(delay_s=[[0.0], [0.0]], gain=[[0.5], [0.4]])
    with pytest.raises(CastError, match="whole ms"):
        sc.save(tmp_path / "a.mat", sc.Scenario(name="a", nodes=("1",), links={("1", "1"): fine}, time_s=[0, 5e-4]))
    assert not list(tmp_path.iterdir())


def test_broken_files_are_refused(tmp_path):
    sc.save(tmp_path / "a.mat", sc.load("four_tap"))
    whole = (tmp_path / "a.mat").read_bytes()
    for name, content in {
        "cut.mat": whole[: len(whole) // 2], "empty.mat": b"", "text.mat": b"hello", "v73.mat": b"\x89HDF\r\n\x1a\n" + bytes(99),
    }.items():  # fmt: skip
        (tmp_path / name).write_bytes(content)
        with pytest.raises(CastError, match=name):
            sc.load(tmp_path / name)
    with pytest.raises(CastError, match="no such file"):
        sc.load(tmp_path / "absent.mat")


@settings(max_examples=4000, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_bytes_are_read_or_refused_but_never_crash(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "fuzz.mat"
    good = path.with_name("good.mat")
    if not good.exists():  # without compression, so that changes reach the parser behind it
        scipy.io.savemat(good, {"chMatrix": cells(2, 1, {(0, 1, 0): tap([0.0, 1e-6], [0.5, 0.1j])}), "time": [[0.0]]})
    content = bytearray(good.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content[: data.draw(st.one_of(st.just(len(content)), st.integers(0, len(content))))])
    try:
        colosseum.read(path)
    except CastError as error:
        assert all("fuzz.mat" in fault for fault in error.faults)


def test_files_of_every_flavour_read_as_scipy_reads_them(tmp_path):
    numbers = np.random.default_rng(1).normal(size=(2, 3, 4))
    content = {
        "a": numbers,
        "b": numbers[0] + 1j * numbers[1],
        "c": np.arange(5, dtype=np.uint8),
        "d": np.zeros((0, 3)),
        "e": "text",
    }
    for compress in (False, True):
        scipy.io.savemat(tmp_path / "a.mat", content, do_compression=compress)
        ours, theirs = mat_file.read(tmp_path / "a.mat"), scipy.io.loadmat(tmp_path / "a.mat")
        for name in "abcd":
            np.testing.assert_array_equal(ours[name], theirs[name])
        assert ours["e"] is None


def test_maps_read_as_documented_and_refuse_by_name(tmp_path):
    radio = tmp_path / "radio.json"
    radio.write_text('{"Node 1": {"SRN": 1, "RadioA": 1, "RadioB": 2}, "Node 5": "None"}')
    assert colosseum.read_radio_map(radio) == {"1": {"SRN": 1, "RadioA": 1, "RadioB": 2}, "5": None}
    colosseum.write_radio_map(tmp_path / "again.json", colosseum.read_radio_map(radio))
    assert colosseum.read_radio_map(tmp_path / "again.json") == colosseum.read_radio_map(radio)
    radio.write_text('{"Node 0": "None", "Node 2": {"SRN": 129, "RadioA": 1, "RadioB": 2}, "Node 3": 7}')
    with pytest.raises(CastError) as error:
        colosseum.read_radio_map(radio)
    assert all(name in str(error.value) for name in ("Node 0", "Node 2", "Node 3"))

    nodes = tmp_path / "nodes.json"
    nodes.write_text('{"1": 1, "2": 45}')
    assert colosseum.read_node_map(nodes) == {"1": 1, "2": 45}
    colosseum.write_node_map(tmp_path / "again.json", {"1": 1, "2": 45})
    assert colosseum.read_node_map(tmp_path / "again.json") == {"1": 1, "2": 45}
    nodes.write_text('{"1": 1, "2": 1, "x": 3, "4": 0.5}')
    with pytest.raises(CastError) as error:
        colosseum.read_node_map(nodes)
    assert all(place in str(error.value) for place in ("2: SRN 1", "x:", "4: got 0.5"))


def test_a_small_file_of_much_is_refused_before_it_is_unpacked(tmp_path):
    """A megabyte of zeros compressed to a thousandth, many times over: sums are limited, not single variables."""
    pack = zlib.compressobj(9)
    packed = b"".join([pack.compress(bytes(1 << 20)) for _ in range(400)]) + pack.flush()
    (tmp_path / "a.mat").write_bytes(
        b" " * 124 + b"\x00\x01IM" + np.array([15, len(packed)], "<u4").tobytes() + packed
    )  # fmt: skip
    assert (tmp_path / "a.mat").stat().st_size < 1 << 20
    with pytest.raises(CastError, match="more than 335544320 bytes, unpacked"):
        mat_file.read(tmp_path / "a.mat")


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        ({"other": 1.0, "more": 2.0}, "chMatrix: missing, the file holds other, more"),
        ({}, "chMatrix: missing, the file holds no variables"),
        ({"chMatrix": np.zeros((2, 3))}, "chMatrix: got shape (2, 3), needs N x N x T cells or N x N path gains in dB"),
        ({"chMatrix": np.zeros((0, 0))}, "chMatrix: got shape (0, 0), needs"),
        ({"chMatrix": np.zeros((2, 2, 2, 2))}, "chMatrix: got shape (2, 2, 2, 2), needs"),
        ({"chMatrix": np.zeros((257, 257))}, "chMatrix: got 257 nodes, limit 256"),
        ({"chMatrix": np.zeros((2, 2, 2))}, "chMatrix: got 3 dimensions of float64, needs N x N real path gains in dB"),
        ({"chMatrix": np.zeros((2, 2)) + 1j}, "chMatrix: got 2 dimensions of complex128, needs N x N real path gains in dB"),
        ({"chMatrix": np.array([[-np.inf, 0.5], [-np.inf, -np.inf]])}, "link 1>2: tap 1: iq: got 1.059+0j, 0.50 dB , limit 0 dB"),
        ({"chMatrix": cells(1, 1, {(0, 0, 0): {"delay": np.zeros((1, 0)), "iq": np.zeros((1, 0))}})},
         "chMatrix{1,1,1}: got 0 delays and 0 iq, needs as many of each, limit 4 taps"),
        ({"chMatrix": cells(1, 1, {(0, 0, 0): {"delay": np.zeros((1, 3)), "iq": np.zeros((1, 2))}})},
         "chMatrix{1,1,1}: got 3 delays and 2 iq, needs as many of each, limit 4 taps"),
        ({"chMatrix": cells(2, 2, {(0, 1, 1): {"delay": np.zeros((1, 1)) + 1j, "iq": np.zeros((1, 1))}}), "time": [[0.0, 1.0]]},
         "chMatrix{1,2,2}: needs numbers: delay real, in s, and iq"),
        ({"chMatrix": cells(2, 1, {(1, 0, 0): {"delay": np.zeros((1, 1))}})},
         "chMatrix{2,1,1}: needs a struct with delay and iq; for no link, iq is 0"),
        ({"chMatrix": cells(1, 3, {}), "time": [[0.0, 1000.0]]}, "time: got 2 values of float64, chMatrix has 3 instants in ms"),
        ({"chMatrix": cells(1, 2, {}), "time": [[0.0, 1j]]}, "time: got 2 values of complex128, chMatrix has 2 instants in ms"),
        ({"chMatrix": cells(1, 2, {}), "time": [[1.0, 2.0]]}, "time: needs whole ms that ascend from 0, smallest step 1 ms"),
        ({"chMatrix": cells(1, 2, {}), "time": [[0.0, 1.5]]}, "time: needs whole ms that ascend from 0, smallest step 1 ms"),
        ({"chMatrix": cells(1, 2, {}), "time": [[0.0, np.inf]]}, "time: needs whole ms that ascend from 0, smallest step 1 ms"),
        ({"chMatrix": cells(1, 2, {}), "time": [[0.0, 0.0]]}, "time: needs whole ms that ascend from 0, smallest step 1 ms"),
        ({"chMatrix": cells(2, 1, {}), "coordinates": np.zeros((3, 2))}, "coordinates: got shape (3, 2, 1), needs 2 x 3 x 1"),
        ({"chMatrix": cells(2, 1, {}), "coordinates": np.zeros((2, 3, 2))},
         "coordinates: got shape (2, 3, 2), needs 2 x 3 x 1 metres"),
        ({"chMatrix": cells(2, 1, {}), "coordinates": np.zeros((2, 3)) + 1j}, "coordinates: got shape (2, 3, 1), needs 2 x 3"),
        ({"chMatrix": cells(2, 1, {}), "coordinates": np.full((2, 3), np.inf)}, "coordinates: holds NaN or infinite metres"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_meant_is_refused_by_its_one_fault(tmp_path, content, fault):
    (line,) = refused(tmp_path, content).splitlines()
    assert line.split("a.mat: ")[1].startswith(fault)


def test_a_tap_that_is_wrong_for_a_while_is_named_once_with_its_first_instant(tmp_path):
    taps = {(0, 1, k): tap([0.0, 6e-6 if k in (1, 2) else 0.0], [0.5, 2.0 if k == 3 else 0.5]) for k in range(4)}
    text = refused(tmp_path, {"chMatrix": cells(2, 4, taps), "time": [[0.0, 5.0, 7.0, 1000.0]]})
    delay, iq = sorted(line.split("a.mat: ")[1] for line in text.splitlines())
    assert delay == (
        "link 1>2: tap 2: delay: got 6e-06 s (tap index 600 on the 10 ns grid) at 5 ms (and 1 more instants), limit 0 to 5.11 us"
    )
    assert iq == "link 1>2: tap 2: iq: got 2+0j, 6.02 dB at 1000 ms, limit 0 dB"


def test_one_tap_is_a_tap_and_the_struct_may_be_called_tap(tmp_path):
    one = {"delay": np.array([[2e-8]]), "iq": np.array([[0.5j]])}
    scipy.io.savemat(tmp_path / "a.mat", {"chMatrix": cells(2, 1, {(0, 1, 0): one, (1, 0, 0): {"tap": one}})})
    scenario = sc.load(tmp_path / "a.mat")
    for key in (("1", "2"), ("2", "1")):
        assert scenario.links[key].delay_s.tolist() == [[2e-8]] and scenario.links[key].gain.tolist() == [[0.5j]]
    assert scenario.is_static and scenario.time_s.tolist() == [0] and scenario.name == "a" and not scenario.position_m


@pytest.mark.parametrize(
    ("time_ms", "clock_s"),
    [(None, [0, 1]), ([0, 1000], [0, 1]), ([0, 1001], [0, 1.001, 2]), ([0, 999], [0, 0.999, 1]), ([0, 1], [0, 0.001, 1])],
)
def test_time_ends_with_a_whole_second_and_is_a_second_where_it_is_not_told(tmp_path, time_ms, clock_s):
    taps = {(0, 1, 0): tap([0.0], [0.5]), (0, 1, 1): tap([0.0], [0.25])}
    coordinates = np.arange(12.0).reshape(2, 3, 2)
    content = {"chMatrix": cells(2, 2, taps), "coordinates": coordinates}
    scipy.io.savemat(tmp_path / "a.mat", content | ({} if time_ms is None else {"time": [np.array(time_ms, np.int16)]}))
    scenario = sc.load(tmp_path / "a.mat")
    assert scenario.time_s.tolist() == clock_s
    assert scenario.links["1", "2"].gain[:, 0].tolist() == [0.5, 0.25, 0.25][: len(clock_s)]
    assert scenario.position_m["1"].tolist() == [[0, 2, 4], [1, 3, 5], [1, 3, 5]][: len(clock_s)]


def test_where_nodes_stand_still_and_where_on_earth_is_told(tmp_path):
    content = {"chMatrix": cells(2, 2, {}), "coordinates": np.arange(6.0).reshape(2, 3)}
    for origin, says in (
        ({"long": -71.087, "lat": 42.34}, "origin.long -71.087, origin.lat 42.34"),
        ({"long": -71.087}, ""),
        ({"long": "west", "lat": 42.34}, ""),
        ({"long": -71.087, "lat": np.array([1.0, 2.0])}, ""),
        ({"long": -71.087, "lat": 1j}, ""),
    ):
        scipy.io.savemat(tmp_path / "a.mat", content | {"origin": origin})
        scenario = sc.load(tmp_path / "a.mat")
        assert scenario.description == says and scenario.position_m["2"].tolist() == [[3, 4, 5]]


def test_the_formats_own_filler_is_a_tap_where_it_stands_first_or_says_something_else(tmp_path):
    first = {"delay": np.array([[1e-9, 1e-9, 1e-9, 2e-9]]), "iq": np.array([[1, 1, 0.5, 1]], complex)}
    scipy.io.savemat(tmp_path / "a.mat", {"chMatrix": cells(2, 1, {(0, 1, 0): first})})
    taps = sc.load(tmp_path / "a.mat").links["1", "2"]
    assert taps.delay_s.tolist() == [[1e-9, 1e-9, 2e-9]] and taps.gain.tolist() == [[1, 0.5, 1]]


@pytest.mark.parametrize(("gain_db", "told"), [(-42.9, False), (-43.0, False), (-43.1, True)])
def test_taps_below_what_is_documented_are_told(gain_db, told):
    taps = sc.LinkTaps(delay_s=np.zeros((1, 3)), gain=[[1.0, 0.0, 10 ** (gain_db / 20)]])
    lines = colosseum.weak_taps(sc.Scenario(name="a", nodes=("1", "2"), links={("1", "2"): taps}))
    assert lines == (["link 1>2: got a tap of -43.10 dB, documented are -43 to 0 dB"] if told else [])


def one_way(delay_s, gain, **about):
    taps = sc.LinkTaps(delay_s=delay_s, gain=gain)
    return sc.Scenario(name="a", nodes=("1", "2"), links={("1", "2"): taps}, **about)


@pytest.mark.parametrize(
    ("scenario", "says"),
    [
        (one_way([[0.0, 0.0]], [[0.5, 0.5]]), "one constant tap"),
        (one_way([[0.0], [0.0]], [[0.5], [0.4]], time_s=[0, 1]), "one constant tap"),
        (one_way([[6e-9]], [[0.5]]), "one constant tap"),
        (one_way([[0.0]], [[0.5j]]), "gains without a phase"),
        (one_way([[0.0]], [[1.1]]), "limit 0 dB"),
    ],
)
def test_the_static_form_refuses_what_it_cannot_hold(tmp_path, scenario, says):
    with pytest.raises(CastError, match=f"link 1>2: .*{says}"):
        sc.save(tmp_path / "s.mat", scenario, form="static")
    assert not (tmp_path / "s.mat").exists()


def test_the_static_form_holds_one_gain_per_link_in_db(tmp_path):
    scenario = one_way([[5e-9, 4e-6], [5e-9, 4e-6]], [[0.5, 0.0], [0.5, 0.0]], time_s=[0, 1])
    sc.save(tmp_path / "s.mat", scenario, form="static")
    matrix = scipy.io.loadmat(tmp_path / "s.mat")["chMatrix"]
    assert matrix[0, 1] == pytest.approx(20 * np.log10(0.5)) and np.isneginf(matrix[[0, 1, 1], [0, 0, 1]]).all()


def test_used_taps_come_first_positions_and_time_beside_them(tmp_path):
    """Five columns of which four are used at a time; what SciPy reads."""
    delay_s = np.array([[1, 2, 3, 4, 5], [1, 2, 3, 4, 5], [6, 7, 8, 9, 10]]) * 1e-7
    gain = np.array([[0, 0.2, 0.3, 0.4, 0.5], [0.1, 0, 0.3, 0, 0.5], [0.1, 0.2, 0, 0.4, 0.5]])
    track = np.arange(9.0).reshape(3, 3)
    scenario = one_way(delay_s, gain, time_s=[0, 0.25, 1.5], position_m={"1": track, "2": np.full((1, 3), 7.0)})
    sc.save(tmp_path / "a.mat", scenario)
    content = scipy.io.loadmat(tmp_path / "a.mat")
    assert content["time"].tolist() == [[0, 250, 1500, 2000]] and content["chMatrix"].shape == (2, 2, 4)
    wants = [([2, 3, 4, 5], [0.2, 0.3, 0.4, 0.5]), ([1, 3, 5, 0], [0.1, 0.3, 0.5, 0]), ([6, 7, 9, 10], [0.1, 0.2, 0.4, 0.5])]
    for k, (delays, gains) in enumerate([*wants, wants[-1]]):
        cell = content["chMatrix"][0, 1, k]
        np.testing.assert_allclose(cell["delay"][0, 0].ravel(), np.array(delays) * 1e-7, rtol=1e-12)
        np.testing.assert_allclose(cell["iq"][0, 0].ravel(), gains, rtol=1e-12)
        assert not content["chMatrix"][1, 0, k]["iq"][0, 0].any()
    assert content["coordinates"].shape == (2, 3, 4)
    assert content["coordinates"][0].T.tolist() == track[[0, 1, 2, 2]].tolist() and (content["coordinates"][1] == 7).all()


def test_a_still_scenario_is_written_as_a_second_and_positions_of_some_nodes_stay_out(tmp_path):
    sc.save(tmp_path / "a.mat", one_way([[1e-7]], [[0.5]], position_m={"1": np.zeros((1, 3))}))
    content = scipy.io.loadmat(tmp_path / "a.mat")
    assert content["time"].tolist() == [[0, 1000]] and content["chMatrix"].shape == (2, 2, 2) and "coordinates" not in content
    for k in (0, 1):
        assert content["chMatrix"][0, 1, k]["delay"][0, 0].ravel().tolist() == [1e-7, 0, 0, 0]
        assert content["chMatrix"][0, 1, k]["iq"][0, 0].ravel().tolist() == [0.5, 0, 0, 0]


def test_no_more_cells_are_written_than_a_file_may_have(tmp_path, monkeypatch):
    scenario = one_way([[0.0]] * 4, [[0.5], [0.4], [0.3], [0.2]], time_s=[0, 0.001, 0.25, 1])
    monkeypatch.setattr(colosseum, "MAX_CELLS", 16)
    sc.save(tmp_path / "a.mat", scenario)
    monkeypatch.setattr(colosseum, "MAX_CELLS", 15)
    with pytest.raises(CastError, match="chMatrix: got 16 cells, limit 15: write it in coarser steps"):
        sc.save(tmp_path / "b.mat", scenario)


@pytest.mark.parametrize(("step_s", "fits"), [(0.0010000005, True), (0.0015, False)])
def test_steps_are_whole_milliseconds(tmp_path, step_s, fits):
    scenario = one_way([[0.0], [0.0]], [[0.5], [0.4]], time_s=[0, step_s])
    if fits:
        sc.save(tmp_path / "a.mat", scenario)
        assert scipy.io.loadmat(tmp_path / "a.mat")["time"].tolist() == [[0, 1, 1000]]
    else:
        with pytest.raises(CastError, match="time: the format holds whole ms, the scenario's smallest step is 1.5 ms"):
            sc.save(tmp_path / "a.mat", scenario)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{}", "needs a JSON object with at least one node"),
        ('{"Node 10000": "None"}', 'Node 10000: needs the form "Node 1"'),
        ('{"Node 1": {"SRN": 1, "RadioA": 1}}', 'Node 1: got .*needs SRN, RadioA and RadioB, or "None"'),
        ('{"Node 1": {"SRN": 0, "RadioA": 1, "RadioB": 2}}', "Node 1: got .*needs whole numbers: SRN 1 to 128, radios 1 to 256"),
        ('{"Node 1": {"SRN": 1, "RadioA": 0, "RadioB": 2}}', "needs whole numbers"),
        ('{"Node 1": {"SRN": 1, "RadioA": 1, "RadioB": 257}}', "needs whole numbers"),
        ('{"Node 1": {"SRN": true, "RadioA": 1, "RadioB": 2}}', "needs whole numbers"),
        ('{"Node 1": {"SRN": 1, "RadioA": 1, "RadioB": 2}, "Node 2": {"SRN": 1, "RadioA": 3, "RadioB": 4}}',
         "Node 2: SRN 1 serves Node 1 already"),
    ],
)  # fmt: skip
def test_a_radio_map_that_cannot_be_meant_is_refused(tmp_path, text, says):
    (tmp_path / "radio.json").write_text(text)
    with pytest.raises(CastError, match=says) as error:
        colosseum.read_radio_map(tmp_path / "radio.json")
    assert len(error.value.faults) == 1


def test_maps_hold_the_largest_numbers_that_there_are(tmp_path):
    radio = {"9999": {"SRN": 128, "RadioA": 256, "RadioB": 1}, "1": None}
    colosseum.write_radio_map(tmp_path / "radio.json", radio)
    assert colosseum.read_radio_map(tmp_path / "radio.json") == radio
    colosseum.write_node_map(tmp_path / "node.json", {"9999": 128, "1": 1})
    assert colosseum.read_node_map(tmp_path / "node.json") == {"9999": 128, "1": 1}
    for text, says in (('{"0": 1}', "0: needs a node number from 1"), ('{"1": 129}', "1: got 129, needs an SRN from 1 to 128")):
        (tmp_path / "node.json").write_text(text)
        with pytest.raises(CastError, match=says):
            colosseum.read_node_map(tmp_path / "node.json")


# MAT-files by hand: elements as MathWorks' "MAT-File Format" has them.
def element(kind, content, order="<"):
    return struct.pack(f"{order}II", kind, len(content)) + content + bytes(-len(content) % 8)


def array(kind, shape, *parts, order="<", flags=0, name=b"x"):
    about = element(6, struct.pack(f"{order}II", kind | flags, 0), order) + element(
        5, struct.pack(f"{order}{len(shape)}i", *shape), order
    )
    return element(14, about + element(1, name, order) + b"".join(parts), order)


def matlab(path, *variables, order="<"):
    path.write_bytes(b" " * 124 + (b"\x00\x01IM" if order == "<" else b"\x01\x00MI") + b"".join(variables))
    return path


KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(("kind", "dtype"), KINDS.items())
def test_numbers_of_every_type_and_either_order_are_read(tmp_path, order, kind, dtype):
    numbers = np.arange(6, dtype=order + dtype)
    path = matlab(tmp_path / "a.mat", array(6, (2, 3), element(kind, numbers.tobytes(), order), order=order), order=order)
    np.testing.assert_array_equal(mat_file.read(path)["x"], [[0, 2, 4], [1, 3, 5]])


def test_small_elements_lie_in_their_tags(tmp_path):
    small = struct.pack("<HH4s", 2, 3, b"\x01\x02\x03")
    assert mat_file.read(matlab(tmp_path / "a.mat", array(6, (1, 3), small)))["x"].tolist() == [[1, 2, 3]]


def test_real_and_imaginary_parts_make_a_number(tmp_path):
    parts = [element(2, bytes([1, 2])), element(2, bytes([3, 4]))]
    path = matlab(tmp_path / "a.mat", array(6, (1, 2), *parts, flags=0x800))
    assert mat_file.read(path)["x"].tolist() == [[1 + 3j, 2 + 4j]]


def nested(depth):
    inner = array(6, (1, 1), element(2, b"\x07"), name=b"")
    for _ in range(depth):
        inner = array(1, (1, 1), inner, name=b"")
    return inner


def test_cells_lie_in_one_another_eight_deep(tmp_path):
    value = mat_file.read(matlab(tmp_path / "a.mat", nested(8)))[""]
    for _ in range(8):
        assert value.shape == (1, 1) and value.dtype == object
        value = value[0, 0]
    assert value == 7
    with pytest.raises(CastError, match="nested deeper than 8"):
        mat_file.read(matlab(tmp_path / "a.mat", nested(9)))
    deep = array(6, (1, 1), element(2, b"\x07"), name=b"")
    for _ in range(9):
        deep = array(2, (1, 1), element(5, struct.pack("<i", 2)), element(1, b"a\0"), deep, name=b"")
    with pytest.raises(CastError, match="nested deeper than 8"):
        mat_file.read(matlab(tmp_path / "a.mat", deep))


BYTE = element(2, b"\x07")
ONE = array(6, (1, 1), BYTE, name=b"")
NAMES = element(5, struct.pack("<i", 2))


@pytest.mark.parametrize(
    ("damaged", "says"),
    [
        (b"\0" * 7, "7 bytes are left over"),
        (struct.pack("<HH", 2, 5) + bytes(4), "a small element claims 5 bytes"),
        (struct.pack("<II", 14, 9) + bytes(8), "an element claims 9 bytes, 8 are left"),
        (element(9, bytes(8)), "got element type 9, needs a variable"),
        (element(15, zlib.compress(element(9, bytes(8)))), "got element type 9, needs a variable"),
        (element(15, zlib.compress(bytes(0))), "got element type None, needs a variable"),
        (element(15, zlib.compress(ONE)[:-5]), "a compressed variable ends early"),
        (element(14, element(6, b"") + element(5, struct.pack("<ii", 1, 1)) + element(1, b"x")), "no class or shape"),
        (array(6, (1,), BYTE), "no class or shape"),
        (array(6, (-1, -1), BYTE), "no class or shape"),
        (array(6, (1, -1), BYTE), "no class or shape"),
        (array(6, (1, 1), BYTE, element(2, b"\1\2"), flags=0x800), "an array's imaginary part has another size"),
        (array(6, (2, 1), BYTE), r"an array of shape \(2, 1\) holds 1 numbers"),
        (array(1, (2, 1), ONE), r"a cell array of shape \(2, 1\) holds 1 cells"),
        (array(1, (1, 1), BYTE), "got element type 2, needs an array"),
        (array(2, (1, 1), element(5, b""), element(1, b"a\0"), ONE), "a struct has no length of names"),
        (array(2, (1, 1), element(5, struct.pack("<i", 0)), element(1, b"a\0"), ONE), "a struct has no length of names"),
        (array(2, (1, 1), NAMES, element(1, b"a\0b\0"), ONE), "a struct of 2 fields holds 1"),
        (array(6, (1,) * 9, BYTE), "got 9 numbers where 8 are the most"),
        (element(14, element(9, bytes(8)) + element(5, struct.pack("<ii", 1, 1)) + element(1, b"x") + BYTE), "fractions"),
        (array(6, (1, 1), element(14, b"")), "got element type 14, needs numbers"),
        (array(6, (1, 1)), "got element type None, needs numbers"),
        (array(6, (1, 1), element(9, bytes(7))), "7 bytes are not whole numbers of 8 bytes"),
    ],
)
def test_every_damage_is_told_for_what_it_is(tmp_path, damaged, says):
    with pytest.raises(CastError, match=f"a.mat: truncated or damaged: .*{says}"):
        mat_file.read(matlab(tmp_path / "a.mat", damaged))


def test_what_is_no_number_cell_or_single_struct_is_none_and_nothing_is_an_empty_array(tmp_path):
    two = array(2, (1, 2), NAMES, element(1, b"a\0"), ONE, ONE)
    assert mat_file.read(matlab(tmp_path / "a.mat", two)) == {"x": None}
    assert mat_file.read(matlab(tmp_path / "a.mat", array(4, (1, 1), BYTE))) == {"x": None}
    assert mat_file.read(matlab(tmp_path / "a.mat", element(14, b"")))[""].shape == (0, 0)
    eight = array(6, (1,) * 8, BYTE)
    assert mat_file.read(matlab(tmp_path / "a.mat", eight))["x"].shape == (1,) * 8
    struct_of_one = array(2, (1, 1), NAMES, element(1, b"a\0b\0"), ONE, ONE)
    found = mat_file.read(matlab(tmp_path / "a.mat", struct_of_one))["x"]
    assert {name: value.tolist() for name, value in found.items()} == {"a": [[7]], "b": [[7]]}


@pytest.mark.parametrize(("numbers", "fits"), [(1, True), (8, True), (9, False)])
def test_flags_and_shape_are_eight_numbers_at_most(tmp_path, numbers, fits):
    flags = element(6, struct.pack("<I", 6) + bytes(4 * numbers - 4))
    path = matlab(tmp_path / "a.mat", element(14, flags + element(5, struct.pack("<ii", 1, 1)) + element(1, b"x") + BYTE))
    if fits:
        assert mat_file.read(path)["x"].tolist() == [[7]]
    else:
        with pytest.raises(CastError, match="got 9 numbers where 8 are the most"):
            mat_file.read(path)


def test_no_array_is_larger_than_it_may_be(tmp_path, monkeypatch):
    monkeypatch.setattr(mat_file, "_MAX_NUMBERS", 3)
    assert mat_file.read(matlab(tmp_path / "a.mat", array(6, (1, 3), element(2, bytes(3)))))["x"].shape == (1, 3)
    with pytest.raises(CastError, match="got 4 numbers, limit 3"):
        mat_file.read(matlab(tmp_path / "a.mat", array(6, (1, 4), element(2, bytes(4)))))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(200), "is a MATLAB 7.3"),
        (b"MATLAB 7.3 MAT-file" + bytes(200), "is a MATLAB 7.3"),
        (b" " * 126 + b"XX" + bytes(8), "not a MATLAB level 5 file"),
        (b"", "not a MATLAB level 5 file"),
    ],
)
def test_another_format_is_told(tmp_path, content, says):
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(CastError, match=says):
        mat_file.read(tmp_path / "a.mat")
