# SPDX-License-Identifier: GPL-3.0-or-later
import json

import numpy as np
import pytest
from gr_cast.comparing import responses
from gr_cast.core.errors import CastError


def response(*taps, name="r"):
    return responses.Response(name=name, delay_s=[t[0] * 1e-9 for t in taps], gain_db=[t[1] for t in taps])


def test_two_equal_taps_spread_half_their_distance_and_add_up():
    r = response((0, -10), (800, -10))
    assert r.delay_spread_s == pytest.approx(400e-9)
    assert r.k_factor_db == pytest.approx(0)
    assert r.path_gain_db == pytest.approx(-10 + 10 * np.log10(2))


def test_one_tap_has_no_spread_and_no_k_factor():
    r = response((130, -43))
    assert (r.delay_spread_s, r.k_factor_db, r.path_gain_db) == (0, None, pytest.approx(-43))


def test_k_factor_is_the_strongest_tap_over_all_others():
    assert response((0, -20), (10, 0), (20, -20)).k_factor_db == pytest.approx(20 - 10 * np.log10(2))


def test_a_response_equals_itself():
    r = response((0, -3), (1280, -20), (2000, -15), (4000, -8))
    found = responses.compare_responses(r, r, 1e-9)
    document = responses.as_document(found)
    assert found.only_a == found.only_b == () and len(found.pairs) == 4
    assert all(tap["gain_error_db"] == tap["delay_error_s"] == 0 for tap in document["taps"])
    assert document["path_loss_db"]["error"] == 0


def test_a_tap_left_out_is_named_and_the_others_keep_their_partners():
    a = response((0, 0), (100, -6), (130, -9))
    b = response((4, -1), (132, -9.5))
    document = responses.as_document(responses.compare_responses(a, b, 20e-9))
    assert [tap["delay_s"] for tap in document["only_a"]] == [pytest.approx(100e-9)] and document["only_b"] == []
    assert [tap["gain_error_db"] for tap in document["taps"]] == [pytest.approx(-1), pytest.approx(-0.5)]
    assert [tap["delay_error_s"] for tap in document["taps"]] == [pytest.approx(4e-9), pytest.approx(2e-9)]
    lost = 10 * np.log10((1 + 10**-0.6 + 10**-0.9) / (10**-0.1 + 10**-0.95))
    assert document["path_loss_db"]["error"] == pytest.approx(lost)


def test_no_tap_has_two_partners_and_as_many_pairs_as_possible_are_made():
    found = responses.compare_responses(response((0, 0), (10, 0)), response((9, 0), (25, 0)), 15e-9)
    assert found.pairs.tolist() == [[0, 0], [1, 1]]


def test_between_taps_equally_near_the_gain_decides():
    found = responses.compare_responses(response((100, -10)), response((90, 0), (110, -10)), 20e-9)
    assert found.pairs.tolist() == [[0, 1]]


@pytest.mark.parametrize("taps", [[], [(np.nan, 0)], [(0, np.inf)]])
def test_what_is_no_response_is_refused(taps):
    with pytest.raises(CastError):
        response(*taps)


@pytest.mark.parametrize("tolerance_s", [0, -1e-9, np.nan])
def test_a_tolerance_without_meaning_is_refused(tolerance_s):
    with pytest.raises(CastError, match="tolerance"):
        responses.compare_responses(response((0, 0)), response((0, 0)), tolerance_s)


def test_the_table_and_the_document_tell_every_tap_of_both():
    a = response((0, 0), (100, -6), (130, -9), name="first")
    b = response((4, -1), (132, -9.5), (700, -20), name="second")
    document = responses.as_document(responses.compare_responses(a, b, 20e-9))
    told = [(tap["a"]["gain_db"], tap["b"]["gain_db"]) for tap in document["taps"]]
    assert told == [(0, -1), (-9, -9.5)] and (document["a"], document["b"]) == ("first", "second")
    assert (document["cast_comparison"], document["kind"], document["tolerance_s"]) == (1, "cir", 20e-9)
    lines = responses.as_table(document).split("\n")
    assert "only in A: 0.1000 µs, -6.00 dB" in lines and "only in B: 0.7000 µs, -20.00 dB" in lines
    assert lines[1].split() == ["0.0000", "0.00", "+4.0", "-1.00"]


def test_no_difference_in_the_table_is_minus_nought():
    document = responses.as_document(responses.compare_responses(response((4, 1)), response((3.99, 0.999)), 20e-9))
    assert document["taps"][0]["delay_error_s"] < 0 > document["taps"][0]["gain_error_db"]
    assert responses.as_table(document).split("\n")[1].split()[2:] == ["+0.0", "+0.00"]


def test_a_sounding_is_read_with_its_taps_and_what_is_none_is_left_to_others(tmp_path):
    taps = [{"delay_s": 1e-6, "gain_db": -3.0}, {"delay_s": 2e-6, "gain_db": -9.0}]
    path = tmp_path / "result.json"
    path.write_text(json.dumps({"cast_sounding": 1, "taps": taps}))
    for named in (path, tmp_path):
        found = responses.from_sounding(named)
        assert found.delay_s.tolist() == [1e-6, 2e-6] and found.gain_db.tolist() == [-3, -9]
    path.write_text(
        json.dumps({"cast_sounding": 1, "taps": [{"delay_s": 1e-6, "gain_db": "loud"}, {"delay_s": 1e-6, "gain_db": 1e9}]})
    )
    with pytest.raises(CastError) as refused:
        responses.from_sounding(path)
    assert len(refused.value.faults) == 2
    path.write_text(json.dumps({"taps": taps}))
    assert responses.from_sounding(path) is None and responses.from_sounding(tmp_path / "series.csv") is None


def test_a_tap_as_far_as_the_tolerance_has_a_partner_and_one_beyond_has_none():
    for far_ns, pairs in ((20, 1), (20.001, 0)):
        for base_ns in (0, 130, 4710):
            found = responses.compare_responses(response((base_ns, 0)), response((base_ns + far_ns, 0)), 20e-9)
            assert len(found.pairs) == pairs


def test_the_nearer_tap_is_the_partner_however_unlike_their_gains():
    found = responses.compare_responses(response((100, 0)), response((98, -60), (103, 0)), 20e-9)
    assert found.pairs.tolist() == [[0, 0]] and found.only_b == (1,)


@pytest.mark.parametrize(("delay_s", "gain_db", "faults"), [(1e6, -1e3, 0), (-1e6, 1e3, 0), (1e6 + 0.5, 0, 1), (0, 1000.5, 1)])
def test_numbers_of_a_sounding_are_read_up_to_their_limits(tmp_path, delay_s, gain_db, faults):
    path = tmp_path / "result.json"
    path.write_text(json.dumps({"cast_sounding": 1, "taps": [{"delay_s": delay_s, "gain_db": gain_db}]}))
    if not faults:
        found = responses.from_sounding(path)
        assert (found.delay_s[0], found.gain_db[0], found.name) == (delay_s, gain_db, str(path))
    else:
        with pytest.raises(CastError, match="needs a finite number of"):
            responses.from_sounding(path)


def test_a_sounding_of_another_version_or_without_a_list_of_taps_is_refused(tmp_path):
    path = tmp_path / "result.json"
    for wrong in ({"cast_sounding": 2, "taps": []}, {"cast_sounding": 1, "taps": 3}, {"cast_sounding": 1, "taps": [4]}):
        path.write_text(json.dumps(wrong))
        with pytest.raises(CastError):
            responses.from_sounding(path)
    path.write_text("no document at all")
    assert responses.from_sounding(path) is None


def test_the_table_tells_spread_k_factor_and_loss_of_both_and_a_dash_where_there_is_none():
    document = responses.as_document(responses.compare_responses(response((0, -10), (800, -10)), response((0, -30)), 20e-9))
    rows = [line.split() for line in responses.as_table(document).split("\n")[-3:]]
    assert rows[0] == ["delay", "spread", "A", "400.00", "B", "0.00", "ns"]
    assert rows[1] == ["K-factor", "A", "0.00", "B", "–", "dB"]
    assert rows[2] == ["loss,", "Σ|tap|²", "A", "6.99", "B", "30.00", "dB"]  # 10 − 10·lg 2
    assert document["path_loss_db"]["error"] == pytest.approx(30 - 10 + 10 * np.log10(2))


def test_as_many_delays_as_gains_make_a_response():
    for delay_s, gain_db in (([0.0, 1.0], [0.0]), (0.0, 0.0), ([[0.0]], [[0.0]])):
        with pytest.raises(CastError, match="one tap or more"):
            responses.Response(name="r", delay_s=delay_s, gain_db=gain_db)
