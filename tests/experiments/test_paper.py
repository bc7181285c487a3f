# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's figures as programs print them, against the figures as they were taken from the paper, row by row."""

import re
from dataclasses import replace
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
    nodes = tuple(f"n{number}" for number in range(1, 43))
    cell = Cell(station="n12", terminals=("n34", "n37", "n41"))
    assert {name: rho["udp_bps"] for name, rho in paper.cellular_rho([cell], nodes).items()} == {
        "n34": 0.986, "n37": 0.998, "n41": 0.999
    }  # fmt: skip
    two = [Cell(station="n10", terminals=("n33", "n34", "n41")), Cell(station="n25", terminals=("n37", "n38", "n42"))]
    assert paper.cellular_rho(two, nodes) == {} == paper.cellular_rho([replace(cell, terminals=("n34", "n37"))], nodes)
    assert paper.cellular_rho([cell], nodes[::-1]) == {}


def test_six_terminals_of_two_stations_hold_what_the_paper_says(cast_data):
    text, told = (cast_data / "paper-figures.md").read_text(encoding="utf-8"), paper.figures()["two_cells"]
    assert (
        f"All six hold {told['udp_bps'] / 1e6:g} Mbit/s; 95 % confidence margin {told['udp_margin_bps'] / 1e6:g} Mbit/s" in text
    )
