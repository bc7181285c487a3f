# SPDX-License-Identifier: GPL-3.0-or-later
"""Slips of units and signs in a case are said; what is as it should be is not."""

import numpy as np
import place_case
import pytest
from gr_cast.diagnose.places import mistakes, planes
from gr_cast.diagnose.places.ears import ear
from gr_cast.diagnose.places.fit import evaluated
from gr_cast.diagnose.places.view import View
from gr_cast.twin.places import document
from gr_cast.twin.places.believed import believed

NOISE = 1e-10
PLACE = place_case.PLACE.replace("unknown: {phase: link, delay: node}", "unknown: {phase: snapshot, delay: none}")


def _said(folder, *, turned=np.array, unit_hz=1.0, metre=1.0) -> list[str]:
    """Of the responses that the room itself would give, as a user may have them."""
    true = document.read(place_case.write(folder / "true", place=PLACE))
    clean = ear(true.soundings[0], true.unknown, true.spec.bandwidth_hz).predicted(believed(true))
    noise = np.sqrt(NOISE / 2) * np.random.default_rng(1).standard_normal((*clean.shape, 2)) @ [1, 1j]
    told = place_case.response() | {"response": turned(clean + noise).astype(np.complex64), "noise_power": np.full(2, NOISE)}
    told["frequency_hz"] = told["frequency_hz"] / unit_hz
    mesh = "\n".join(
        " ".join([line.split()[0], *(f"{float(x) * metre:g}" for x in line.split()[1:])]) if line.startswith("v") else line
        for line in place_case.MESH.splitlines()
    )
    place = document.read(place_case.write(folder / "case", place=PLACE, mesh=mesh + "\n", monday=told))
    ears = tuple(ear(one, place.unknown, place.spec.bandwidth_hz) for one in place.soundings if not one.vault)
    planes._imaged(View(ears, evaluated(ears, believed(place), ()), place.unknown))  # whatever the band
    return mistakes.of_units_and_signs(place, ears, believed(place))


def test_a_case_as_it_should_be_gets_no_word(tmp_path):
    assert not _said(tmp_path)


@pytest.mark.parametrize(
    ("slip", "word"),
    [(dict(unit_hz=1e6), "MHz"), (dict(unit_hz=1e3), "kHz"), (dict(metre=1e3), "in mm"), (dict(turned=np.conj), "conjugates")],
)
def test_a_slip_is_said(tmp_path, slip, word):
    assert any(word in sentence for sentence in _said(tmp_path, **slip))


def test_what_another_place_sends_is_not_taken_for_a_wrong_sign(tmp_path):
    assert not _said(tmp_path, turned=lambda y: np.random.default_rng(2).permutation(y.ravel()).reshape(y.shape))
