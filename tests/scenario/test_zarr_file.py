# SPDX-License-Identifier: GPL-3.0-or-later
import json

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.core.errors import CastError
from gr_cast.scenario import zarr_file


def scenario(instants=50):
    rng = np.random.default_rng(3)
    moving = sc.LinkTaps(delay_s=rng.integers(0, 512, (instants, 4)) * 1e-8, gain=rng.normal(size=(instants, 4)) + 0.5j)
    static = sc.LinkTaps(delay_s=[[0.0, 1e-6]], gain=[[1.0, 0.1j]])
    links = {("a", "b"): moving, ("b", "a"): moving, ("a", "c"): static, ("c", "c"): static}
    return sc.Scenario(
        name="walk", nodes=("a", "b", "c"), links=links, time_s=np.arange(instants) * 1e-3, base_loss_db=57.5,
        link_base_loss_db={("a", "c"): 3.0}, interpolation="linear", center_frequency_hz=2.4e9, bandwidth_hz=20e6,
        position_m={"a": np.zeros((1, 3)), "b": rng.normal(size=(instants, 3))},
    )  # fmt: skip


def test_what_is_written_reads_back_the_same_to_single_precision(tmp_path):
    before = scenario()
    sc.save(tmp_path / "walk.zarr", before)
    after = sc.load(tmp_path / "walk.zarr")
    for name in ("name", "nodes", "base_loss_db", "link_base_loss_db", "interpolation", "center_frequency_hz", "bandwidth_hz"):
        assert getattr(after, name) == getattr(before, name)
    assert set(after.links) == set(before.links)
    np.testing.assert_array_equal(after.time_s, before.time_s)
    np.testing.assert_array_equal(after.position_m["b"], before.position_m["b"])
    for key, taps in before.links.items():
        np.testing.assert_allclose(after.links[key].gain, taps.gain, rtol=1e-6)
        np.testing.assert_array_equal(after.links[key].delay_s, taps.delay_s)


def test_the_zarr_package_and_xarray_read_it_too(tmp_path):
    zarr = pytest.importorskip("zarr", reason="NO ZARR: the folder is not checked against another reader")
    before = scenario()
    sc.save(tmp_path / "walk.zarr", before)
    group = zarr.open_group(tmp_path / "walk.zarr", mode="r")
    np.testing.assert_allclose(group["moving_gain"][0], before.links["a", "b"].gain, rtol=1e-6)
    xarray = pytest.importorskip("xarray")
    labelled = xarray.open_zarr(tmp_path / "walk.zarr", consolidated=False)
    assert labelled["moving_gain"].dims == ("moving_link", "time", "tap") and labelled.attrs["name"] == "walk"


def test_a_link_that_stands_still_and_its_way_back_are_stored_once(tmp_path):
    links = {(a, b): sc.LinkTaps(delay_s=[[0.0]], gain=[[0.5]]) for a in "abc" for b in "abc" if a != b}
    sc.save(tmp_path / "s.zarr", sc.Scenario(name="s", nodes=tuple("abc"), links=links, time_s=np.arange(30000) / 1e3))
    assert zarr_file.read_array(tmp_path / "s.zarr", "static_gain").shape == (3, 1)
    assert zarr_file.read_array(tmp_path / "s.zarr", "moving_gain").size == 0


def test_half_a_minute_of_42_nodes_at_1_ms_takes_less_than_0_3_gb_however_two_of_them_walk(tmp_path):
    """Taps of pure noise, which no compression shortens, on all 81 links of the two; the other 780 stand still."""
    rng, instants = np.random.default_rng(1), 30001
    noise = rng.normal(size=(instants, 4, 2)) @ [1, 1j]
    moving = sc.LinkTaps(delay_s=rng.integers(0, 512, (instants, 4)) * 1e-8, gain=noise / np.abs(noise).max())
    static = sc.LinkTaps(delay_s=rng.integers(0, 512, (1, 4)) * 1e-8, gain=[[1.0, 0.5, 0.2, 0.1j]])
    nodes = [f"n{index}" for index in range(42)]
    links = {(a, b): moving if {a, b} & {"n40", "n41"} else static for a in nodes for b in nodes if a != b}
    where = {node: np.zeros((instants if node in ("n40", "n41") else 1, 3)) for node in nodes}
    made = sc.Scenario(
        name="s", nodes=tuple(nodes), links=links, time_s=np.arange(instants) * 1e-3, base_loss_db=0.0, position_m=where
    )
    sc.save(tmp_path / "s.zarr", made)
    assert len(links) == 42 * 41 and sum(taps is moving for taps in links.values()) == 2 * 81
    size = sum(file.stat().st_size for file in (tmp_path / "s.zarr").rglob("*") if file.is_file())
    assert 81 * instants * 4 * 8 < size < 0.3e9


def test_damage_is_refused_with_its_place(tmp_path):
    folder = tmp_path / "walk.zarr"
    for spoil, says in [
        (lambda: (folder / "moving_gain" / "0.0.0").write_bytes(b"junk"), "moving_gain"),
        (lambda: (folder / "moving_gain" / "0.0.0").unlink(), "moving_gain"),
        (lambda: (folder / "static_ends" / ".zarray").write_text("{}"), "static_ends"),
        (lambda: (folder / ".zattrs").write_text("nonsense"), ".zattrs"),
        (lambda: (folder / ".zattrs").write_text(json.dumps({"cast_scenario": 1})), ".zattrs"),
        (lambda: (folder / ".zattrs").unlink(), ".zattrs"),
    ]:
        sc.save(folder, scenario())
        spoil()
        with pytest.raises(CastError, match=says):
            sc.load(folder)


def test_the_outlines_of_a_place_are_no_part_of_what_every_reader_parses(tmp_path):
    outlines = [{"name": "wall", "faces": [[[0.0, 0.0], [1.0, 0.5]]], "floor": False}]
    zarr_file.write(tmp_path / "walk.zarr", scenario(), outlines=outlines)
    assert zarr_file.outlines(tmp_path / "walk.zarr") == outlines
    assert "wall" not in (tmp_path / "walk.zarr" / ".zattrs").read_text()
    (tmp_path / "walk.zarr" / "outlines.json").write_text('[{"name": "wall", "faces": [[[0.0]]], "floor": false}]')
    with pytest.raises(CastError, match="needs x and y"):
        zarr_file.outlines(tmp_path / "walk.zarr")
