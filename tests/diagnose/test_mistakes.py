# SPDX-License-Identifier: GPL-3.0-or-later
"""Slips of units in a link's case are said; what is as it should be is not. Recordings are made on 1 GHz."""

import pytest
import yaml
from gr_cast.diagnose import diagnose, mistakes_of, read_case
from gr_cast.report.link.page import render


def told_otherwise(world, folder, carrier_hz):
    case = world.write(folder, world.noisy(world.clean()))
    twin = world.twin()
    twin["recordings"][0]["center_frequency_hz"] = carrier_hz
    (case / "twin.yaml").write_text(yaml.safe_dump(twin))
    return read_case(case)


@pytest.mark.parametrize(("carrier_hz", "is_said"), [(1e9, False), (1.0002e9, False), (None, False), (1.0, True), (5.4e9, True)])
def test_a_carrier_that_is_not_the_recordings_is_said(world, tmp_path, carrier_hz, is_said):
    said = mistakes_of(told_otherwise(world, tmp_path / "case", carrier_hz))
    assert [line.startswith("recording: recorded at 1e+09 Hz (core:frequency)") for line in said] == [True] * is_said


def test_it_stands_in_the_diagnosis_and_on_its_page(world, tmp_path):
    diagnosis = diagnose(told_otherwise(world, tmp_path / "case", 2.4))
    (said,) = diagnosis.document["warnings"]
    assert "center_frequency_hz of it is 2.4 Hz" in said and f"<p>{said.split(': is it')[0]}" in render(diagnosis).replace(
        "&#x27;", "'"
    )
