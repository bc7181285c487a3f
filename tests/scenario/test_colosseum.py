# SPDX-License-Identifier: GPL-3.0-or-later
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
