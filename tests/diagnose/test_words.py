# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers in sentences have the digits that their errors allow, and nothing is said of what a recording cannot show."""

import numpy as np
import pytest
from gr_cast.diagnose.verdict import Words
from gr_cast.twin.effects import FAMILIES, Role, with_role
from gr_cast.twin.places.families.base import Effect
from gr_cast.twin.places.families.mechanisms import ExcessLoss


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


BENT = {"value": 0.403, "std": 0.013}
OPENED = {"value": -0.561, "std": 0.039}
WIDER = {"value": -0.661, "std": 0.039}


@pytest.mark.parametrize(("compression", "said"), [
    (BENT, "0.403 ± 0.013 dB below"),
    (OPENED, "0.561 ± 0.039 dB above"),
    ({"per_recording": {"a": OPENED, "b": WIDER}}, "0.661 ± 0.039 dB to 0.561 ± 0.039 dB (by recording) above"),
    ({"per_recording": {"a": OPENED, "b": BENT}}, "-0.561 ± 0.039 dB to 0.403 ± 0.013 dB (by recording) below"),
])  # fmt: skip
def test_an_amplifier_that_expands_has_more_gain_and_not_less_than_nothing(compression, said):
    sentence = FAMILIES["pa_nonlinearity"].describe(Words({"compression_db": compression}, {}))
    assert f"largest amplitude is {said} small signal" in sentence


@pytest.mark.parametrize(("loss_db", "said"), [(0.98, "a>b loses 0.98 dB more than"), (-1.5, "a>b loses 1.50 dB less than")])
def test_a_link_loses_more_or_less(loss_db, said):
    assert said in ExcessLoss().sentence(Effect(family=ExcessLoss(), owner="a>b", values=np.array([loss_db])), {})
