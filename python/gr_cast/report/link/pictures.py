# SPDX-License-Identifier: GPL-3.0-or-later
"""The pictures of a diagnosis: residual maps before and after, and the waterfall of the residual's power by cause."""

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from ...core.units import db_from_amplitude, db_from_power
from ...diagnose.maps import Maps, before_and_after, power_of, steps
from ...twin.effects import FAMILIES
from ..pages import CAUSE, GOOD, INK, NOISE, TITLES, in_words
from ..plot import new_figure

MARK, LEFT = "#4fd1ff", "#ff4f4f"


def maps_figure(finding, effects: list[dict], left: list[dict]) -> Figure:
    """Four maps of one recording, the twin's residual beside the corrected twin's, on one scale.

    `effects` are marked where they were found (numbered as in the report), `left` what is still there.
    """
    floor = finding.data.noise_power or finding.fit.sigma2
    both = before_and_after(finding, floor)
    periodic = len(both[0].position) > 0
    # Its own layout: to find room for eight axes takes longer than to draw them, and these margins hold their labels.
    figure = new_figure(10.5, 10.6 if periodic else 8.4, layout=None)
    margins = dict(left=0.08, right=0.885, top=1 - 0.35 / figure.get_figheight(), bottom=0.5 / figure.get_figheight())
    shares = [1.25, 1.25, 1.0, 0.8][: 3 + periodic]
    rows = figure.subplots(len(shares), 2, sharey="row", height_ratios=shares, gridspec_kw=dict(margins, hspace=0.34, wspace=0.2))
    scales, transfers = [_scale(*(getattr(m, name) for m in both)) for name in ("time_frequency", "delay_time")], []
    for column, (m, title) in enumerate(zip(both, TITLES, strict=True)):
        marks = effects if column == 0 else left
        pictures = [
            _time_frequency(rows[0, column], finding, m, scales[0], marks, column),
            _delay_time(rows[1, column], finding, m, scales[1], marks, column),
        ]
        transfers.append(_transfer(rows[2, column], m, column))
        if periodic:
            _position(rows[3, column], finding, m, column)
        rows[0, column].set_title(title, fontsize=12, fontweight="bold")
    for axes, least in zip(zip(*filter(None, transfers), strict=True), (0.1, 1.0), strict=False):  # dB, degrees
        reach = max(least, *(1.1 * abs(v) for axis in axes for v in axis.get_ylim()))
        for axis in axes:
            axis.set_ylim(-reach, reach)
    for row, label in enumerate(("residual over noise / dB", "correlated, over noise / dB")):
        place = rows[row, 1].get_position()
        figure.colorbar(pictures[row], cax=figure.add_axes([0.917, place.y0, 0.014, place.height]), label=label)
    return figure


def _scale(*powers: np.ndarray) -> dict:
    """How maps that stand side by side are drawn."""
    loudest = float(db_from_power(max(np.nanmax(p) for p in powers)))
    return dict(vmin=-3.0, vmax=float(np.clip(loudest, 6.0, 50.0)), cmap="magma", aspect="auto", origin="lower")


def _extent_ms(finding) -> list[float]:
    """Time axis of a recording's part in ms."""
    first = finding.observation.first / finding.scene.sample_rate_hz
    return [1e3 * first, 1e3 * (first + finding.scene.duration_s)]


def _decibels(power: np.ndarray) -> np.ndarray:
    return db_from_power(np.maximum(power, 1e-6))


def _time_frequency(axis, finding, m: Maps, scale, marks, column):
    half = finding.scene.sample_rate_hz / 2e6
    extent = [*_extent_ms(finding), -half, half]
    picture = axis.imshow(_decibels(m.time_frequency).T, extent=extent, interpolation="nearest", **scale)
    axis.set(xlabel="time / ms", ylabel="frequency / MHz" if column == 0 else "")
    _mark(axis, marks, "frequency_hz", 1e-6, [-half, half], _extent_ms(finding), column)
    return picture


def _delay_time(axis, finding, m: Maps, scale, marks, column):
    step = m.delay_s[1] - m.delay_s[0]
    limits = [1e6 * (m.delay_s[0] - step / 2), 1e6 * (m.delay_s[-1] + step / 2)]
    extent = [*_extent_ms(finding), *limits]
    picture = axis.imshow(_decibels(m.delay_time).T, extent=extent, interpolation="nearest", **scale)
    for path in finding.scene.taps:
        place = extent[0] + 0.012 * (extent[1] - extent[0]), 1e6 * path.delay / finding.scene.sample_rate_hz
        axis.plot(*place, ">", color="white", ms=6, mec=INK)
    axis.set(xlabel="time / ms  (▷ the twin's paths)", ylabel="delay / µs" if column == 0 else "", ylim=limits)
    _mark(axis, marks, "delay_s", 1e6, limits, _extent_ms(finding), column)
    return picture


def _mark(axis, marks: list[dict], name: str, scale: float, limits, times, column) -> None:
    """Frames round the cells that hold a cause (or what is left); what is everywhere gets none."""
    for number, where in enumerate(marks, 1):
        place, time = where.get(name), where.get("time_s")
        low, high = (scale * place[0], scale * place[1]) if place else limits
        begin, end = (1e3 * time[0], 1e3 * time[1]) if time else times
        whole = [high - low > 0.95 * (limits[1] - limits[0]), end - begin > 0.95 * (times[1] - times[0])]
        if all(whole) or (place is None and time is None):
            continue
        least = 0.012 * (times[1] - times[0]), 0.025 * (limits[1] - limits[0])
        begin, end = _widened(begin, end, least[0], times)
        low, high = _widened(low, high, least[1], limits)
        colour = MARK if column == 0 else LEFT
        axis.plot([begin, end, end, begin, begin], [low, low, high, high, low], color=colour, lw=1.3)
        label = str(number) if column == 0 else "left"
        axis.annotate(label, (end, high), (3, -9), textcoords="offset points", color=colour, fontsize=9, fontweight="bold")


def _widened(low: float, high: float, least: float, limits) -> tuple[float, float]:
    """An interval no narrower than can be seen, inside the axis."""
    middle, width = (low + high) / 2, max(high - low, least)
    return max(middle - width / 2, limits[0]), min(middle + width / 2, limits[1])


def _transfer(axis, m: Maps, column) -> tuple | None:
    """AM-AM and AM-PM: recorded over predicted, by predicted amplitude; the axes of both, if there are any."""
    level = db_from_amplitude(m.amplitude)
    if len(level) < 3 or np.ptp(level) < 1.0:
        axis.text(0.5, 0.5, "one amplitude only:\nno AM-AM, no AM-PM", ha="center", va="center", transform=axis.transAxes)
        axis.set_axis_off()
        return None
    sure = m.gain_std < 5 * np.median(m.gain_std)
    level, m = level[sure], replace(m, gain=m.gain[sure], gain_std=m.gain_std[sure])
    gain, phase = db_from_amplitude(np.maximum(np.abs(m.gain), 1e-6)), np.degrees(np.angle(m.gain))
    std = m.gain_std / np.maximum(np.abs(m.gain), 1e-6)  # in nepers, and in radians
    axis.errorbar(level, gain, 2 * 20 / np.log(10) * std, fmt="o-", color=CAUSE, ms=3, lw=1, label="AM-AM / dB")
    other = axis.twinx()
    other.errorbar(level, phase, 2 * np.degrees(std), fmt="s--", color=INK, ms=2.5, lw=0.8)
    axis.plot([], [], "s--", color=INK, ms=2.5, lw=0.8, label="AM-PM / degree (right)")
    axis.axhline(0, color=NOISE, lw=0.8, ls=":")
    axis.set(xlabel="predicted amplitude / dB re its rms", ylabel="recorded / predicted, dB" if column == 0 else "")
    axis.legend(fontsize=8, loc="upper left")
    axis.grid(alpha=0.2)
    return axis, other


def _position(axis, finding, m: Maps, column) -> None:
    """Power of the residual over the period of the waveform."""
    period_us = 1e6 * len(finding.scene.sources[0].samples) / finding.scene.sample_rate_hz
    place = (np.arange(len(m.position)) + 0.5) / len(m.position) * period_us
    axis.plot(place, _decibels(m.position), color=CAUSE if column == 0 else GOOD, lw=0.8)
    axis.axhline(0, color=NOISE, lw=0.8, ls=":")
    axis.set(xlabel="place in the waveform's period / µs", ylabel="over noise / dB" if column == 0 else "", xlim=(0, period_us))
    axis.grid(alpha=0.2)


def waterfall_figure(finding, claimed: set[str]) -> Figure | None:
    """The residual's power re recorded power, from the twin's down cause by cause to the corrected twin's and the noise; None
    where the causes are not told apart in time. What is fitted and not in the list of the `claimed` is said to be so."""
    fit = finding.fit
    use = fit.data.use > 0
    recorded = float(np.mean(np.abs(fit.data.y[use]) ** 2))
    level = [power_of(finding.twin)]
    bars = [("twin as it is", None, level[0], INK)]
    by_cause = steps(finding)
    if by_cause is None:
        return None
    for index, power in by_cause:
        told_as = FAMILIES[fit.model.effects[index].family].told
        name = in_words(told_as) if told_as in claimed else f"{in_words(told_as)} (fitted, not claimed)"
        bars.append((name, level[-1], power, CAUSE))
        level.append(power)
    bars.append(("corrected twin", None, power_of(fit), GOOD))
    told = fit.data.noise_power
    noisy = [in_words(e.family) for e in fit.model.effects if FAMILIES[e.family].noise_like and not e.fixed]
    if told and noisy:
        bars.append((" and ".join(noisy), power_of(fit), told, NOISE))
    figure = new_figure(10.5, 0.9 + 0.42 * len(bars))
    axis = figure.subplots()
    levels = [float(db_from_power(v / recorded)) for _, a, b, _ in bars for v in (a, b) if v is not None]
    floor_db = float(db_from_power(told / recorded)) if told else min(levels)
    low, high = min([*levels, floor_db]), max(levels)
    span = max(high - low, 1.0)
    left = low - 0.12 * span
    for row, (_, begin, end, colour) in enumerate(bars):
        end_db = float(db_from_power(end / recorded))
        begin_db = left if begin is None else float(db_from_power(begin / recorded))
        axis.barh(row, end_db - begin_db, left=begin_db, color=colour, height=0.62)
        text = f"{end_db:.2f} dB" if begin is None else f"{end_db - begin_db:+.2f} dB"
        text = f"{begin_db - end_db:.2f} dB of noise" if colour == NOISE else text.replace("-", "\N{MINUS SIGN}")
        axis.annotate(text, (max(begin_db, end_db), row), (5, 0), textcoords="offset points", va="center", fontsize=9)
    if told:
        axis.axvline(floor_db, color=INK, ls=":", lw=1)
        axis.annotate("noise that the twin tells", (floor_db, -0.75), (4, 0), textcoords="offset points", fontsize=8, color=INK)
    axis.set_yticks(range(len(bars)), [name for name, *_ in bars])
    axis.set(xlabel="residual over recorded power / dB", xlim=(left, high + 0.14 * span), ylim=(len(bars) - 0.4, -1.0))
    axis.spines[["top", "right"]].set_visible(False)
    return figure
