# SPDX-License-Identifier: GPL-3.0-or-later
"""Two frames of a real transponder (RTL-SDR) against what independent analysis found; all real recordings:
tests/bench/bench_real.py."""

import json
import shutil
import sys
from pathlib import Path

import pytest
import yaml
from gr_cast.diagnose import diagnose, read_case

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "bench"))

import bench_real

pytestmark = pytest.mark.timeout(300)


def test_frames_of_a_transponder_show_its_carrier_and_the_receivers_filter(cast_data, tmp_path):
    case = tmp_path / "adsb"
    shutil.copytree(cast_data / "real" / "adsb_modes1", case, copy_function=shutil.copyfile)
    case.chmod(0o755)
    twin = yaml.safe_load((case / "twin.yaml").read_text())
    twin["recordings"] = twin["recordings"][:2]
    (case / "twin.yaml").write_text(yaml.safe_dump(twin))
    truth = json.loads((cast_data / "real-truth" / "adsb_modes1.json").read_text())
    offsets = truth["must_find"][0]["per_recording"]
    for name in sorted(offsets)[2:]:
        del offsets[name]
    assert bench_real.judge(diagnose(read_case(case), budget_s=1000).document, truth) == []
