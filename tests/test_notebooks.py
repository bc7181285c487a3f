# SPDX-License-Identifier: GPL-3.0-or-later
"""The notebooks run from their first cell to their last, and find what is there; what they use is exported at the top."""

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path

import gr_cast
import numpy as np
import pytest

NOTEBOOKS = Path(__file__).resolve().parents[1] / "docs" / "notebooks"


def ran(name, folder, monkeypatch):
    """(names, what was printed) after every code cell of a notebook, run in a folder of its own."""
    monkeypatch.chdir(folder)
    cells = json.loads((NOTEBOOKS / f"{name}.ipynb").read_text())["cells"]
    names, printed = {}, io.StringIO()
    with contextlib.redirect_stdout(printed):
        for cell in cells:
            if cell["cell_type"] == "code":
                assert cell["outputs"] == [], "outputs are made when the documents are built"
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    return names, printed.getvalue()


def test_there_are_five_notebooks():
    assert sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb")) == ["colosseum", "diagnose", "place", "sound", "wifi"]


def test_sound_finds_the_four_taps(tmp_path, monkeypatch):
    names, printed = ran("sound", tmp_path, monkeypatch)
    taps = names["found"].taps
    assert np.diff(taps.delay_samples) / 50e6 == pytest.approx([1.28e-6, 0.72e-6, 2e-6], abs=5e-9)
    assert 10 * np.log10(taps.power) == pytest.approx([-3, -20, -15, -8], abs=0.2)
    assert "50000000.0 1 > 2 True" in printed


def test_place_finds_its_twin_alike(tmp_path, monkeypatch):
    names, _ = ran("place", tmp_path, monkeypatch)
    assert names["compared"].rho > 0.99 and np.abs(names["difference_db"]).mean() < 0.5


def test_diagnose_finds_the_echo_where_it_was_put(tmp_path, monkeypatch):
    names, _ = ran("diagnose", tmp_path, monkeypatch)
    document = names["found"].document
    (effect,) = document["effects"]
    assert (document["verdict"], effect["family"]) == ("identified", "extra_path")
    assert effect["parameters"]["gain_db"]["value"] == pytest.approx(-14, abs=0.2)


def test_wifi_sees_the_jammer_when_it_is_on(tmp_path, monkeypatch):
    names, _ = ran("wifi", tmp_path, monkeypatch)
    sinr_db, on = names["sinr_db"], names["on"]
    assert sinr_db[~on].mean() == pytest.approx(26, abs=1) and sinr_db[on].mean() < 10
    assert names["jamming"].interval_of_harm(names["times_s"], sinr_db) == pytest.approx((10, 20), abs=0.5)


def test_colosseum_gives_back_what_it_was_given(tmp_path, monkeypatch):
    _, printed = ran("colosseum", tmp_path, monkeypatch)
    assert printed.count("True True") == 2 and "[  0 128 200 400]" in printed
    assert not (tmp_path / "loud.mat").exists() and "loud.mat" in printed


def test_everything_at_the_top_is_there_and_nothing_is_loaded_before_it_is_asked_for():
    assert all(getattr(gr_cast, name) is not None for name in gr_cast.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        gr_cast.nothing  # noqa: B018
    code = "import sys, gr_cast; sys.exit(bool({'numpy', 'scipy', 'yaml', 'gnuradio'} & set(sys.modules)))"
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": ":".join(sys.path)})


def test_a_recording_that_is_written_is_read_as_it_was(tmp_path):
    samples = np.array([0.5, -0.25j, 1], np.complex64)
    was = gr_cast.Recording(
        samples=samples, sample_rate_hz=1e6, center_frequency_hz=2e9, metadata={"cast:transmitter": "a"},
        annotations=({"core:sample_start": 1, "core:sample_count": 1},),
    )  # fmt: skip
    now = gr_cast.read(gr_cast.write(tmp_path / "again", was))
    assert np.array_equal(now.samples, samples)
    assert (now.sample_rate_hz, now.center_frequency_hz, now.annotations) == (1e6, 2e9, was.annotations)
    assert now.metadata["cast:transmitter"] == "a"


def test_a_figure_that_is_the_value_of_a_cell_is_shown_as_a_picture():
    from gr_cast.report import plot

    assert plot.new_figure(2, 1)._repr_png_().startswith(b"\x89PNG")
