# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of soundings, codes, path losses, scenarios, comparisons and experiments; `save` writes one whole."""

import io
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # programs and tests draw without a screen

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .. import scenario as sc
from ..comparing.responses import ResponseComparison
from ..comparing.series import Series
from ..comparing.similarity import SeriesComparison
from ..core.figures import fixed
from ..core.files import written_aside
from ..core.units import db_from_amplitude, db_from_power
from ..experiments.cellular.experiment import QUANTITIES, Course
from ..experiments.traffic import log
from ..sounding.sound import Sounding
from . import labels

LEAST_SPAN_DB = 1.0  # of a colour scale or an axis: less is no difference between links
MEASURED, MODELLED, FLOOR = "#1f5fa8", "#d1701f", "#8a8a8a"


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with written_aside(path) as aside:
        figure.savefig(aside, dpi=110)


def png(figure: Figure, dpi: float) -> bytes:
    """The file of a figure, laid out and drawn once; `savefig` draws it once more, to lay it out."""
    layout, before_dpi = figure.get_layout_engine(), figure.dpi
    figure.dpi, canvas = dpi, FigureCanvasAgg(figure)
    if layout and figure.axes:
        layout.execute(figure)
        figure.set_layout_engine("none")
    file = io.BytesIO()
    canvas.print_png(file)
    figure.dpi = before_dpi
    figure.set_layout_engine(layout)  # what changes later is laid out again
    return file.getvalue()


class _Figure(Figure):
    """One that a notebook shows where it is the value of a cell."""

    def _repr_png_(self) -> bytes:
        return png(self, 90)


def new_figure(width: float, height: float, layout: str | None = "constrained") -> Figure:
    return _Figure(figsize=(width, height), layout=layout)


def _span_db(axes) -> None:
    """An axis that spans LEAST_SPAN_DB at least: hundredths of a dB of what stands still fill no picture."""
    low, high = axes.get_ylim()
    margin = max(0.0, LEAST_SPAN_DB - (high - low)) / 2
    axes.set_ylim(low - margin, high + margin)


def sounding_figure(sounding: Sounding, title: str, modelled_taps=()) -> Figure:
    """CIR with the taps found (and the modelled ones, pairs of delay_s and gain_db), and path gain over the frames."""
    figure = new_figure(9, 6.5)
    top, bottom = figure.subplots(2, 1, height_ratios=[3, 2])
    _draw_cir(top, sounding, modelled_taps)
    top.set_title(title, loc="left", fontsize=11)
    _draw_frames(bottom, sounding)
    _label_taps(figure, top, sounding)
    return figure


def _draw_cir(axes, sounding: Sounding, modelled_taps) -> None:
    delay_us = (sounding.response_start + np.arange(len(sounding.response))) / sounding.sample_rate_hz * 1e6
    response_db = db_from_amplitude(np.maximum(np.abs(sounding.response), 1e-12))
    floor_db = float(db_from_power(sounding.response_noise_power))
    bottom_db = min(floor_db, np.percentile(response_db, 5)) - 6
    axes.plot(delay_us, response_db, color=MEASURED, lw=0.8, alpha=0.75, label="correlation |h|")
    residual_db = db_from_amplitude(np.maximum(np.abs(sounding.residual_response), 1e-12))
    axes.plot(delay_us, residual_db, color=FLOOR, lw=0.6, alpha=0.8, label="left by the taps")
    taps = sounding.taps
    tap_us = taps.delay_samples / sounding.sample_rate_hz * 1e6
    tap_db = db_from_power(taps.power)
    axes.vlines(tap_us, bottom_db, tap_db, color=MEASURED, lw=1.6)
    axes.plot(tap_us, tap_db, "o", color=MEASURED, ms=6, label="taps found")
    if len(modelled_taps):
        x, y = np.transpose(modelled_taps)
        axes.plot(
            x * 1e6,
            y,
            "s",
            ms=12,
            mfc="none",
            mec=MODELLED,
            mew=1.8,
            label="modelled, at 0 s" if sounding.is_moving else "modelled",
        )
    axes.axhline(floor_db, color=FLOOR, lw=1, ls=":", label="noise in the CIR")
    if np.isfinite(sounding.smallest_path_gain_db):
        axes.axhline(sounding.smallest_path_gain_db, color=FLOOR, lw=1, ls="--", label="detection threshold")
    top_db = max(np.max(response_db), floor_db, *tap_db, *(gain for _, gain in modelled_taps))
    axes.set_ylim(bottom_db, top_db + 0.08 * (top_db - bottom_db) + 1)
    axes.set(xlabel="delay (µs)", ylabel="gain (dB)")
    axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=6, frameon=False)
    axes.grid(alpha=0.25)


def _label_taps(figure: Figure, axes, sounding: Sounding) -> None:
    """Delay, gain and, of a moving channel, Doppler of every tap, the strongest first."""
    taps = sounding.taps
    order = np.argsort(-taps.power)
    delay_us, gain_db = 1e6 * taps.delay_samples / sounding.sample_rate_hz, db_from_power(taps.power)
    texts = [f"{fixed(delay_us[k], 3)} µs, {fixed(gain_db[k], 2)} dB" for k in order]
    for place, k in enumerate(order):
        if sounding.is_moving and sounding.doppler[k] is not None:
            texts[place] += f", {fixed(sounding.doppler[k].mean * sounding.sample_rate_hz, 1)} Hz"
    labels.label(figure, axes, delay_us[order], gain_db[order], texts)


def _draw_frames(axes, sounding: Sounding) -> None:
    time_ms = sounding.frame_time_s * 1e3
    order = np.argsort(-sounding.taps.power)[:6]
    style = "." if sounding.frames > 1 else "o"
    for tap in order:
        gain_db = db_from_amplitude(np.where(sounding.frame_detected, np.abs(sounding.frame_gain[:, tap]), np.nan))
        delay_us = sounding.taps.delay_samples[tap] / sounding.sample_rate_hz * 1e6
        axes.plot(time_ms, gain_db, style, ms=2.5 if sounding.frames > 1 else 6, label=f"tap at {delay_us:.3f} µs")
    _span_db(axes)
    missing = time_ms[~sounding.frame_detected]
    if len(missing) and len(order):
        axes.plot(missing, np.full(len(missing), axes.get_ylim()[0]), "x", color="#b02020", ms=4, label="missing")
    if len(order) == 0:
        axes.text(0.5, 0.5, "no signal above the noise", ha="center", transform=axes.transAxes)
    else:
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=6, frameon=False)
    axes.set(xlabel="time (ms)", ylabel="tap gain (dB)")
    axes.grid(alpha=0.25)


def colour_scale(values_db: np.ndarray, error_db: float = 0.0) -> dict[str, float]:
    """Ends of a colour scale that spans no less than the figures' own error, and no less than LEAST_SPAN_DB."""
    known = values_db[np.isfinite(values_db)]
    if not known.size:
        return {}
    middle, span = (known.max() + known.min()) / 2, max(np.ptp(known), 2 * error_db, LEAST_SPAN_DB)
    return {"vmin": float(middle - span / 2), "vmax": float(middle + span / 2)}


def heatmap_figure(loss_db: np.ndarray, nodes: list[str], title: str, error_db: float = 0.0) -> Figure:
    """N×N path loss, dB, known to `error_db`; rows transmit, columns receive; NaN was not measured or not heard."""
    size = max(5.0, 0.55 * len(nodes) + 2)
    figure = new_figure(size + 1, size)
    axes = figure.subplots()
    scale = colour_scale(loss_db, error_db)
    image = axes.imshow(loss_db, cmap="viridis_r", **scale)
    axes.set_xticks(range(len(nodes)), nodes)
    axes.set_yticks(range(len(nodes)), nodes)
    axes.set(xlabel="receiver", ylabel="transmitter")
    axes.set_title(title, loc="left", fontsize=11)
    middle = (scale["vmin"] + scale["vmax"]) / 2 if scale else 0.0
    if len(nodes) <= 16:
        for (row, column), value in np.ndenumerate(loss_db):
            text = fixed(value, 1) if np.isfinite(value) else "–"
            colour = "w" if round(value, 1) > round(middle, 1) else "k"  # of one figure, one colour
            axes.text(column, row, text, ha="center", va="center", fontsize=8, color=colour)
    figure.colorbar(image, label="path loss (dB)", shrink=0.85)
    return figure


def codes_figure(rows: list[dict]) -> Figure:
    """One line per code: correlation over time, alone (left) and through the laboratory link (right).

    A row has `name`, `time_us`, `alone_db`, `link_db` and the sidelobes that `code_comparison.compare` reads off them.
    """
    figure = new_figure(12, 1.2 * len(rows) + 1)
    grid = figure.subplots(len(rows), 2, sharex=True, sharey=True)
    for (left, right), row in zip(grid, rows, strict=True):
        left.plot(row["time_us"], row["alone_db"], color=MEASURED, lw=0.7)
        right.plot(row["time_us"], row["link_db"], color=MODELLED, lw=0.7)
        for axes, sidelobe_db in ((left, row["alone_sidelobe_db"]), (right, row["link_sidelobe_db"])):
            axes.set_ylim(-85, 18)
            axes.grid(alpha=0.25)
            text = f"{row['name']}: " + ("no sidelobe" if sidelobe_db is None else f"sidelobe {fixed(sidelobe_db, 1)} dB")
            axes.text(0.01, 0.96, text, transform=axes.transAxes, fontsize=8.5, va="top", fontweight="bold")
        left.set_ylabel("dB", fontsize=8)
    grid[0, 0].set_title("alone", fontsize=10)
    grid[0, 1].set_title("through the emulated 30 dB laboratory link", fontsize=10)
    for axes in grid[-1]:
        axes.set_xlabel("time (µs)")
    return figure


def scenario_figure(scenario: sc.Scenario, bandwidth_hz: float) -> Figure:
    """Path gain of every link in the band, taps of the most different links, and power over time."""
    figure = new_figure(13, 4.6)
    left, middle, right = figure.subplots(1, 3)
    figure.suptitle(scenario.name, x=0.01, ha="left", fontsize=11)
    _path_gain_map(figure, left, scenario, bandwidth_hz)
    keys = _distinct_links(scenario)
    _taps(middle, scenario, keys)
    _power_over_time(right, scenario, keys, bandwidth_hz)
    return figure


def _path_gain_map(figure: Figure, axes, scenario: sc.Scenario, bandwidth_hz: float) -> None:
    gain_db = sc.path_gain_matrix_db(scenario, bandwidth_hz)
    known_db = np.where(np.isfinite(gain_db), gain_db, np.nan)
    image = axes.imshow(known_db, cmap="viridis", interpolation="nearest", **colour_scale(known_db))
    figure.colorbar(image, ax=axes, label=f"path gain in {bandwidth_hz / 1e6:g} MHz (dB)", shrink=0.8)
    step = max(1, len(scenario.nodes) // 16)
    ticks = range(0, len(scenario.nodes), step)
    axes.set_xticks(ticks, scenario.nodes[::step], rotation=90)
    axes.set_yticks(ticks, scenario.nodes[::step])
    axes.set(xlabel="receiver", ylabel="transmitter", title="mean power of every link (blank: none)")


def _distinct_links(scenario: sc.Scenario, count: int = 6) -> list[tuple[str, str]]:
    """Up to `count` links, those that move first, one per distinct set of taps and one per pair."""
    chosen: dict = {}
    for key in sorted(scenario.links, key=lambda key: scenario.links[key].is_static):
        taps = scenario.links[key]
        if (key[1], key[0]) not in chosen.values():
            chosen.setdefault((taps.gain[0].tobytes(), taps.delay_s[0].tobytes()), key)
        if len(chosen) == count:
            break
    return list(chosen.values())


def _taps(axes, scenario: sc.Scenario, keys) -> None:
    floor_db = -60.0
    for index, key in enumerate(keys):
        delay_s, gain = (value[0] for value in sc.taps_at(scenario, key, np.zeros(1)))
        used = gain != 0
        if used.any():
            gain_db = db_from_amplitude(gain[used])
            floor_db = min(floor_db, gain_db.min() - 5)
            color = f"C{index}"
            axes.vlines(1e6 * delay_s[used], -400, gain_db, color=color, lw=1.5, alpha=0.7)
            axes.plot(1e6 * delay_s[used], gain_db, "o", color=color, ms=5, label=sc.link_name(key))
    axes.set(xlabel="delay (µs)", ylabel="tap gain (dB)", title="taps at 0 s", ylim=(max(floor_db, -160), 5))
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def _power_over_time(axes, scenario: sc.Scenario, keys, bandwidth_hz: float) -> None:
    """Power in the band, and the sum of |tap|^2 as dots where it is another."""
    time_s = scenario.time_s if scenario.time_s.size > 1 else np.array([0.0, 1.0])  # what stands still is a line across
    style = "steps-post" if scenario.interpolation == "hold" else "default"
    differ = False
    for index, key in enumerate(keys):
        in_band_db, sum_db = sc.band_power_db(scenario, key, bandwidth_hz), sc.tap_power_db(scenario, key)
        about = dict(color=f"C{index}", drawstyle=style, lw=0.9)
        axes.plot(time_s, np.broadcast_to(in_band_db, time_s.shape), label=sc.link_name(key), **about)
        if np.max(np.abs(in_band_db - sum_db)) >= 0.05:
            differ = True
            axes.plot(time_s, np.broadcast_to(sum_db, time_s.shape), ls=":", alpha=0.8, **about)
    title = f"power in {bandwidth_hz / 1e6:g} MHz" + (" (dotted: Σ|tap|²)" if differ else "")
    axes.set(xlabel="time (s)", ylabel="path gain (dB)", title=title)
    if scenario.time_s.size == 1:
        axes.set_xticks([])
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)


def series_comparison_figure(comparison: SeriesComparison, label: str) -> Figure:
    """Both series over time, B over A with the line of equality, and ρ over the lag."""
    c = comparison
    figure = new_figure(11, 6)
    grid = figure.add_gridspec(2, 2, height_ratios=[3, 2.6])
    over_time, scatter, lags = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    for series, color, name in ((c.a, MEASURED, "A"), (c.b, MODELLED, "B")):
        over_time.plot(series.time_s - series.time_s[0], series.value, color=color, lw=1, label=f"{name}: {series.name}")
    over_time.set(xlabel="time from each series' first sample (s)", ylabel=label)
    over_time.legend(fontsize=8)
    rho = "not defined" if c.rho is None else f"{c.rho:.4f}"
    if c.rho_interval:
        rho += f" ({c.rho_interval[0]:.3f} to {c.rho_interval[1]:.3f})"
    over_time.set_title(f"similarity ρ {rho}   bias {c.bias:+.3g}   RMSE {c.rmse:.3g}", loc="left", fontsize=11)
    size = min(c.a.value.size, c.b.value.size)
    x, y = c.a.value[:size], c.b.value[:size]
    ends = [min(x.min(), y.min()), max(x.max(), y.max())]
    scatter.plot(ends, ends, color=FLOOR, lw=1, ls="--", label="A = B")
    scatter.plot(x, y, ".", color=MEASURED, ms=3)
    scatter.set(xlabel="A", ylabel="B")
    scatter.legend(fontsize=8)
    lags.stem(np.arange(-c.max_lag, c.max_lag + 1), np.nan_to_num(c.rho_at_lag), basefmt=" ")
    lags.set(xlabel="lag of B behind A (samples)", ylabel="normalised cross-correlation")
    for axes in (over_time, scatter, lags):
        axes.grid(alpha=0.25)
    return figure


def response_comparison_figure(comparison: ResponseComparison) -> Figure:
    """The taps of A and B over delay; those without a partner stand out."""
    c = comparison
    figure = new_figure(9, 4.5)
    axes = figure.subplots()
    floor_db = min(c.a.gain_db.min(), c.b.gain_db.min()) - 6
    lone: list[tuple[float, float, str]] = []
    for response, alone, color, marker, name in (
        (c.a, c.only_a, MEASURED, "o", "A"), (c.b, c.only_b, MODELLED, "s", "B"),
    ):  # fmt: skip
        delay_us = response.delay_s * 1e6
        axes.vlines(delay_us, floor_db, response.gain_db, color=color, lw=1.2, alpha=0.7)
        axes.plot(delay_us, response.gain_db, marker, color=color, mfc="none", ms=8, mew=1.6, label=f"{name}: {response.name}")
        lone += [(response.gain_db[k], delay_us[k], f"only in {name}") for k in alone]
    axes.set(xlabel="delay (µs)", ylabel="gain (dB)", ylim=(floor_db, None))
    axes.set_title(f"path loss A {-c.a.path_gain_db:.2f} dB, B {-c.b.path_gain_db:.2f} dB", loc="left", fontsize=11)
    axes.legend(fontsize=8)
    axes.grid(alpha=0.25)
    if lone:
        gain_db, late_us, texts = zip(*sorted(lone, reverse=True), strict=True)  # the strongest first
        labels.label(figure, axes, late_us, gain_db, texts)
    return figure


def cellular_figure(courses: list[Course], title: str, offered_bps: float) -> Figure:
    """SINR and what UDP and TCP deliver over time, a colour per terminal; the first course is drawn thick, others thin."""
    figure = new_figure(10, 8)
    rows = figure.subplots(len(QUANTITIES), 1, sharex=True)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    for axes, (quantity, label) in zip(rows, QUANTITIES.items(), strict=True):
        scale = 1.0 if quantity == "sinr_db" else 1e-6
        for index, course in enumerate(courses):
            for column, terminal in enumerate(course.terminals):
                axes.plot(
                    course.time_s, scale * getattr(course, quantity)[:, column], color=f"C{column}", lw=(2.4, 1.0)[index > 0],
                    alpha=(0.45, 1.0)[index > 0], label=f"{terminal}, {course.name}",
                )  # fmt: skip
        if quantity != "sinr_db":
            axes.axhline(offered_bps * 1e-6, color=FLOOR, lw=1, ls=":")
        else:
            _span_db(axes)
        axes.set_ylabel(label.replace("bit/s", "Mbit/s"))
        axes.grid(alpha=0.3)
    rows[-1].set_xlabel("time (s)")
    rows[-1].legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.25), ncols=3, frameon=False)
    return figure


def jamming_figure(cases: list[tuple[str, list]]) -> Figure:
    """Throughput and SINR over time of every case, (name, its one or two runs)."""
    figure = new_figure(4.6 * len(cases) + 0.6, 6)
    grid = figure.subplots(2, len(cases), sharex="col", sharey="row", squeeze=False)
    for (top, bottom), (name, runs) in zip(grid.T, cases, strict=True):
        top.set_title(name, loc="left", fontsize=11)
        for run, color, style in zip(runs, (MEASURED, MODELLED), ("-", "--"), strict=False):
            columns = run.series
            top.plot(columns["time_s"], columns["throughput_mbit_per_s"], style, color=color, lw=1.3, label=run.label)
            bottom.plot(columns["time_s"], columns["sinr_db"], style, color=color, lw=1.3)
        jammer = runs[0].setting.jammer
        if jammer:
            last_s = runs[0].series["time_s"][-1]
            for axes in (top, bottom):
                axes.axvspan(jammer.on_s[0], min(jammer.on_s[1], last_s), color=FLOOR, alpha=0.15, lw=0, zorder=0)
        top.set_ylim(0, 1.08 * runs[0].offered_mbit_per_s)
        bottom.set_xlabel("radio time (s)")
        for axes in (top, bottom):
            axes.grid(alpha=0.25)
    grid[0, 0].set_ylabel("throughput (Mbit/s)")
    grid[1, 0].set_ylabel("SINR (dB)")
    _span_db(grid[1, 0])
    grid[0, 0].legend(fontsize=8)
    return figure


def jamming_spectrogram(cases: list[tuple[str, list]], sample_rate_hz: float) -> Figure:
    """Spectrum of every computed frame of each case's first run; the grey scale is one for all."""
    figure = new_figure(4.6 * len(cases) + 1, 4)
    grid = figure.subplots(1, len(cases), sharey=True, squeeze=False)[0]
    levels = [db_from_power(np.array([frame.spectrum for frame in runs[0].frames])) for _, runs in cases]
    top_db = max(np.max(level) for level in levels)
    floor_db = min(np.percentile(level, 1) for level in levels)
    for axes, (name, runs), level in zip(grid, cases, levels, strict=True):
        times = [frame.time_s for frame in runs[0].frames]
        extent = (times[0], times[-1], -sample_rate_hz / 2e6, sample_rate_hz / 2e6)
        image = axes.imshow(
            level.T, origin="lower", aspect="auto", extent=extent, cmap="inferno", vmin=floor_db, vmax=top_db,
            interpolation="nearest",
        )  # fmt: skip
        axes.set_title(name, loc="left", fontsize=11)
        axes.set_xlabel("radio time (s)")
    grid[0].set_ylabel("frequency from the carrier (MHz)")
    figure.colorbar(image, ax=list(grid), label="power per bin (dB)", shrink=0.9)
    return figure


def stack_figure(found: dict[str, dict[str, Series]], title: str) -> Figure:
    """What a stack's own logs say over time, a row per quantity, a colour per terminal."""
    figure = new_figure(10, 2.6 * max(len(found), 1) + 0.6)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    for axes, (quantity, terminals) in zip(figure.subplots(len(found), 1, squeeze=False)[:, 0], found.items(), strict=True):
        scale, label = {"sinr_db": (1.0, "SINR (dB)"), "loss": (100.0, "loss (%)"), "latency_s": (1e3, "latency (ms)")}.get(
            quantity, (1e-6, f"{quantity.removesuffix('_bps').upper()} (Mbit/s)")
        )
        for terminal, series in terminals.items():
            axes.plot(series.time_s, series.value * scale, ".-", label=terminal)
        if quantity == "sinr_db":
            _span_db(axes)
        axes.set_ylabel(label)
        axes.set_xlabel("time (s)")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8)
    return figure


def traffic_figure(runs: list[dict], duration_s: float, step_s: float) -> Figure:
    """A column per run: throughput and loss over time, and latency of every packet; a colour per flow."""
    figure = new_figure(max(8.0, 2.6 * len(runs) + 1), 7)
    grid = figure.subplots(3, len(runs), sharex=True, sharey="row", squeeze=False)
    for (rates, losses, latencies), run in zip(grid.T, runs, strict=True):
        rates.set_title(run["run"], fontsize=10)
        for index, result in enumerate(run["results"]):
            found = log.series(result, duration_s, step_s)
            time_s, rate_bps = found["throughput_bps"]
            rates.plot(time_s, rate_bps / 1e3, color=f"C{index}")
            losses.plot(time_s, 100 * found["loss"][1], ".-", color=f"C{index}", label=result.flow.name)
            latencies.plot(result.sent_s, 1e3 * result.latency_s, ".", color=f"C{index}", ms=3)
        losses.set_ylim(-4, 104)
        latencies.set(xlabel="time (s)", xlim=(0, duration_s), yscale="log")
        for axes in (rates, losses, latencies):
            axes.grid(alpha=0.3)
    for axes, label in zip(grid[:, 0], ("throughput (kbit/s)", "loss (%)", "latency (ms)"), strict=True):
        axes.set_ylabel(label)
    grid[1, 0].legend(fontsize=8, loc="center")  # where all lines lie at 0 % or 100 %
    return figure


def loss_figure(points: list, title: str) -> Figure:
    """Packet loss over the SINR set, a line per disturbance with its binomial deviation, and the SINR measured over that set."""
    figure = new_figure(11, 4.6)
    left, right = figure.subplots(1, 2)
    for index, curve in enumerate(dict.fromkeys(point.curve for point in points)):
        mine = [point for point in points if point.curve == curve]
        set_db, loss = [point.set_db for point in mine], np.array([point.loss for point in mine])
        spread = np.sqrt(loss * (1 - loss) / [point.frames for point in mine])
        style = dict(color=f"C{index}", marker="os^vD"[index % 5], ms=4, lw=1.3, label=curve.name)
        left.errorbar(set_db, loss, spread, capsize=2, ls="--" if mine[0].measured_db is None else "-", **style)
        if mine[0].measured_db is not None:
            right.plot(set_db, [point.measured_db - point.set_db for point in mine], **style)
    right.axhspan(-0.5, 0.5, color=FLOOR, alpha=0.15, lw=0)
    left.set(xlabel="SINR set (dB)", ylabel="packet loss")
    right.set(xlabel="SINR set (dB)", ylabel="SINR measured − set (dB)", ylim=(-1, 1))
    figure.suptitle(title, x=0.01, ha="left", fontsize=10)
    left.legend(fontsize=8)
    for axes in (left, right):
        axes.grid(alpha=0.25)
    return figure
