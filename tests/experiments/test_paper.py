# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's figures as programs print them, against the figures as they were taken from the paper, row by row."""

import re
from pathlib import Path

import numpy as np
import pytest
from gr_cast.experiments import paper
from gr_cast.experiments.cellular.downlink import Cell

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def rows(cast_data):
    """{section: {first cell: other cells}} of the tables in paper-figures.md."""
    path, found, section = cast_data / "paper-figures.md", {}, ""
    if not path.is_file():
        pytest.skip(f"NO FIGURES OF THE PAPER at {path}")
    for line in path.read_text(encoding="utf-8").splitlines():
        section = line[3:].split(",")[0].split(" (")[0] if line.startswith("## ") else section
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if line.startswith("|") and cells[0]:
            found.setdefault(section, {}).setdefault(cells[0], cells[1:])
    return found


@pytest.mark.parametrize("mobility", ["static", "mobile"])
@pytest.mark.parametrize("name", ["throughput", "sinr"])
def test_similarity_under_a_jammer_is_the_papers(rows, mobility, name):
    told = paper.figures()["jamming"]["cases"]
    text = (ROOT / "docs" / "experiments.md").read_text(encoding="utf-8")
    word = {"throughput": "throughput", "sinr": "SINR"}[name]
    table = {k: v for section in rows for k, v in rows[section].items() if section.startswith("Wi-Fi jamming")}
    for jammer, published in zip(("narrowband", "wideband"), table[f"{mobility} {word}"], strict=False):
        assert told[f"{mobility}-{jammer}"][f"rho_{name}"] == float(published)
        (row,) = re.findall(rf"^\| {mobility}, {jammer} \|.*$", text, re.M)
        assert f" {published} " in row


@pytest.mark.parametrize(("name", "row"), [("udp_bps", "UDP throughput"), ("tcp_bps", "TCP throughput"), ("sinr_db", "TCP SINR")])
def test_similarity_of_one_cell_is_the_papers(rows, name, row):
    published = [float(cell) for cell in rows["Cellular"][row]]
    told = [paper.figures()["cellular"]["rho"][terminal][name] for terminal in ("34", "37", "41")]
    assert told == published[:3]
    assert np.mean(told) == pytest.approx(published[3], abs=6e-4)


def test_deviations_of_the_four_tap_test_are_the_papers(cast_data):
    text = (cast_data / "paper-figures.md").read_text()
    told = paper.figures()["four_taps"]
    assert f"its SD {told['strongest_tap_sd_db']:g} dB" in text and f"tap SD {told['weakest_tap_sd_db']:g} dB" in text
    assert f"off by {told['difference_error_db']:g} dB, SD {told['difference_sd_db']:g} dB" in text


def test_of_other_cells_the_paper_gives_no_similarity():
    assert paper.cellular_rho([Cell(station="12", terminals=("34", "37", "41"))])["41"]["udp_bps"] == 0.999
    two = [Cell(station="10", terminals=("33", "34", "41")), Cell(station="25", terminals=("37", "38", "42"))]
    assert paper.cellular_rho(two) == {} == paper.cellular_rho([Cell(station="12", terminals=("34", "37"))])
