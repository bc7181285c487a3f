# SPDX-License-Identifier: GPL-3.0-or-later
"""The measurement on a card runs through where CuPy is stood in for: nobody has a second try at it."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from gr_cast.emulation.gpu import planner
from gr_cast.emulation.gpu.device import open_device
from gr_cast.emulation.gpu.form import Form

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "bench"))
import bench_gpu
import fake_cupy
import gpu_measures


@pytest.fixture(autouse=True)
def fresh():
    open_device.cache_clear()
    yield
    open_device.cache_clear()


@pytest.mark.parametrize(
    ("name", "form"),
    [
        ("4x1", dict(precision="fp16", n_bins=1024)),
        ("4x1 exact", dict(precision="split", n_bins=1024)),
        ("4x1", dict(method="direct")),
    ],
    ids=str,
)
@pytest.mark.parametrize("device", ["numpy", "cuda"])
def test_a_row_is_measured_and_what_it_computes_is_right(monkeypatch, tmp_path, device, name, form):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if device == "cuda":
        if shutil.which("g++") is None:
            pytest.skip("NO G++: CuPy is not stood in for")
        fake_cupy.install(monkeypatch)
    for name_of, few in (("TURNS", 1), ("FEWEST", 1), ("LATE", 6)):
        monkeypatch.setattr(gpu_measures, name_of, few)
    forms = [Form(n_inputs=4, n_outputs=4, n_taps=512, **form)]
    monkeypatch.setattr(planner, "candidates", lambda task, tiles: forms)
    monkeypatch.setattr(bench_gpu, "candidates", planner.candidates)
    row = bench_gpu.measure(name, device, 0.01)
    assert row["error_db"] < row["wanted"][2] and row["error_after_db"] < row["wanted"][2]
    assert all(0 < row[what] < np.inf for what in ("on_card", "with_transfers", "copies", "share_of_copies"))
    assert row["clipped"] == 0 and row["tables_share"] == 4 * 4 * 4 * 10 / (4 * 1000 * 4)
    assert set(row["parts_ms"]) == (set() if form.get("method") else {"taps", "forward", "product", "inverse"})
    assert bench_gpu.verdict(row) == "reached" and name in bench_gpu.line(name, row)
    row["wanted"] = [1e9, 1e9, -999]
    assert bench_gpu.verdict(row).count("<") == 2 and "error" in bench_gpu.verdict(row)


def test_a_row_that_fails_is_told_and_leaves_the_others(monkeypatch, capsys, tmp_path):
    asked, answers = [], iter([{"fault": "--device cuda: no card"}] * 2 + [{"fault": "not done in 150 s"}] * 2)
    monkeypatch.setattr(bench_gpu, "in_a_process", lambda arguments: asked.append(arguments) or next(answers))
    figures = tmp_path / "figures.json"
    assert bench_gpu.main(["--json", str(figures), "--rows", "4x1", "4x1 exact", "--no-laws"]) == 0
    assert [arguments[-2:] for arguments in asked[1::2]] == [["--only", "tf32"], ["--only", "fp32"]]
    assert "no card" in capsys.readouterr().out and "not done" in figures.read_text()
