# SPDX-License-Identifier: GPL-3.0-or-later
"""Importer of Wireless InSite's channel impulse responses: `PROJECT.cir.tTT_SS.rRR.p2m`, one file per transmitter.

After comment lines: the number of receiver points; for each its number and number of paths; for each path its number, phase
in degrees, time of arrival in s and received power in dBm.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...core.documents import read_text, short
from ...core.errors import CastError
from ...core.units import amplitude_from_db, db_from_amplitude
from ..model import LinkTaps, Scenario, reciprocal
from . import reduce
from .paths import LinkPaths


def read(path: str | Path, tx_power_dbm: float) -> dict[int, LinkPaths]:
    """Paths to every receiver point, by its number; points without a path are left out.

    The file's phases hold the carrier's, which LinkPaths keeps apart: `gain` here is meant for a carrier of 0 Hz. Raises
    CastError with the line of what is damaged.
    """
    path = Path(path)
    text = read_text(path)
    numbered = [(number, line.split()) for number, line in enumerate(text.splitlines(), 1)]
    lines = iter([(number, words) for number, words in numbered if words and not words[0].startswith("#")])
    points = {}
    for _ in range(int(_row(path, lines, 1)[0])):
        point, count = (int(value) for value in _row(path, lines, 2))
        rows = np.array([_row(path, lines, 4) for _ in range(count)])
        if count:
            delay_s, power_db = rows[None, :, 2], rows[None, :, 3] - tx_power_dbm
            gain = amplitude_from_db(power_db) * np.exp(1j * np.deg2rad(rows[None, :, 1]))
            still = np.zeros_like(delay_s)
            points[point] = LinkPaths(
                time_s=np.zeros(1), delay_s=delay_s, rate_before=still, rate_after=still, gain=gain
            )  # fmt: skip
    return points


def _row(path: Path, lines, width: int) -> list[float]:
    number, words = next(lines, (0, []))
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != width or not np.isfinite(values).all() or (width == 4 and values[2] < 0) or (width < 4 and min(values) < 0):
        place = f"line {number}" if number else "end of file"
        raise CastError(f"{path}: {place}: needs {width} numbers, got {short(' '.join(words))}: damaged or truncated")
    return values


def scenario(
    files: Sequence[str | Path], *, name: str, tx_power_dbm: float, bandwidth_hz: float
) -> tuple[Scenario, dict[tuple[str, str], float]]:
    """Four taps of every transmitter and receiver point of these files: nodes t1, t2, … and r1, r2, …, both ways the same;
    and what they lose: NMSE over the band in dB, per link."""
    links = {}
    for file in files:
        match = re.search(r"\.cir\.t0*(\d+)_", Path(file).name)
        if not match:
            raise CastError(f"{file}: name: needs the form PROJECT.cir.tTT_SS.rRR.p2m")
        for point, link in read(file, tx_power_dbm).items():
            job = reduce.Job(
                link=link, carrier_hz=0.0, bandwidth_hz=bandwidth_hz, method="least_squares", clock_s=np.zeros(1), hold_s=1.0
            )  # fmt: skip
            links[f"t{match[1]}", f"r{point}"] = reduce.reduce(job)
    if not links:
        raise CastError(f"{', '.join(map(str, files))}: no receiver point has a path")
    strongest = max(np.abs(item.gain).max() for item in links.values())
    taps = {key: LinkTaps(delay_s=item.delay_s, gain=item.gain / strongest) for key, item in links.items()}
    nodes = sorted({node for key in taps for node in key}, key=lambda node: (node[0] == "r", int(node[1:])))
    made = Scenario(name=name, nodes=tuple(nodes), links=reciprocal(taps), base_loss_db=-float(db_from_amplitude(strongest)))
    return made, {key: float(item.loss.nmse_db[0]) for key, item in links.items()}
