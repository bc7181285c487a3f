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
