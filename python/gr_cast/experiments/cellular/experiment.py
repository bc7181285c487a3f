# SPDX-License-Identifier: GPL-3.0-or-later
"""The cellular experiment on a modelled downlink: SINR, CQI, and what UDP and TCP get, over time."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...comparing.series import Series, write_csv
from ...comparing.similarity import MAX_LAG, as_document, compare
from ...core.errors import CastError
from ...core.units import db_from_power
from ...scenario import Scenario
from . import adaptation, sources
from .downlink import Cell, Downlink, Radio

MODEL = (
    "modelled: SINR is measured by sounding the emulated channels; rates come from LTE's CQI table with an effective SINR "
    "(EESM), a scheduler of equal air time and fluid sources, not from a protocol stack"
)
TERMINALS = 3  # of a station that is suggested, as in the paper
QUANTITIES = {"sinr_db": "SINR (dB)", "udp_bps": "UDP (bit/s)", "tcp_bps": "TCP (bit/s)"}


@dataclass(frozen=True, kw_only=True)
class Course:
    """How a network fared: `time_s` (T,), and per terminal, (T, n): SINR averaged over subcarriers (NaN where nothing of the
    serving station was heard), CQI, bits per s."""

    name: str
    terminals: tuple[str, ...]
    time_s: np.ndarray
    sinr_db: np.ndarray
    cqi: np.ndarray
    udp_bps: np.ndarray
    tcp_bps: np.ndarray


def parse_cells(texts: list[str], nodes: tuple[str, ...]) -> list[Cell]:
    """Cells from STATION:TERMINAL,TERMINAL,…; a node is its name, or its number counted from 1."""

    def node(text: str) -> str:
        if text in nodes:
            return text
        if re.fullmatch(r"\d+", text) and 1 <= int(text) <= len(nodes):
            return nodes[int(text) - 1]
        raise CastError(f"cells: node {text!r}: needs a name, or a number from 1 to {len(nodes)}; names: {', '.join(nodes)}")

    cells = []
    for text in texts:
        station, colon, terminals = text.partition(":")
        if not (colon and terminals):
            raise CastError(f"cells: got {text!r}, needs STATION:TERMINAL,TERMINAL,…")
        cells.append(Cell(station=node(station), terminals=tuple(node(name) for name in terminals.split(","))))
    used = [name for cell in cells for name in (cell.station, *cell.terminals)]
    twice = sorted({name for name in used if used.count(name) > 1})
    if twice:
        raise CastError(f"cells: node {', '.join(twice)} is there twice")
    return cells


def suggested_cells(scenario: Scenario, stations: int) -> list[str]:
    """Cells that `parse_cells` reads, of so many stations: nodes that most others hear, each with up to three of these."""
    free, texts = list(scenario.nodes), []
    for _ in range(stations):
        heard = {node: [other for other in free if (node, other) in scenario.links] for node in free}
        station = max(free, key=lambda node: len(heard[node]), default=None)
        if not station or not heard[station]:
            raise CastError(f"{scenario.name}: has no links for {stations} stations and their terminals")
        terminals = heard[station][:TERMINALS]
        texts.append(f"{station}:{','.join(terminals)}")
        free = [node for node in free if node not in (station, *terminals)]
    return texts


def restricted(scenario: Scenario, cells: list[Cell]) -> Scenario:
    """The scenario with nothing but the cells' nodes and the links between stations and terminals, both ways."""
    stations, terminals = {cell.station for cell in cells}, {node for cell in cells for node in cell.terminals}
    links = {
        key: taps for key, taps in scenario.links.items()
        if (key[0] in stations and key[1] in terminals) or (key[1] in stations and key[0] in terminals)
    }  # fmt: skip
    losses_db = {key: loss for key, loss in scenario.link_base_loss_db.items() if key in links}
    nodes = tuple(node for node in scenario.nodes if node in stations | terminals)
    return replace(scenario, nodes=nodes, links=links, link_base_loss_db=losses_db, position_m={})


def sinr_over_time(downlink: Downlink, time_s: np.ndarray) -> Iterator[dict[str, np.ndarray]]:
    """The SINR of every terminal's subcarriers at each instant, as `Downlink.sinr` gives it."""
    for instant in time_s:
        yield downlink.sinr(float(instant))


def course(
    name: str, cells: list[Cell], radio: Radio, time_s: np.ndarray, sinrs: list[dict[str, np.ndarray]], offered_bps: float
) -> Course:
    """What the terminals of each cell get, from the SINR of their subcarriers at the instants `time_s` (evenly spaced)."""
    terminals = tuple(terminal for cell in cells for terminal in cell.terminals)
    time_s = time_s[: len(sinrs)]
    mean = np.array([[sinr[terminal].mean() for terminal in terminals] for sinr in sinrs])
    sinr_db = db_from_power(np.where(mean > 0, mean, np.nan))
    cqi = np.array([[adaptation.cqi(sinr[terminal]) for terminal in terminals] for sinr in sinrs])
    rate_bps = np.array([[adaptation.rate_bps(index, radio.blocks) for index in row] for row in cqi])
    step_s = time_s[1] - time_s[0] if len(time_s) > 1 else 1.0
    udp_bps, tcp_bps = np.zeros_like(rate_bps), np.zeros_like(rate_bps)
    first = 0
    for cell in cells:
        part = slice(first, first + len(cell.terminals))
        udp_bps[:, part] = sources.udp(rate_bps[:, part], offered_bps)
        tcp_bps[:, part] = sources.tcp(rate_bps[:, part], step_s, offered_bps)
        first = part.stop
    return Course(name=name, terminals=terminals, time_s=time_s, sinr_db=sinr_db, cqi=cqi, udp_bps=udp_bps, tcp_bps=tcp_bps)


def write_series(folder: Path, run: Course) -> list[str]:
    """A file time_s,value per terminal and quantity; returns their names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for column, terminal in enumerate(run.terminals):
        for quantity in QUANTITIES:
            path = folder / f"{quantity}_{terminal}.csv"
            write_csv(path, {"time_s": run.time_s, "value": getattr(run, quantity)[:, column]})
            names.append(str(path))
    return names


def similarities(a: Course, b: Course) -> list[dict]:
    """ρ of every terminal's series in two courses and what ρ hides, a row each; ρ None where a series is constant, and all
    None, with a reason, where one has instants without a value."""
    kept = ("rho", "rho_interval", "lag", "bias", "rmse", "slope", "independent_samples", "blind_spots")
    rows = []
    for column, terminal in enumerate(a.terminals):
        for quantity in QUANTITIES:
            pair = [Series(name=c.name, time_s=c.time_s, value=getattr(c, quantity)[:, column]) for c in (a, b)]
            unheard = next((reason for reason in (_unheard(series.value) for series in pair) if reason), None)
            found = dict.fromkeys(kept) | {"reason": unheard}
            if not unheard:
                found |= as_document(compare(*pair, max_lag=min(MAX_LAG, len(a.time_s) - 1)))
            rows.append({"terminal": terminal, "quantity": quantity} | {key: found[key] for key in (*kept, "reason")})
    return rows


def summary(run: Course, offered_bps: float) -> list[dict]:
    """A row of figures per terminal, over the instants at which its station was heard; None, with the reason, where never."""
    rows = []
    for column, terminal in enumerate(run.terminals):
        sinr_db, udp_bps, tcp_bps = (getattr(run, quantity)[:, column] for quantity in QUANTITIES)
        heard = sinr_db[np.isfinite(sinr_db)]
        mean, low, high = (float(pick(heard)) if heard.size else None for pick in (np.mean, np.min, np.max))
        rows.append({
            "run": run.name, "terminal": terminal, "sinr_db_mean": mean, "sinr_db_min": low, "sinr_db_max": high,
            "reason": _unheard(sinr_db), "cqi_median": float(np.median(run.cqi[:, column])),
            "udp_bps_mean": float(udp_bps.mean()), "udp_loss": float(1 - udp_bps.mean() / offered_bps),
            "tcp_bps_mean": float(tcp_bps.mean()),
        })  # fmt: skip
    return rows


def _unheard(values: np.ndarray) -> str | None:
    """Why values are missing: a sentence, None where none is."""
    missing = int(np.isnan(values).sum())
    return f"nothing of its station was heard at {missing} of {values.size} instants" if missing else None
