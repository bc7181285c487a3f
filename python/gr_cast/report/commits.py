# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of a stack's pipeline: commits × sites with their verdicts, what was measured behind each, figures over commits."""

import time
from html import escape

import numpy as np
from matplotlib.figure import Figure

from ..pipeline.verdict import DIFFER, FAILS, OPEN, SAME, WORSE
from .pages import NEGATIVE, STYLE, Album

SHORT = {SAME: "same", WORSE: "worse", DIFFER: "differs", OPEN: "open", FAILS: "fails"}
MOST_COMMITS = 200  # on one page, the newest
MOST_PICTURES = 24
PAGE_S = 60.0  # of processor time for pictures
_STYLE = (
    STYLE
    + """
body{max-width:80rem}
.mark{display:inline-block;padding:0 .5rem;border-radius:.2rem;color:#fff;font-size:.85rem;white-space:nowrap}
.same{background:#3b7a57}.worse,.fails{background:#8b1a1a}.differs{background:#b3541e}.open{background:#8a6a00}
.none{color:#5b6b7a}details{margin:.2rem 0}summary{cursor:pointer}td.words{max-width:34rem}td.words p{margin:.2rem 0}
.wide{overflow-x:auto}.pictures{margin-top:1.5rem;display:grid;grid-template-columns:repeat(auto-fill,minmax(24rem,1fr));gap:1rem}
"""
)


def render(histories: dict[str, list[dict]], title: str = "Commits on twin and testbed") -> str:
    """One self-contained page; links lead to reports in the storage that the page lies in."""
    parts = [f"<h1>{escape(title)}</h1>"]
    if not histories:
        parts.append("<p class='note'>No commit has been judged yet.</p>")
    album = Album(time.thread_time() + PAGE_S)
    for name, commits in histories.items():
        parts += [f"<h2>{escape(name)}</h2>", _table(commits[-MOST_COMMITS:]), _pictures(commits[-MOST_COMMITS:], album)]
    head = "<meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
    head += f"<title>{escape(title)}</title><style>{_STYLE}</style>"
    body = NEGATIVE.sub("\N{MINUS SIGN}", "".join(parts))
    return f"<!doctype html><html lang='en'><head>{head}</head><body>{body}</body></html>\n"


def _table(commits: list[dict]) -> str:
    sites = list(dict.fromkeys(site for one in commits for site in one["sites"]))
    head = "".join(f"<th>{escape(site)}</th>" for site in sites)
    rows = "".join(_row(one, sites) for one in reversed(commits))
    return f"<div class='wide'><table><tr><th>commit</th>{head}<th>verdict</th><th>image</th></tr>{rows}</table></div>"


def _row(one: dict, sites: list[str]) -> str:
    date = time.strftime("%Y-%m-%d %H:%M", time.gmtime(one["time_s"]))
    who = f"<code>{one['commit'][:10]}</code><br>{escape(one['subject'])}<br><span class='note'>{date} UTC</span>"
    cells = "".join(f"<td>{_mark(one, site)}</td>" for site in sites)
    words = "".join(f"<p><b>{escape(v['kind'])}</b>: {escape(v['sentence'])}{_report(v)}</p>" for v in one["verdicts"])
    picture = f"<code>{one['image'][:12]}</code><br><span class='note'>{escape(one['room'])}</span>" if one["image"] else "–"
    return (
        f"<tr id='{one['commit'][:10]}'><td>{who}</td>{cells}<td class='words'>{words}{_behind(one)}</td><td>{picture}</td></tr>"
    )


def _mark(one: dict, site: str) -> str:
    """What is to be said of a site: the twin is the measure of the others, and has nothing to differ from."""
    if site not in one["sites"]:
        return "<span class='none'>not tried</span>"
    here = [v["kind"] for v in one["verdicts"] if v["site"] == site]
    everywhere = [v["kind"] for v in one["verdicts"] if v["site"] is None]
    said = next((SHORT[kind] for kind in (FAILS, DIFFER, WORSE, OPEN, SAME) if kind in here + everywhere), "same")
    return f"<span class='mark {said}'>{said}</span>"


def _report(verdict: dict) -> str:
    folder = (verdict.get("cause") or {}).get("folder")
    return f" <a href='stages/{escape(folder)}/diagnosis/report.html'>diagnosis</a>" if folder else ""


def _behind(one: dict) -> str:
    rows = "".join(
        f"<tr><td>{escape(c['site'])} against {'the twin' if c['against'] == 'sites' else 'the baseline'}</td>"
        f"<td>{escape(c['experiment'])}</td><td>{escape(c['metric'])} of {escape(c['node'])}</td>"
        f"<td class='number'>{c['difference']['mean']:+.3g}</td>"
        f"<td class='number'>{c['difference']['low']:+.3g} to {c['difference']['high']:+.3g}</td>"
        f"<td class='number'>{c['tolerance']:g}</td><td>{escape(c['unit'])}</td><td>{c['says']}</td></tr>"
        for c in one["comparisons"]
    )
    if not rows:
        return ""
    head = "".join(
        f"<th>{name}</th>" for name in ("what", "experiment", "metric", "mean", "interval", "tolerance", "unit", "says")
    )
    alike = "".join(
        f"<p class='note'>{escape(s['series'])} in {escape(s['experiment'])} at {escape(s['site'])}: similarity ρ "
        f"{'not defined' if s['rho'] is None else format(s['rho'], '.3f')}. {escape(' '.join(s['blind_spots']))}</p>"
        for s in one.get("similarity", ())
    )
    return f"<details><summary>measured</summary><table><tr>{head}</tr>{rows}</table>{alike}</details>"


def _pictures(commits: list[dict], album: Album) -> str:
    """Every metric over the commits, a line per site."""
    found: dict[tuple, dict] = {}
    for place, one in enumerate(commits):
        for figure in one.get("figures", ()):
            if figure["values"]:
                lines = found.setdefault((figure["experiment"], figure["metric"]), {})
                lines.setdefault(figure["site"], []).append((place, figure["values"]))
    names = [one["commit"][:7] for one in commits]
    shown = [
        album.image(lambda key=key, lines=lines: _trend(key, lines, names), f"{key[1]} in {key[0]} over commits")
        for key, lines in list(found.items())[:MOST_PICTURES]
    ]
    return f"<div class='pictures'>{''.join(shown)}</div>{album.note()}" if shown else ""


def _trend(key: tuple[str, str], lines: dict, names: list[str]) -> Figure:
    figure = Figure(figsize=(5.2, 2.6), layout="constrained")
    axes = figure.add_subplot()
    for number, (site, points) in enumerate(lines.items()):
        place = np.array([at for at, _ in points]) + 0.08 * (number - (len(lines) - 1) / 2)
        mean = np.array([np.mean(values) for _, values in points])
        reach = np.array([[m - min(v), max(v) - m] for m, (_, v) in zip(mean, points, strict=True)]).T
        axes.errorbar(place, mean, reach, marker="os^v"[number % 4], markersize=4, linewidth=1, capsize=2, label=site)
    step = max(1, len(names) // 8)
    axes.set_xlim(-0.5, len(names) - 0.5)  # sites of one commit stand together, however few commits there are
    axes.set_xticks(range(0, len(names), step), names[::step], fontsize=7, rotation=30, ha="right")
    node, _, metric = key[1].rpartition(" ")
    axes.set_title(f"{metric} of node {node}, {key[0]}: mean, smallest and largest", fontsize=8)
    axes.tick_params(axis="y", labelsize=7)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=7)
    return figure
