# SPDX-License-Identifier: GPL-3.0-or-later
import json

import pytest
from gr_cast.core.errors import CastError
from gr_cast.sounding import calibration
from gr_cast.sounding.calibration import Calibration


@pytest.fixture(autouse=True)
def store(tmp_path, monkeypatch):
    monkeypatch.setenv("CAST_CALIBRATIONS", str(tmp_path))
    return tmp_path


def test_what_is_saved_is_loaded_by_name_and_by_version_and_no_version_is_overwritten(store):
    for version in range(1, 12):  # beyond 9: versions are numbers, not words
        made = Calibration(name="hall", base_loss_db={("a", "b"): 50.0 + version}, base_delay_s={("a", "b"): version * 1e-9})
        assert calibration.save(made, {"note": "x"}) == store / "hall" / f"v{version}.json"
    for version in range(1, 12):
        read = calibration.load(f"hall@{version}")
        assert (read.version, read.of(("a", "b")), read.base_delay_s) == (version, 50.0 + version, {("a", "b"): version * 1e-9})
    assert calibration.load("hall") == calibration.load("hall@11")


def test_a_number_is_the_loss_of_every_link():
    assert calibration.load("-3.5").of(("any", "other")) == -3.5
    with pytest.raises(CastError, match="finite"):
        calibration.load("inf")


def test_a_link_that_was_not_measured_has_no_loss():
    calibration.save(Calibration(name="hall", base_loss_db={("a", "b"): 1.0}), {})
    with pytest.raises(CastError, match="link b>a was not measured"):
        calibration.load("hall").of(("b", "a"))


@pytest.mark.parametrize(
    ("wanted", "says"),
    [
        ("house", "no calibration named 'house' .* known: hall"),
        ("../hall", "no calibration named"),
        ("hall@2", "no version '2', it has 1"),
        ("hall@x", "no version 'x', it has 1"),
    ],
)
def test_what_is_not_there_is_refused_with_what_is(wanted, says):
    calibration.save(Calibration(name="hall", base_loss_db={("a", "b"): 1.0}), {})
    with pytest.raises(CastError, match=says):
        calibration.load(wanted)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"cast_calibration": 2}, "cast_calibration"),
        ({"base_loss_db": {"ab": 1.0}}, "ab: needs the form TX>RX"),
        ({"base_loss_db": {"a>b>c": 1.0}}, "a>b>c: needs the form TX>RX"),
        ({"base_delay_s": {"a>b": "x"}}, "base_delay_s: a>b"),
        ({"name": None}, "name"),
    ],
)
def test_a_file_of_another_form_is_refused_with_its_place(changes, says):
    path = calibration.save(Calibration(name="hall", base_loss_db={("a", "b"): 1.0}), {})
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    with pytest.raises(CastError, match=says):
        calibration.load("hall")


def test_a_name_is_no_path(store):
    with pytest.raises(CastError, match="calibration name"):
        calibration.save(Calibration(name="../hall", base_loss_db={}), {})
    assert not list(store.parent.glob("hall"))


def test_a_file_says_what_it_is_its_links_in_order_and_what_else_is_known(store):
    losses_db = {("b", "a"): 2.0, ("a", "b"): 1.0}
    path = calibration.save(Calibration(name="hall", base_loss_db=losses_db), {"note": "x"})
    told = json.loads(path.read_text())
    assert told == {
        "cast_calibration": 1, "name": "hall", "version": 1, "note": "x", "base_loss_db": {"a>b": 1.0, "b>a": 2.0},
        "base_delay_s": {},
    }  # fmt: skip
    assert list(told["base_loss_db"]) == ["a>b", "b>a"]
    (store / "hall" / "vx.json").write_text("{}")  # none of its versions
    assert calibration.load("hall").version == 1
    del told["base_delay_s"]
    path.write_text(json.dumps(told))
    assert calibration.load("hall").base_delay_s == {}


def test_calibrations_live_in_the_users_data_where_nothing_else_is_said(tmp_path, monkeypatch):
    monkeypatch.delenv("CAST_CALIBRATIONS")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    assert calibration.store_folder() == tmp_path / "data/gr_cast/calibrations"
    monkeypatch.delenv("XDG_DATA_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert calibration.store_folder() == tmp_path / ".local/share/gr_cast/calibrations"
    with pytest.raises(CastError, match="known: none"):
        calibration.load("hall")


def test_a_default_stands_in_for_links_that_were_not_measured():
    some = Calibration(name="x", base_loss_db={("a", "b"): 1.0}, default_db=7.0)
    assert (some.of(("a", "b")), some.of(("b", "a")), some.version) == (1.0, 7.0, 0)
