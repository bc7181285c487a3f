# SPDX-License-Identifier: GPL-3.0-or-later
"""Arena and the street as the bench's tracer hears them: what is sounded where nothing is wrong is what the project foretells."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from gr_cast.diagnose.places.ears import ear
from gr_cast.twin.places import document
from gr_cast.twin.places.world import of_place

BENCH = Path(__file__).resolve().parents[1] / "bench"
sys.path[:0] = [str(BENCH / "places"), str(BENCH)]

import shipped  # noqa: E402
from diagnose_bank import truth  # noqa: E402


@pytest.mark.parametrize("what", ["arena_nothing", "street_nothing"])
def test_a_shipped_place_leaves_the_noise_alone_where_nothing_is_wrong(tmp_path, what):
    shipped.make(what, 1, tmp_path)
    place = document.read(tmp_path / "places" / f"{what}_1")
    for one in place.soundings:
        heard = ear(one, place.unknown, place.spec.bandwidth_hz)
        fit = heard.profiled(heard.predicted(of_place(place)))
        assert fit.energy - fit.offset < heard.count + 4 * np.sqrt(heard.count)


def test_every_cause_is_strong_and_the_seal_is_that_of_the_truths(tmp_path):
    shipped.make("arena_three", 3, tmp_path)
    effects = json.loads((tmp_path / "truth" / "arena_three_3.json").read_text())["effects"]
    assert sorted(e["family"] for e in effects) == ["material", "missing_object", "node_position"]
    assert min(e["lambda"] for e in effects) >= 100
    offset = next(e for e in effects if e["family"] == "node_position")["parameters"]["offset_m"]["value"]
    assert np.hypot(*offset[:2]) == pytest.approx(0.4)
    truth.seal(tmp_path / "truth")
    assert truth.sealed(tmp_path / "truth")
