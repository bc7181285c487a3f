# SPDX-License-Identifier: GPL-3.0-or-later
"""What a run under a jammer comes to: throughput and SINR with and without it, beside the paper's figures."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import __version__
from ..comparing import series as sr
from ..comparing.similarity import compare
from ..core.errors import CastError
from ..core.units import db_from_power
from . import paper
from .jamming import Frame, Setting, interval_of_harm, series

COLUMNS = ("throughput_mbit_per_s", "sinr_db")


@dataclass(frozen=True, kw_only=True)
class Run:
    """One run: what it was told, the frames that were computed, and how long both clocks ran."""

    label: str
    setting: Setting
    frames: list[Frame]
    offered_mbit_per_s: float
    step_s: float
    wall_s: float

    @property
    def series(self) -> dict[str, np.ndarray]:
        return series(self.frames, self.step_s, self.offered_mbit_per_s)

    @property
    def jammed(self) -> np.ndarray:
        """(frames,) bool: the jammer was on, and for a moving one within 3 dB of its strongest."""
        time_s = np.array([frame.time_s for frame in self.frames])
        if self.setting.jammer is None:
            return np.zeros(time_s.size, bool)
        on = (time_s >= self.setting.jammer.on_s[0]) & (time_s < self.setting.jammer.on_s[1])
        if not self.setting.scenario.is_static and on.any():
            disturbance = np.array([frame.disturbance for frame in self.frames])
            on &= disturbance > np.max(disturbance[on]) / 2
        return on


def as_document(run: Run) -> dict:
    """One run's numbers; null where there is nothing to count."""
    jammed = run.jammed
    delivered = np.array([frame.delivered for frame in run.frames], float)
    time_s = np.array([frame.time_s for frame in run.frames])
    sinr_db = np.array([frame.sinr_db for frame in run.frames])

    def rate(which):
        return float(np.mean(delivered[which]) * run.offered_mbit_per_s) if which.any() else None

    def level(which):
        chosen = [frame for frame, yes in zip(run.frames, which, strict=True) if yes]
        return float(db_from_power(sum(f.wanted for f in chosen) / sum(f.disturbance for f in chosen))) if chosen else None

    # A jammer that walks is never off: what it costs counts from where it is weakest.
    quiet = ~jammed if run.setting.scenario.is_static else sinr_db >= np.quantile(sinr_db, 0.9)
    with_it, without = rate(jammed), rate(quiet)
    return {
        "scenario": run.setting.scenario.name,
        "snr_db": run.setting.snr_db,
        "sinr_set_db": run.setting.sinr_db,
        "frames": len(run.frames),
        "frames_delivered": int(delivered.sum()),
        "radio_s": float(time_s[-1]),
        "wall_s": run.wall_s,
        "throughput_mbit_per_s": {"quiet": without, "jammed": with_it},
        "throughput_loss_percent": 100 * (1 - with_it / without) if without and with_it is not None else None,
        "sinr_db": {"quiet": level(quiet), "jammed": level(jammed)},
        "sinr_loss_db": level(quiet) - level(jammed) if jammed.any() and quiet.any() else None,
        "interval_of_harm_s": interval_of_harm(time_s, sinr_db) if len(run.frames) > 20 else None,
    }


def similarity(a: Run, b: Run) -> dict:
    """ρ with its blind spots of throughput and SINR of two runs; null where there are too few steps."""
    found = {}
    for column in COLUMNS:
        pair = [sr.Series(name=run.label, time_s=run.series["time_s"], value=run.series[column]) for run in (a, b)]
        try:
            c = compare(*pair)
        except CastError:
            found[column] = None
            continue
        found[column] = {
            "rho": c.rho, "rho_interval": c.rho_interval, "lag": c.lag, "bias": c.bias, "rmse": c.rmse,
            "blind_spots": list(c.blind_spots),
        }  # fmt: skip
    return found


def case_document(name: str, a: Run, b: Run | None) -> dict:
    document = {"name": name, "a": as_document(a), "paper": paper.jamming(name)}
    if b is not None and len(b.frames) > 1:
        document |= {"b": as_document(b), "similarity": similarity(a, b)}
    return document


def document(modem: str, cases: list[dict], complete: bool, restarts: int = 0) -> dict:
    """The content of jamming.json; `restarts` of the modem, each of which lost a frame."""
    head = {"cast_jamming": 1, "software": f"gr-cast {__version__}", "modem": modem, "modem_restarts": restarts}
    return head | {"complete": complete, "cases": cases}


def write_run(folder: Path, name: str, run: Run) -> None:
    """NAME.csv with the series and NAME-frames.csv with every frame."""
    folder.mkdir(parents=True, exist_ok=True)
    sr.write_csv(folder / f"{name}.csv", run.series)
    columns = {
        "time_s": [frame.time_s for frame in run.frames],
        "delivered": [int(frame.delivered) for frame in run.frames],
        "sinr_db": [frame.sinr_db for frame in run.frames],
    }
    sr.write_csv(folder / f"{name}-frames.csv", columns)


def as_table(document: dict) -> str:
    """For the screen: one line per case, and what the paper has."""

    def cell(value, form):
        return "–" if value is None else format(value, form)

    lines = [
        f"modem: {document['modem']}",
        f"{'':22}{'throughput lost':>17}{'SINR lost':>11}{'harm from–to':>16}{'ρ throughput':>14}{'ρ SINR':>8}",
    ]
    for case in document["cases"]:
        a, alike = case["a"], case.get("similarity") or {}
        interval = a["interval_of_harm_s"]
        rho = [cell((alike.get(column) or {}).get("rho"), ".3f") for column in COLUMNS]
        harm = f"{interval[0]:.2f}–{interval[1]:.2f} s" if interval else "–"
        lost = f"{cell(a['throughput_loss_percent'], '.0f') + ' %':>17}{cell(a['sinr_loss_db'], '.1f') + ' dB':>11}"
        lines.append(f"{case['name']:<22}{lost}{harm:>16}{rho[0]:>14}{rho[1]:>8}")
        told = case["paper"]
        if told:
            loss = "–".join(str(value) for value in dict.fromkeys(told["throughput_loss_percent"]))
            lines.append(
                f"{'   the paper':<22}{loss + ' %':>17}{cell(told.get('sinr_loss_db'), 'd') + ' dB':>11}{'':16}"
                f"{cell(told.get('rho_throughput'), '.3f'):>14}{cell(told.get('rho_sinr'), '.3f'):>8}"
            )
    if document["modem_restarts"]:
        lines.append(
            f"the modem died {document['modem_restarts']} times and was started anew; each time a frame was lost by that"
        )
    if not document["complete"]:
        lines.append("interrupted: these are the frames until then")
    return "\n".join(lines)
