# SPDX-License-Identifier: GPL-3.0-or-later
"""A recording for the vault is predicted by what `twin_corrected.yaml` says, however long it is."""

import numpy as np
import pytest
import yaml
from conftest_world import COUNT, RATE_HZ
from gr_cast.diagnose import diagnose, read_case, write
from gr_cast.diagnose.run import predict_only
from gr_cast.report.link.page import render
from gr_cast.signals import recording


def _decaying(world, count, decay_samples=1500.0):
    """What a receiver whose DC decays records, so many samples long."""
    n = np.arange(count)
    clean = 0.3 * np.exp(0.4j) * sum(a * world.x[(n - d - 37) % len(world.x)] for d, a in world.taps)
    noise = world.noise_rms / np.sqrt(2) * (world.rng.normal(size=count) + 1j * world.rng.normal(size=count))
    return clean + 0.1 * np.exp(-n / decay_samples) + noise


def test_the_figure_of_a_longer_vault_is_that_of_the_corrected_twin(world, tmp_path):
    folder = world.write(tmp_path / "case", _decaying(world, COUNT))
    recording.write(folder / "vault", _decaying(world, 2 * COUNT), sample_rate_hz=RATE_HZ, center_frequency_hz=1e9)
    twin = world.twin()
    twin["recordings"].append({**twin["recordings"][0], "file": "vault", "use": "vault"})
    (folder / "twin.yaml").write_text(yaml.safe_dump(twin))
    diagnosis = diagnose(read_case(folder))
    assert [e["family"] for e in diagnosis.document["effects"]] == ["dc_offset"]
    write(diagnosis, tmp_path / "out", render(diagnosis))
    (folder / "twin.yaml").write_text((tmp_path / "out" / "twin_corrected.yaml").read_text())
    corrected = read_case(folder)
    vault = next(o for o in corrected.observations if o.vault)
    again, *_ = predict_only(corrected, vault, [], diagnosis.findings)
    told_db = diagnosis.document["fit"]["corrected_nmse_db"]
    assert told_db == pytest.approx(10 * np.log10(again), abs=1e-4)
    assert told_db == pytest.approx(diagnosis.document["fit"]["noise_floor_db"], abs=0.1)
