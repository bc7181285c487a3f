# SPDX-License-Identifier: GPL-3.0-or-later
"""A batch that is killed anywhere ends, run again, in the same samples to the last bit, and never in another run's."""

import os
import re
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gr_cast import scenario as sc
from gr_cast.blocks import batch
from gr_cast.core.errors import CastError
from gr_cast.core.files import locked
from gr_cast.emulation.gpu.device import open_device
from gr_cast.signals import recording

RATE_HZ = 1e6
SCENARIO = "cast_scenario: 1\nnodes: [a, b]\nlinks:\n  - {tx: a, rx: b, taps: [{delay_s: 3.0e-6, gain_db: -3}]}\n"


class Killed(BaseException):
    pass


@pytest.fixture
def job(tmp_path):
    """run(folder, **changes): the batch of one recording through a scenario."""
    (tmp_path / "s.yaml").write_text(SCENARIO)
    rng = np.random.default_rng(3)
    recording.write(tmp_path / "x", (rng.normal(size=(5000, 2)) @ [1, 1j]).astype(np.complex64), sample_rate_hz=RATE_HZ)
    scenario = sc.load(tmp_path / "s.yaml")
    told = {"chunk_samples": 1700, "noise_power": 0.1, "seed": 5}
    return lambda folder, **more: batch.run_batch(scenario, {"a": str(tmp_path / "x")}, folder, **told | more)


def samples(folder):
    return [recording.read(folder / node).samples.tobytes() for node in "ab"]


def killed_at(monkeypatch, step: int) -> None:
    """Have the process die before its `step`-th change of the file system."""
    count = [0]

    def dying(module, name):
        real = getattr(module, name)

        def call(*arguments, **more):
            count[0] += 1
            if count[0] == step:
                raise Killed
            return real(*arguments, **more)

        monkeypatch.setattr(module, name, call)

    for module, names in ((os, ["replace", "fsync"]), (Path, ["unlink", "touch", "mkdir", "rmdir"]), (shutil, ["rmtree"])):
        for name in names:
            dying(module, name)


def test_a_run_that_dies_at_any_step_ends_bit_identical_when_run_again(job, tmp_path, monkeypatch):
    job(tmp_path / "whole")
    for step in range(1, 60):
        folder = tmp_path / f"killed-{step}"
        try:
            with monkeypatch.context() as patch:
                killed_at(patch, step)
                job(folder)
            died = False
        except Killed:
            died = True
            if not (folder / ".batch" / "plan.json").exists() and (folder / "b.sigmf-meta").exists():
                with pytest.raises(CastError, match="exists"):
                    job(folder)
            else:
                job(folder)
        assert samples(folder) == samples(tmp_path / "whole"), step
        assert {path.name for path in folder.iterdir()} == {f"{n}.sigmf-{kind}" for n in "ab" for kind in ("data", "meta")}
        if not died:
            break
    assert step > 15 and not died


def test_what_a_killed_run_leaves_never_ends_in_another_runs_recordings(job, tmp_path, monkeypatch):
    job(tmp_path / "other", seed=6)
    for step in range(1, 60):
        folder = tmp_path / f"killed-{step}"
        try:
            with monkeypatch.context() as patch:
                killed_at(patch, step)
                job(folder)
            break
        except Killed:
            try:
                job(folder, seed=6)
                assert samples(folder) == samples(tmp_path / "other"), step
            except CastError as refused:
                assert "other inputs" in str(refused) or "exists" in str(refused)


def test_two_runs_in_one_folder_do_not_meet(job, tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    with locked(folder), pytest.raises(CastError, match="another run is at work"):
        job(folder)
    job(folder)


def test_what_does_not_fit_on_the_disk_is_refused_and_what_fits_announced(job, tmp_path, monkeypatch):
    told = []
    job(tmp_path / "out", report=told.append)
    assert told == [f"2 recordings of 5000 samples, 0.08 MB, in {tmp_path}/out"]
    monkeypatch.setattr(batch.shutil, "disk_usage", lambda folder: SimpleNamespace(free=79_999))
    with pytest.raises(CastError, match="2 recordings of 5000 samples need 0.08 MB, 0.08 MB free"):
        job(tmp_path / "more")
    assert not (tmp_path / "more" / ".batch").exists()


def test_a_run_that_is_interrupted_says_what_it_keeps(job, tmp_path, monkeypatch):
    told = []
    killed_at(monkeypatch, 7)
    with pytest.raises(Killed):
        job(tmp_path / "out", report=told.append)
    assert re.fullmatch(r"[0-2] of 3 chunks are kept in .*/out/\.batch: the same command goes on there", told[-1])


def test_an_input_is_read_once_to_be_checked(job, tmp_path, monkeypatch):
    hashed, real = [], recording.sha512_of
    monkeypatch.setattr(recording, "sha512_of", lambda path: hashed.append(Path(path).name) or real(path))
    job(tmp_path / "out", chunk_samples=100)
    assert hashed.count("x.sigmf-data") == 1


def test_a_device_makes_what_the_processor_makes_and_tells_how(job, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    told = []
    job(tmp_path / "processor")
    job(tmp_path / "device", device="numpy", report=told.append)
    wanted, got = (recording.read(tmp_path / where / "b").samples for where in ("processor", "device"))
    assert np.abs(got - wanted).max() < 1e-5 and "MS/s per node, best of" in told[0]


def test_without_a_card_nothing_is_written_but_where_the_processor_may_go_on(job, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "cupy", None)
    open_device.cache_clear()
    told = []
    with pytest.raises(CastError, match="CuPy is not in this Python"):
        job(tmp_path / "none", device="cuda")
    assert not (tmp_path / "none").exists()
    job(tmp_path / "auto", device="auto", report=told.append)
    job(tmp_path / "processor")
    assert samples(tmp_path / "auto") == samples(tmp_path / "processor") and "going on with the processor" in told[0]
