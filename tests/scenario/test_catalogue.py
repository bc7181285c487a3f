# SPDX-License-Identifier: GPL-3.0-or-later
import cast_scenario
import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario import colosseum


@pytest.mark.parametrize("name", sc.catalogue_entries())
def test_every_shipped_scenario_loads_but_the_one_that_is_published_out_of_range(name):
    if name == "90002":
        with pytest.raises(CastError, match=r"90002\.yaml.*link 4>5: tap 4.*index 512.*limit 0 to 5\.11 us"):
            sc.load(name)
    else:
        assert sc.load(name).links


@pytest.mark.parametrize("name, nodes", [("1009", 10), ("10009", 25), ("90000", 32)])
def test_in_a_0_db_scenario_every_node_hears_every_other_at_0_db(name, nodes):
    matrix = sc.path_gain_matrix_db(sc.load(name))
    np.testing.assert_allclose(matrix[~np.eye(nodes, dtype=bool)], 0.0, atol=1e-12)
    assert (np.diag(matrix) == -np.inf).all()


@pytest.mark.parametrize("name, key", [("four_tap", ("1", "2")), ("90003", ("1", "4")), ("90003", ("4", "1"))])
def test_the_four_tap_link_is_the_papers(name, key):
    filters = sc.impulse_response(sc.load(name).links[key])
    assert np.flatnonzero(filters[0]).tolist() == [0, 128, 200, 400]
    np.testing.assert_allclose(20 * np.log10(np.abs(filters[0, [0, 128, 200, 400]])), [-3, -20, -15, -8], atol=0.01)


def test_the_near_null_of_90001_cancels_at_the_carrier():
    assert abs(sc.load("90001").links["3", "5"].gain.sum()) < 1e-10


@pytest.mark.parametrize("name, ghz", [(str(90004 + index), index + 1) for index in range(6)])
def test_the_losses_of_90004_to_90009_go_from_0_to_45_db(name, ghz):
    scenario = sc.load(name)
    losses = -sc.path_gain_matrix_db(scenario)[np.triu_indices(5, 1)]
    np.testing.assert_allclose(np.sort(losses), np.arange(0, 50, 5), atol=1e-9)
    assert scenario.center_frequency_hz == ghz * 1e9


@pytest.mark.parametrize(
    "name, is_one", [("four_tap", True), ("mine.yaml", True), ("MINE.MAT", True), ("nowhere", False), ("a.txt", False)]
)
def test_a_scenario_is_an_id_of_the_catalogue_or_a_file_of_its_suffix(name, is_one):
    assert sc.is_scenario(name) == is_one


def test_an_unknown_name_lists_the_catalogue():
    with pytest.raises(CastError, match="four_tap"):
        sc.load("five_tap")


def test_an_installed_scenario_is_found_by_its_id(tmp_path, monkeypatch):
    monkeypatch.setenv("CAST_CATALOGUE", str(tmp_path))
    sc.save(tmp_path / "mine.yaml", sc.load("four_tap"))
    mine, shipped = (sc.load(name).links["1", "2"] for name in ("mine", "four_tap"))
    np.testing.assert_allclose(mine.gain, shipped.gain, rtol=1e-12)
    np.testing.assert_array_equal(mine.delay_s, shipped.delay_s)


def test_show_convert_and_list_tell_what_is_there(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cast_scenario.main(["convert", "four_tap", "a.mat"]) == 0
    assert cast_scenario.main(["show", "a.mat", "--plot", "a.png"]) == 0
    text = capsys.readouterr().out
    assert "1>2" in text and "1.280 / -20.00" in text
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert cast_scenario.main(["convert", "a.mat", "b.yaml"]) == 0
    assert sc.load("b.yaml").links.keys() == sc.load("four_tap").links.keys()
    assert cast_scenario.main(["list"]) == 0
    assert "refused" in capsys.readouterr().out
    with pytest.raises(CastError, match="index 512"):
        cast_scenario.main(["show", "90002"])
    with pytest.raises(CastError, match="suffix"):
        cast_scenario.main(["convert", "four_tap", "a.txt"])


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["convert", "four_tap", "nowhere/a.mat"], "no such folder"),
        (["convert", "four_tap", "a.mat", "--every-ms", "0"], "above 0"),
        (["create", "nowhere"], "none of the examples: arena, street"),
        (["validate", "four_tap", "--link", "1-2"], "TX>RX, such as '1>2'"),
        (["validate", "four_tap", "--links", "-3"], "needs 1 or more"),
        (["validate", "four_tap", "--band", "80Hz"], "got 80 Hz, limit 1e4 to 1e8 Hz"),
        (["import", "a.cir.t1_1.p2m", "--output", "a.yaml", "--tx-power-dbm", "nan"], "got nan dBm"),
    ],
)
def test_arguments_that_make_no_sense_are_refused_in_one_line(tmp_path, monkeypatch, arguments, says):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAST_RAYTRACER", str(tmp_path / "none"))  # or create would go on in its Python
    with pytest.raises(CastError, match=says):
        cast_scenario.main(arguments)
    assert not list(tmp_path.iterdir())


def test_maps_and_coarser_steps_come_with_a_conversion(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    taps = sc.LinkTaps(delay_s=np.zeros((1001, 1)), gain=np.linspace(0.1, 1, 1001)[:, None])
    walk = sc.Scenario(name="walk", nodes=("a", "b"), links={("a", "b"): taps}, time_s=np.arange(1001) / 1e3)
    sc.save("walk.zarr", walk)
    maps = ["--radio-map", "radio.json", "--node-map", "node.json"]
    assert cast_scenario.main(["convert", "walk.zarr", "walk.mat", "--every-ms", "100", *maps]) == 0
    coarse = sc.load("walk.mat")
    np.testing.assert_allclose(coarse.time_s, np.arange(11) / 10)
    np.testing.assert_allclose(coarse.links["1", "2"].gain[:, 0], np.linspace(0.1, 1, 11), rtol=1e-6)
    assert colosseum.read_radio_map("radio.json")["2"]["SRN"] == 2 and colosseum.read_node_map("node.json") == {
        "1": 1,
        "2": 2,
    }
    monkeypatch.setattr(colosseum, "MAX_CELLS", 100)
    with pytest.raises(CastError, match="coarser"):
        cast_scenario.main(["convert", "walk.zarr", "walk.mat"])


def test_an_installed_scenario_comes_before_a_shipped_one_and_hidden_files_are_none(tmp_path, monkeypatch):
    monkeypatch.setenv("CAST_CATALOGUE", str(tmp_path))
    quiet = sc.with_base_loss(sc.load("four_tap"), 77.0)
    sc.save(tmp_path / "four_tap.yaml", quiet)
    sc.save(tmp_path / ".hidden.yaml", quiet)
    (tmp_path / "note.txt").write_text("no scenario")
    assert sc.load("four_tap").base_loss_db == 77
    assert sc.catalogue_entries()["four_tap"] == tmp_path / "four_tap.yaml"
    assert not {".hidden", "hidden", "note"} & set(sc.catalogue_entries())


def test_where_the_users_own_scenarios_lie_is_told_by_the_environment(tmp_path, monkeypatch):
    monkeypatch.delenv("CAST_CATALOGUE", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert sc.catalogue.installed_folder() == tmp_path / "gr_cast/catalogue"
    monkeypatch.delenv("XDG_DATA_HOME")
    monkeypatch.setenv("HOME", str(tmp_path / "me"))
    assert sc.catalogue.installed_folder() == tmp_path / "me/.local/share/gr_cast/catalogue"
    assert sc.load("four_tap")  # a folder that is not there holds none


@pytest.mark.parametrize("suffix", [".yaml", ".yml", ".mat", ".zarr", ".YAML", ".Mat"])
def test_a_scenario_is_written_and_read_by_its_suffix_however_it_is_spelt(tmp_path, suffix):
    path = tmp_path / f"one{suffix}"
    sc.save(path, sc.load("four_tap"))
    assert sc.load(path).links["1", "2"].delay_s.max() == sc.load(str(path)).links["1", "2"].delay_s.max() == 4e-6


def test_another_suffix_a_missing_folder_and_an_example_that_is_not_made_are_told(tmp_path):
    scenario = sc.load("four_tap")
    for ask in (lambda: sc.save(tmp_path / "a.txt", scenario), lambda: sc.catalogue.read(tmp_path / "a.txt")):
        with pytest.raises(CastError, match="suffix: got '.txt', needs one of .yaml, .yml, .mat, .zarr"):
            ask()
    with pytest.raises(CastError, match="no such folder"):
        sc.save(tmp_path / "none/a.yaml", scenario)
    example = next(sc.catalogue.examples_folder().glob("*.yaml")).stem
    with pytest.raises(CastError, match=f"{example}: not made yet: .*create {example}"):
        sc.load(example)
