# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a place diagnosis: one file that needs no other. Plan, section and maps also without a script, and on paper."""

import json
import time
from html import escape

import numpy as np

from ...core.programs import called
from ..pages import NEGATIVE, STYLE, Album, listed
from . import maps, words
from .drawing import drawing, projections, ramp
from .marks import marks_of
from .scene import scene_of
from .script import SCRIPT
from .style import PLACE_STYLE

BUDGET_S = 20.0  # processor time of the pictures
MOST_CHARTS = 300  # links that can be clicked on
_POINTS = 160  # of a chart


def render(diagnosis) -> str:
    """The page as text."""
    d, name, scene = diagnosis.document, escape(diagnosis.place.name), scene_of(diagnosis)
    album = Album(time.thread_time() + BUDGET_S)
    found, powers = maps.profiles(scene), maps.courses(scene)
    parts = [
        f"<h1>{name}</h1><p class='verdict {d['verdict']}'>{escape(words.verdict(d))}</p>",
        *(f"<p>{escape(line)}</p>" for line in d.get("warnings", [])),
        _views(scene),
        words.causes(d),
        words.bars(d["fit"]),
        words.open_questions(d),
        _maps(scene, found, album),
        _powers(powers, album),
        _table(scene),
        _use(d),
        f"<p class='note'>Computed in {d.get('seconds', 0):.1f} s. Numbers stand with one standard deviation; in the drawings, "
        "uncertainty is two.</p>",
    ]
    head = f"<meta charset='utf-8'><meta name='viewport' content='width=device-width'><title>{name}: "
    head += f"{d['verdict'].replace('_', ' ')}</title><style>{STYLE}{PLACE_STYLE}</style>"
    charts = json.dumps(_charts(found, powers), separators=(",", ":")).replace("<", "\\u003c")
    body = "".join(NEGATIVE.sub("\N{MINUS SIGN}", part) if "<svg" not in part else part for part in parts)
    script = f"<script>const P={charts};{SCRIPT}</script>"
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{body}{script}</body></html>\n"


def _views(scene) -> str:
    marks = marks_of(scene)
    place, further = projections(scene, marks), words.next_positions(scene.diagnosis.document)
    svgs = "".join(drawing(scene, marks, seen, corrected, further) for seen in place for corrected in (False, True))
    nowhere = [f"<b>{mark.number}</b> {escape(mark.title)}" for mark in marks if not mark.has_place]
    whole = f"<p class='note'>Of the whole place, without a spot of its own: {' '.join(nowhere)}</p>" if nowhere else ""
    alike = [f"<b>{mark.number}</b>: {escape(', '.join(mark.perhaps))}" for mark in marks if mark.perhaps]
    whole += f"<p class='note'>As likely owners: {'; '.join(alike)}.</p>" if alike else ""
    dark = sorted({*scene.base.mesh.names} - scene.lit - scene.shading)
    unlit = f" No path of any sounding meets {escape(listed(dark[:12]))}{', …' if len(dark) > 12 else ''}." if dark else ""
    return f"""<h2>The place</h2><div class="toggle"><input type="radio" name="state" id="show-before" checked>
<label for="show-before">twin as it is</label><input type="radio" name="state" id="show-after">
<label for="show-after">corrected twin</label>
<span class="scale">noise <span class="ramp" style="background:{ramp()}"></span> {scene.worst_db:.0f} dB over noise</span>
<div class="views">{svgs}</div></div>
<p class="note">Links have the colour of what is left unexplained; dashed: the vault, never fitted. Brown objects are met by
paths, pale ones only stand in the way of some, grey ones were lit by none and nothing is known of them.{unlit}
<span class="live">Wheel and drag zoom and move, a double click shows all; click on a link for its profile.</span></p>{whole}
<div id="chart"></div>"""


def _maps(scene, found, album: Album) -> str:
    if not found:
        return ""
    picture = album.image(lambda: maps.maps_figure(scene, found), "residual by delay and link, by time, and by direction")
    more = f" {len(found) - maps.MOST_LINKS} more in residual.npz." if len(found) > maps.MOST_LINKS else ""
    return (
        f"<h2>What is left, before and after</h2>{picture}<p class='note'>Above: by delay, a row per link, worst first.{more} "
        "Below it, of soundings at more than three instants: the worst link over time. Last: what an upright mirror explains, "
        "by the direction that it faces and its distance from the middle of the plan; clutter of known walls is in it.</p>"
        f"{album.note()}"
    )


def _powers(powers, album: Album) -> str:
    if not powers:
        return ""
    picture = album.image(lambda: maps.power_figure(powers), "power over time, measured, twin and corrected twin")
    more = f"<p class='note'>{len(powers) - maps.MOST_LINKS} more links.</p>" if len(powers) > maps.MOST_LINKS else ""
    return f"<h2>Power over time</h2>{picture}{more}"


def _table(scene) -> str:
    """Every link of every campaign, as numbers."""
    names = [name for name, *_ in scene.campaigns]
    rows = [
        f"<tr data-link='{escape(link)}'><td>{escape(link.replace('>', ' → '))}</td><td>{escape(names[number])}"
        f"{' (vault)' if number >= len(scene.diagnosis.ears) else ''}</td>"
        f"<td class='number'>{before:.1f}</td><td class='number'>{after:.1f}</td></tr>"
        for (number, link), (before, after) in sorted(scene.links.items(), key=lambda one: -one[1][0])[:MOST_CHARTS]
    ]
    head = "<th>link</th><th>campaign</th><th class='number'>twin / dB</th><th class='number'>corrected / dB</th>"
    return (
        f"<details><summary>All links</summary><table><tr>{head}</tr>{''.join(rows)}</table>"
        "<p class='note'>Energy of what is left over that of noise; noise alone is 0 dB.</p></details>"
    )


def _charts(found, powers) -> dict:
    """Curves of each link, for a click: name → charts with a title, axes and series."""
    out: dict = {}
    for one in found[:MOST_CHARTS]:
        series = [["twin", "was", _rounded(one.mean_db[0])], ["corrected twin", "is", _rounded(one.mean_db[1])]]
        out.setdefault(one.link, []).append(
            {
                "title": one.campaign,
                "x": _rounded(1e9 * one.delay_s),
                "axes": ["delay / ns", "left over noise / dB"],
                "series": series,
            }
        )
    for one in powers[:MOST_CHARTS]:
        curves = (("measured", "dots", one.measured_db), ("twin", "was", one.twin_db), ("corrected twin", "is", one.corrected_db))
        out.setdefault(one.link, []).append(
            {
                "title": one.campaign,
                "x": _rounded(one.time_s),
                "axes": ["time / s", "power / dB"],
                "series": [[name, kind, _rounded(values)] for name, kind, values in curves],
            }
        )
    return out


def _rounded(values: np.ndarray) -> list:
    step = max(1, -(-len(values) // _POINTS))
    return [float(np.round(v, 2)) if np.isfinite(v) else None for v in values[::step]]


def _use(d: dict) -> str:
    if not d["effects"]:
        return ""
    return (
        "<h2>Using the corrected twin</h2><p><code>"
        f"{escape(called('cast_scenario'))} create spec_corrected.yaml</code> traces it. As the twin of "
        "the next case what was found is known, and not accused again.</p>"
    )
