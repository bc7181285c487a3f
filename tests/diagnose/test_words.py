# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers in sentences have the digits that their errors allow, and nothing is said of what a recording cannot show."""

import pytest
from gr_cast.diagnose.verdict import Words
from gr_cast.twin.effects import FAMILIES, Role, with_role


@pytest.mark.parametrize("drift", [0.0, -0.0])
def test_a_drift_that_a_short_recording_cannot_show_is_not_told(drift):
    words = Words({"offset_hz": {"value": 210.3, "std": 0.41}, "drift_hz_per_s": {"value": drift, "std": 0.0}}, {})
    sentence = FAMILIES[with_role(Role.CARRIER).name].describe(words)
    assert "drift" not in sentence and "210.30 ± 0.41 Hz" in sentence


@pytest.mark.parametrize(("value", "std", "text"), [
    (1.2345678, 0.034, "1.235 ± 0.034 dB"),
    (-14.31, 1.7, "-14.3 ± 1.7 dB"),
    (3.0, 0.0, "3 dB"),
])  # fmt: skip
def test_a_number_has_two_digits_of_its_error(value, std, text):
    assert Words({"gain_db": {"value": value, "std": std}}, {})("gain_db") == text
