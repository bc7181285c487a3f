# SPDX-License-Identifier: GPL-3.0-or-later
import subprocess
import sys
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


def test_the_exit_status_says_whether_the_limits_hold(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = [sys.executable, cast_scenario.__file__, "validate", "four_tap", "--links", "1"]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "over 80 MHz" in out and "1 of 1 soundings agree" in out
    assert ":info:" not in out  # GNU Radio's own lines stay out of the table
    assert (tmp_path / "four_tap-path-loss.png").read_bytes().startswith(b"\x89PNG")
    sc.save("static.mat", sc.load("1009"), form="static")  # taps at 1 ns, which the hardware plays at 0
    assert cast_scenario.main(["validate", "static.mat", "--links", "1"]) == 0
    monkeypatch.setattr(validation, "MAX_SIGMA", 1e-6)
    assert cast_scenario.main(["validate", "four_tap", "--links", "1"]) == 1
    with pytest.raises(CastError, match="1>9"):
        cast_scenario.main(["validate", "four_tap", "--link", "1>9"])


def heard_with(taps, silent=False):
    """What a sounding finds where the emulator plays `taps` (delay in 5 ns samples, gain), or nothing but noise."""
    rng = np.random.default_rng(4)

    def play(frozen, samples, rate):
        if silent:
            return 1e-3 * (rng.normal(size=len(samples)) + 1j * rng.normal(size=len(samples)))
        return sum(gain * np.concatenate([np.zeros(late), samples])[: len(samples)] for late, gain in taps)

    return play


@pytest.mark.parametrize(
    ("played", "missed", "extra"),
    [
        ([(0, 1.0), (200, 0.5)], 0, 0),
        ([(0, 1.0)], 1, 0),
        ([(0, 1.0), (200, 0.5), (300, 0.3)], 0, 1),
        ([(1, 1.0), (200, 0.5)], 1, 1),  # a sample off is another tap
        ([(0, 1.0), (201, 0.5)], 1, 1),
    ],
)
def test_taps_that_are_not_heard_and_taps_that_are_none_are_counted(played, missed, extra):
    found = validation.check_link(one_link([0, 100], [1.0, 0.5]), LINK, 0.0, play=heard_with(played))
    assert (found.missed, found.extra, found.found) == (missed, extra, len(played))
    assert found.holds == (missed == extra == 0)


def test_where_nothing_is_played_every_tap_is_missed():
    found = validation.check_link(one_link([0, 100], [1.0, 0.5]), LINK, 0.0, play=heard_with([], silent=True))
    assert (found.missed, found.extra, found.found, found.worst_sigma) == (2, 0, 0, 0) and not found.holds


def test_a_tap_below_what_can_be_heard_is_not_missed():
    found = validation.check_link(one_link([0, 100], [1.0, 1e-4]), LINK, 0.0)
    assert (found.taps, found.found, found.missed) == (2, 1, 0) and found.holds


@pytest.mark.parametrize(("worst", "holds"), [(5.0, True), (5.01, False)])
def test_a_deviation_of_five_sigma_holds_and_more_does_not(worst, holds):
    found = validation.check_link(one_link([0], [1.0]), LINK, 0.0)
    assert replace(found, worst_sigma=worst).holds == holds


def test_the_worst_deviation_is_that_of_delay_or_gain_in_its_own_sigma():
    found = validation._sounded(one_link([0, 100], [1.0, 0.5]), heard_with([(0, 1.0), (200, 0.5)]), 1)
    taps = found.taps
    delay_s = taps.delay_samples / validation.SAMPLE_RATE_HZ
    for tap in (0, 1):
        moved = delay_s.copy()
        moved[tap] += 7 * taps.delay_std_samples[tap] / validation.SAMPLE_RATE_HZ
        assert validation._deviations(found, moved, np.sqrt(taps.power))[2] == pytest.approx(7, rel=1e-6)
        louder = np.sqrt(taps.power)
        louder[tap] *= 10 ** (8 * taps.gain_std_db[tap] / 20)
        missed, extra, worst = validation._deviations(found, delay_s, louder)
        assert (missed, extra) == (0, 0) and worst == pytest.approx(8, rel=1e-6)


@pytest.mark.parametrize(
    ("count", "moving", "static"),
    [(1, 0, 1), (2, 1, 1), (3, 1, 2), (4, 2, 2), (10, 7, 3), (7, 4, 3), (99, 8, 3)],
)
def test_half_of_the_links_looked_at_move_where_there_are_as_many(count, moving, static):
    turning = sc.LinkTaps(delay_s=np.zeros((2, 1)), gain=np.array([[1.0], [1j]]))
    still = one_link([0], [1.0]).links[LINK]
    keys = [(str(a), "0") for a in range(1, 12)]
    links = {key: turning if k < 8 else still for k, key in enumerate(keys)}
    scenario = sc.Scenario(name="x", nodes=tuple(map(str, range(12))), links=links, time_s=np.arange(2.0))
    chosen = validation.chosen_links(scenario, count)
    assert len(set(chosen)) == len(chosen) == moving + static
    assert [links[key].is_static for key in chosen] == [False] * moving + [True] * static
    if moving > 1:
        assert chosen[0] == keys[0] and chosen[moving - 1] == keys[7]


def test_a_link_that_is_not_there_or_has_no_tap_then_is_refused():
    scenario = one_link([0], [0.0])
    with pytest.raises(CastError, match="link 1>2: has no taps at 0 s"):
        validation.check_link(scenario, LINK, 0.0)
    with pytest.raises(CastError, match="link 2>1: there is none"):
        validation.check_link(scenario, ("2", "1"), 0.0)


def test_delays_are_compared_where_the_hardware_has_them_on_10_ns():
    found = validation.check_link(one_link([100.4], [1.0]), LINK, 0.0)
    assert found.holds and found.found == 1
    found = validation.check_link(one_link([100.4], [1.0]), LINK, 0.0, play=heard_with([(200, 1.0)]))
    assert found.holds and not validation.check_link(one_link([100.6], [1.0]), LINK, 0.0, play=heard_with([(200, 1.0)])).holds


def test_moves_without_a_list_of_seconds_are_told_and_an_empty_one_moves_nothing(tmp_path):
    rng = np.random.default_rng(3)
    arrays = {name: np.zeros((1, 1)) for name in ("rate_before", "rate_after")}
    link = paths.LinkPaths(time_s=np.zeros(1), delay_s=np.array([[1e-7]]), gain=rng.normal(size=(1, 1)) + 0j, **arrays)
    paths.write(tmp_path / "links.npz", {(0, 1): link})
    scenario = sc.Scenario(name="x", nodes=("a", "b"), links={}, center_frequency_hz=1e9)
    for moves, says in (
        ([["a", "b", []]], None),
        ([["a", "b", [1e-8]]], None),
        ([["a", "b"]], "delays_moved_s"),
        ([7], "delays_"),
    ):
        about = {"paths_file": str(tmp_path / "links.npz"), "hold_s": 2.0, "delays_moved_s": moves}
        zarr_file.write(tmp_path / f"{len(list(tmp_path.iterdir()))}.zarr", scenario, **about)
        path = max(tmp_path.glob("*.zarr"), key=lambda p: int(p.stem))
        if says:
            with pytest.raises(CastError, match=says):
                validation.traced_rays(path, scenario)
        else:
            late_s = moves[0][2][0] if moves[0][2] else 0.0
            assert validation.traced_rays(path, scenario)(("b", "a"), 0.0)[0][0, 0] == pytest.approx(1e-7 + late_s, abs=1e-15)
