# SPDX-License-Identifier: GPL-3.0-or-later
from dataclasses import replace

import cast_scenario
import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.comparing import validation
from gr_cast.core.errors import CastError
from gr_cast.scenario import zarr_file
from gr_cast.scenario.create import paths

LINK = ("1", "2")


def one_link(delay_steps, gain, **about):
    taps = sc.LinkTaps(delay_s=np.array([delay_steps]) * 1e-8, gain=np.array([gain], complex))
    return sc.Scenario(name="test", nodes=("1", "2"), links={LINK: taps}, **about)


@pytest.mark.parametrize("seed", range(3))
def test_random_taps_are_heard_within_the_sounders_own_uncertainty(seed):
    rng = np.random.default_rng(seed)
    steps = rng.choice(512, 4, replace=False)
    gain = 10 ** (rng.uniform(-20, 0, 4) / 20) * np.exp(2j * np.pi * rng.random(4))
    found = validation.check_link(one_link(steps, gain, base_loss_db=40.0), LINK, 0.0)
    assert found.holds and found.found == 4
    assert found.sounded_path_loss_db == pytest.approx(40 - 10 * np.log10(np.sum(np.abs(gain) ** 2)), abs=0.1)
    assert found.sounded_from_taps_db < -40 and found.taps_from_rays_db is None
    assert found.taps == 4


def test_an_emulator_that_plays_a_tap_wrongly_is_caught():
    scenario = one_link([0, 100], [1.0, 0.5])

    def late(frozen, samples, rate):
        return np.concatenate([[0], validation.play_reference(frozen, samples, rate)[:-1]])

    def weak(frozen, samples, rate):
        return 0.98 * validation.play_reference(frozen, samples, rate)

    assert validation.check_link(scenario, LINK, 0.0).holds
    for wrong in (late, weak):
        assert not validation.check_link(scenario, LINK, 0.0, play=wrong).holds


def test_what_the_approximation_lost_is_told_from_what_the_emulation_lost():
    rays = np.array([[0.0, 2.5e-7]]), np.array([[1.0, 0.1j]])
    found = validation.check_link(one_link([0], [1.0]), LINK, 0.0, rays=rays)
    assert found.taps_from_rays_db == pytest.approx(10 * np.log10(0.01 / 1.01), abs=0.3)
    assert found.sounded_from_rays_db == pytest.approx(found.taps_from_rays_db, abs=0.3)
    assert found.sounded_from_taps_db < -40


def test_losses_are_those_in_the_band_of_taps_rays_and_sounding_alike():
    # Two rays 12 ns apart, nearly opposite: in 20 MHz far less than the sum of their taps' powers.
    rays = np.array([[1e-7, 1.12e-7]]), np.array([[1.0, -0.9]])
    f = ((np.arange(2000) + 0.5) / 2000 - 0.5) * 20e6
    in_band_db = -10 * np.log10(np.mean(np.abs(1 - 0.9 * np.exp(-2j * np.pi * f * 1.2e-8)) ** 2))
    found = validation.check_link(one_link([10, 11], [1.0, -0.9], bandwidth_hz=20e6), LINK, 0.0, rays=rays)
    assert found.ray_path_loss_db == pytest.approx(in_band_db, abs=0.01)
    assert found.sounded_path_loss_db == pytest.approx(found.path_loss_db, abs=0.05)
    assert found.path_loss_db > in_band_db and found.tap_sum_loss_db == pytest.approx(-10 * np.log10(1.81), abs=1e-6)
    assert found.path_loss_db > found.tap_sum_loss_db + 10


def test_a_moving_link_is_checked_at_its_start_middle_and_end_and_a_static_one_once():
    turning = np.exp(2j * np.pi * np.arange(5) / 5)[:, None]
    links = {("1", "2"): sc.LinkTaps(delay_s=np.zeros((5, 1)), gain=turning), ("2", "1"): one_link([3], [1.0]).links[LINK]}
    scenario = sc.Scenario(name="test", nodes=("1", "2"), links=links, time_s=np.arange(5) * 0.1)
    asked = []

    def rays(key, time_s):
        asked.append((key, time_s))

    found = validation.check(scenario, list(links), rays=rays)
    assert [(c.link, round(c.time_s, 9)) for c in found] == [("1>2", 0.0), ("1>2", 0.2), ("1>2", 0.4), ("2>1", 0.0)]
    assert asked[-1] == (("2", "1"), 0.0) and len(asked) == 4
    assert all(c.holds and c.taps == c.found == 1 and c.ray_path_loss_db is None for c in found)


@pytest.mark.parametrize("loss_db", [0.0, 30.0])
def test_noise_stands_30_db_under_what_is_heard_however_weak_it_is(loss_db):
    scenario = one_link([0], [10 ** (-loss_db / 20)])
    found = validation._sounded(replace(scenario, nodes=("tx", "rx"), links={("tx", "rx"): scenario.links[LINK]}),
                                validation.play_reference, 1)  # fmt: skip
    assert 10 * np.log10(found.noise_power) == pytest.approx(-30 - loss_db, abs=0.1)


def test_rays_are_those_of_the_work_folder_either_way_and_as_late_as_they_were_moved(tmp_path):
    rng = np.random.default_rng(3)
    arrays = {name: np.zeros((1, 2)) for name in ("rate_before", "rate_after")}
    link = paths.LinkPaths(time_s=np.zeros(1), delay_s=np.array([[1e-7, 3e-7]]), gain=rng.normal(size=(1, 2)) + 0j, **arrays)
    paths.write(tmp_path / "links.npz", {(0, 1): link})
    scenario = sc.Scenario(name="x", nodes=("a", "b", "c"), links={}, center_frequency_hz=1e9)
    about = {"paths_file": str(tmp_path / "links.npz"), "hold_s": 2.0, "delays_moved_s": [["a", "b", [0.0, 1e-8]]]}
    zarr_file.write(tmp_path / "x.zarr", scenario, **about)
    rays = validation.traced_rays(tmp_path / "x.zarr", scenario)
    there, gain = rays(("a", "b"), 0.0)
    np.testing.assert_allclose(there, link.delay_s)
    np.testing.assert_allclose(np.abs(gain), np.abs(link.gain))
    for key in (("a", "b"), ("b", "a")):
        for time_s, moved_s in ((1.9, 0.0), (2.0, 1e-8), (99.0, 1e-8)):
            np.testing.assert_allclose(rays(key, time_s)[0] - there, moved_s, atol=1e-15)
    assert rays(("a", "c"), 0.0) is None
    (tmp_path / "links.npz").unlink()
    assert validation.traced_rays(tmp_path / "x.zarr", scenario) is None is validation.traced_rays("four_tap", scenario)


def test_paths_read_back_as_they_were_written(tmp_path):
    rng = np.random.default_rng(2)

    def link(instants, count):
        shape = (instants, count)
        arrays = {name: rng.normal(size=shape) for name in ("delay_s", "rate_before", "rate_after")}
        return paths.LinkPaths(time_s=np.arange(instants) * 0.1, gain=rng.normal(size=shape) + 1j, **arrays)

    links = {(0, 1): link(1, 3), (0, 2): link(5, 4), (1, 2): link(5, 2)}
    paths.write(tmp_path / "links.npz", links)
    back = paths.read(tmp_path / "links.npz")
    assert back.keys() == links.keys()
    for pair, expected in links.items():
        for name in ("time_s", "delay_s", "rate_before", "rate_after", "gain"):
            np.testing.assert_array_equal(getattr(back[pair], name), getattr(expected, name))
    (tmp_path / "links.npz").write_bytes(b"junk")
    with pytest.raises(CastError, match="links.npz"):
        paths.read(tmp_path / "links.npz")


def test_errors_are_those_over_the_band_that_the_taps_were_fitted_to(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    sc.save("own.zarr", replace(sc.load("four_tap"), bandwidth_hz=20e6))
    for options, says in (([], "over 20 MHz"), (["--band", "40e6"], "over 40 MHz")):
        assert cast_scenario.main(["validate", "own.zarr", "--links", "1", *options]) == 0
        assert says in capsys.readouterr().out


def test_the_exit_status_says_whether_the_limits_hold(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    assert cast_scenario.main(["validate", "four_tap", "--links", "1"]) == 0
    out = capfd.readouterr().out
    assert "over 80 MHz" in out and "1 of 1 soundings agree" in out
    assert ":info:" not in out  # GNU Radio's own lines stay out of the table
    assert (tmp_path / "four_tap-path-loss.png").read_bytes().startswith(b"\x89PNG")
    sc.save("static.mat", sc.load("1009"), form="static")  # taps at 1 ns, which the hardware plays at 0
    assert cast_scenario.main(["validate", "static.mat", "--links", "1"]) == 0
    monkeypatch.setattr(validation, "MAX_SIGMA", 1e-6)
    assert cast_scenario.main(["validate", "four_tap", "--links", "1"]) == 1
    with pytest.raises(CastError, match="1>9"):
        cast_scenario.main(["validate", "four_tap", "--link", "1>9"])
