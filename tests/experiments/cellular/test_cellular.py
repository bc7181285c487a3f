# SPDX-License-Identifier: GPL-3.0-or-later
"""The modelled downlink against closed forms, through the emulator and the sounder."""

import json

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.blocks.network import play
from gr_cast.core.errors import CastError
from gr_cast.experiments.cellular import adaptation, experiment, sources
from gr_cast.experiments.cellular.downlink import Cell, Downlink, Radio, play_reference
from gr_cast.scenario.create import room
from gr_cast.scenario.create.spec import read as read_spec

RADIO = Radio(blocks=15, tx_power_dbm=20.0, noise_figure_db=5.0)
THERMAL_DBM = -174 + 10 * np.log10(15 * 12 * 15e3) + 5  # over the occupied band


def static(links, base_loss_db=100.0):
    """A scenario of links (tx, rx) -> [(delay_s, gain), …]."""
    return sc.Scenario(
        name="test", nodes=tuple(dict.fromkeys(node for key in links for node in key)), base_loss_db=base_loss_db,
        links={key: sc.LinkTaps(delay_s=[[d for d, _ in taps]], gain=[[g for _, g in taps]]) for key, taps in links.items()},
    )  # fmt: skip


def db(ratio):
    return 10 * np.log10(ratio)


@pytest.mark.parametrize("player", [play, play_reference])
@pytest.mark.parametrize("loss_db", [90.0, 110.0, 128.0])
def test_single_tap_in_white_noise_has_the_sinr_of_the_link_budget(player, loss_db):
    cells = [Cell(station="a", terminals=("b",))]
    sinr = Downlink(static({("a", "b"): [(0.0, 1.0)]}, loss_db), cells, RADIO, player).sinr(0.0)["b"]
    # The noise estimate is of 20 periods of 256 samples: 0.06 dB.
    assert abs(db(sinr.mean()) - (20 - loss_db - THERMAL_DBM)) < 0.25


def test_two_taps_shape_the_sinr_over_frequency():
    second_s, second = 0.4e-6, 0.7j
    cells = [Cell(station="a", terminals=("b",))]
    downlink = Downlink(static({("a", "b"): [(0.0, 1.0), (second_s, second)]}, 80.0), cells, RADIO, play)
    sinr = downlink.sinr(0.0)["b"]
    frequency_hz = RADIO.subcarriers * 15e3
    expected = np.abs(1 + second * np.exp(-2j * np.pi * frequency_hz * second_s)) ** 2 * 10 ** ((20 - 80 - THERMAL_DBM) / 10)
    assert np.ptp(db(expected)) > 10
    np.testing.assert_allclose(db(sinr), db(expected), atol=0.3)


def test_interference_of_other_stations_adds_to_the_noise():
    links = {("a", "u"): [(0.0, 1.0)], ("b", "u"): [(1e-7, 0.5)], ("a", "v"): [(0.0, 0.25)], ("b", "v"): [(0.0, 0.6j)]}
    cells = [Cell(station="a", terminals=("u",)), Cell(station="b", terminals=("v",))]
    downlink = Downlink(static(links, 95.0), cells, RADIO, play)
    noise = 10 ** ((THERMAL_DBM - 20 + 95.0) / 10)
    sinr = downlink.sinr(0.0)
    assert abs(db(sinr["u"].mean()) - db(1.0 / (0.25 + noise))) < 0.25
    assert abs(db(sinr["v"].mean()) - db(0.36 / (0.0625 + noise))) < 0.25
    for measured_db, summed_db in downlink.superposition(0.0).values():
        # The sum that arrives, measured on other samples with everybody on the air.
        assert abs(measured_db - summed_db) < 0.3
    alone = Downlink(static({("a", "u"): links["a", "u"]}, 95.0), cells[:1], RADIO, play).sinr(0.0)["u"]
    assert db(alone.mean()) > db(sinr["u"].mean()) + 10


def test_a_terminal_that_hears_nothing_of_its_station_has_no_figure_and_a_reason():
    cells = [Cell(station="a", terminals=("u", "v"))]
    faint = {"u": np.zeros(180), "v": np.full(180, 100.0)}
    run = experiment.course("test", cells, RADIO, np.arange(4) * 0.1, [faint, faint | {"u": np.ones(180)}, faint, faint], 5e6)
    never = experiment.course("test", cells, RADIO, np.arange(2) * 0.1, [faint, faint], 5e6)
    u, v = experiment.summary(run, 5e6)
    assert (u["sinr_db_mean"], u["reason"]) == (0.0, "nothing of its station was heard at 3 of 4 instants")
    assert (v["sinr_db_mean"], v["reason"]) == (20.0, None)
    assert experiment.summary(never, 5e6)[0]["sinr_db_min"] is None
    rows = {(row["terminal"], row["quantity"]): row for row in experiment.similarities(run, run)}
    assert rows["u", "sinr_db"]["rho"] is None and "3 of 4" in rows["u", "sinr_db"]["reason"]
    assert rows["v", "sinr_db"]["reason"] is None and rows["v", "sinr_db"]["bias"] == 0
    json.dumps([u, v, *experiment.summary(never, 5e6), *rows.values()], allow_nan=False)


def test_cqi_and_rate_at_the_points_of_the_table():
    for index, needed_db in enumerate(adaptation.NEEDED_SINR_DB, 1):
        flat = np.full(72, 10 ** (needed_db / 10))
        assert adaptation.cqi(flat * 1.001) == index
        assert adaptation.cqi(flat * 0.999) == index - 1
    # TS 36.213, table 7.2.3-1: code rates in 1024ths and bits per symbol.
    code_rates = [78, 120, 193, 308, 449, 602, 378, 490, 616, 466, 567, 666, 772, 873, 948]
    bits = [2] * 6 + [4] * 3 + [6] * 6
    np.testing.assert_allclose(adaptation.EFFICIENCY[1:], np.array(code_rates) * bits / 1024, atol=5e-5)
    assert adaptation.rate_bps(15, 50) == pytest.approx(0.9 * 50 * 126e3 * 6 * 948 / 1024, rel=1e-5)
    assert adaptation.rate_bps(0, 50) == 0


def test_effective_sinr_is_the_flat_one_and_leans_to_the_weak():
    assert adaptation.effective_sinr_db(np.full(10, 3.0), 1.6) == pytest.approx(db(3.0))
    two = np.array([1.0, 9.0])
    assert adaptation.effective_sinr_db(two, 1.4) == pytest.approx(db(-1.4 * np.log((np.exp(-1 / 1.4) + np.exp(-9 / 1.4)) / 2)))
    assert adaptation.effective_sinr_db(two, 1e6) == pytest.approx(db(5.0), abs=1e-3)  # the mean
    assert np.isfinite(adaptation.effective_sinr_db(np.array([1e4, 2e4]), 1.0))


def test_air_time_is_shared_alike_and_what_is_left_goes_to_those_who_need_it():
    demand, rate = np.array([1e6, 20e6, 20e6, 5e6]), np.array([10e6, 10e6, 30e6, 0.0])
    got = sources.delivered_bps(demand, rate)
    np.testing.assert_allclose(got, [1e6, 4.5e6, 13.5e6, 0.0])  # 0.1 of the time, then 0.45 each; nobody without a rate
    np.testing.assert_allclose(sources.delivered_bps(np.full(2, 1e6), np.full(2, 1e7)), [1e6, 1e6])


@pytest.mark.parametrize(("buffer_round_trips", "share"), [(0.0, 0.75), (1.0, 1.0)])
def test_tcp_fills_a_link_as_the_sawtooth_says(buffer_round_trips, share):
    rate_bps, round_trip_s = 10e6, 0.04
    got = sources.tcp(
        np.full((600, 1), rate_bps), 0.1, 1e9, buffer_bits=buffer_round_trips * rate_bps * round_trip_s,
        round_trip_s=round_trip_s,
    )  # fmt: skip
    # Without a buffer the window goes from half the bandwidth-delay product to all of it; with one of that size it never idles.
    assert got[200:].mean() / rate_bps == pytest.approx(share, abs=0.03)


def test_tcp_and_udp_carry_what_is_offered_where_there_is_room():
    rates = np.full((100, 1), 20e6)
    assert sources.udp(rates, 5e6).mean() == 5e6
    assert sources.tcp(rates, 0.1, 5e6)[20:].mean() == pytest.approx(5e6, rel=0.01)
    assert sources.udp(rates / 10, 5e6).mean() == 2e6


@pytest.fixture(scope="module")
def arena():
    return read_spec(sc.examples_folder() / "arena.yaml")


@pytest.mark.parametrize("four_taps", [False, True])
def test_the_walking_terminal_gains_and_loses_as_it_passes(arena, four_taps):
    pairs = [("c12", name) for name in ("s2", "s5", "m1")]
    place = room.scenario(arena, pairs, 14.0, four_taps=four_taps)
    place = sc.with_base_loss(place, place.base_loss_db + 57.55)
    cells, radio = experiment.parse_cells(["12:34,37,41"], tuple(node.name for node in arena.nodes)), Radio(blocks=15)
    time_s = np.concatenate([start + np.arange(5) * 0.13 for start in (0.0, 5.9, 13.3)])
    sinrs = list(experiment.sinr_over_time(Downlink(place, cells, radio, play), time_s))
    run = experiment.course("test", cells, radio, np.arange(15) * 0.1, sinrs, 2.5e6)
    first, passing, last = np.split(np.arange(15), 3)
    walker = run.terminals.index("m1")
    for quantity, rise in (("sinr_db", 5.0), ("udp_bps", 0.4e6)):
        value = getattr(run, quantity)[:, walker]
        assert value[passing].mean() > max(value[first].mean(), value[last].mean()) + rise
    assert np.ptp(run.sinr_db[:, 0]) < 1.0  # the one that stands


def test_who_stands_has_the_same_sinr_at_every_instant_but_for_noise(arena):
    """Noise scatters the estimate by 0.06 dB. At 0.5 s the sounder takes it for movement, and its response has no phase."""
    nodes = ("s2", "s5", "m1")
    place = room.scenario(arena, [("c12", node) for node in nodes], 1.0, four_taps=False)
    cells = [Cell(station="c12", terminals=nodes)]
    downlink = Downlink(sc.with_more_loss(place, 57.55), cells, Radio(tx_power_dbm=27.0), play, seed=1)
    before, after = (downlink.sinr(at_s)["s5"].mean() for at_s in (0.4, 0.5))
    assert abs(db(after / before)) < 0.3


def test_cells_are_named_by_number_or_name_and_refused_with_reason():
    nodes = ("c1", "c2", "s1")
    assert experiment.parse_cells(["1:3"], nodes) == [Cell(station="c1", terminals=("s1",))]
    assert experiment.parse_cells(["c2:s1,1"], nodes) == [Cell(station="c2", terminals=("s1", "c1"))]
    for bad in ("1", "1:", "4:1", "x:1", "1:1", "1:0"):
        with pytest.raises(CastError):
            experiment.parse_cells([bad], nodes)
    with pytest.raises(CastError, match="no link a>c"):
        Downlink(static({("a", "b"): [(0.0, 1.0)]}), [Cell(station="a", terminals=("c",))], RADIO, play)


def test_cells_that_are_suggested_are_of_nodes_that_hear_their_station_and_are_read_as_they_stand():
    heard = {"bs": ["car", "bike", "tram", "van"], "car": ["bs"], "rsu": ["van", "bus", "car"]}
    scenario = static({(a, b): [(0.0, 1.0)] for a, others in heard.items() for b in others})
    cells = experiment.parse_cells(experiment.suggested_cells(scenario, 2), scenario.nodes)
    assert [cell.station for cell in cells] == ["bs", "rsu"]
    assert all((cell.station, node) in scenario.links for cell in cells for node in cell.terminals)
    assert [len(cell.terminals) for cell in cells] == [3, 1 + ("van" not in cells[0].terminals)]
    with pytest.raises(CastError, match="no links for 2 stations"):
        experiment.suggested_cells(static({("a", "b"): [(0.0, 1.0)]}), 2)
