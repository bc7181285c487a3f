# SPDX-License-Identifier: GPL-3.0-or-later
"""A rehearsed batch job as one page that needs no other file."""

from html import escape
from itertools import pairwise

_STYLE = """body{font:15px/1.45 sans-serif;margin:1.5em;max-width:75em}table{border-collapse:collapse;margin:.6em 0}
td,th{border:1px solid #ccc;padding:.2em .6em;text-align:left;vertical-align:top}th{background:#f3f1ec}
.fault{color:#a11}pre{margin:0;white-space:pre-wrap;max-width:40em;max-height:12em;overflow:auto}
.bar{fill:#ccc}.OFF{fill:#999}.BOOTING{fill:#e3c567}.READY{fill:#7fb3d5}.ACTIVE{fill:#5dae68}.STOPPING{fill:#d9903d}
.FINISHED{fill:#2f6b3a}.ERROR{fill:#c0392b}svg text{font-size:12px}"""
_STATES = ("OFF", "BOOTING", "READY", "ACTIVE", "STOPPING", "FINISHED", "ERROR")
_WIDTH, _LEFT, _ROW = 900.0, 130.0, 24.0


def page(document: dict) -> str:
    """The page of a report's document."""
    d = document
    head = f"{d['job']}: {d['outcome']} in {d['seconds']:.0f} s"
    about = (
        f"RF scenario {d['rf_scenario']}, traffic scenario {d['traffic_scenario']}, Duration {d['duration_s']} s, profile"
        f" {d['profile']}, time scale {d['time_scale']:g}; base loss {d['channel']['base_loss_db']:g} dB,"
        f" {d['channel']['rate_hz']:g} samples/s."
    )
    parts = [
        f"<h1>{escape(head)}</h1><p>{escape(about)}</p>",
        _faults(d["faults"]),
        "<h2>States</h2>",
        _timeline(d),
        _emulator(d),
    ]
    if d["traffic"]:
        keys = ("flow", "from", "to", "sent", "received", "loss", "throughput_bps", "latency_s_median")
        parts += ["<h2>Traffic</h2>", _table(keys, [[_figure(row[key]) for key in keys] for row in d["traffic"]])]
    parts.append("<h2>Nodes</h2>")
    for node in d["nodes"]:
        parts.append(
            f"<h3>{escape(node['host'])}</h3><p>RF node {node['rf_node']}, traffic node {node['traffic_node']}, image"
            f" {escape(node['image'])} ({node['image_sha256'][:12]}), {node['disk_bytes'] / 1e6:.1f} MB written.</p>"
        )
        rows = [
            [f"{c['at_s']:.1f}", escape(c["script"]), "–" if c["status"] is None else str(c["status"]), f"{c['seconds']:.2f}",
             f"<pre>{escape(c['printed'] + c['errors'])}</pre>", f"<span class=fault>{escape('; '.join(c['faults']))}</span>"]
            for c in node["calls"]
        ]  # fmt: skip
        parts.append(_table(("at s", "script", "exit", "seconds", "printed", "wrong"), rows))
        if node["logs"]:
            links = ", ".join(f'<a href="{escape(path, quote=True)}">{escape(path)}</a>' for path in node["logs"][:200])
            parts.append(f"<p>/logs: {links}</p>")
    return f"<!doctype html><meta charset=utf-8><title>{escape(head)}</title><style>{_STYLE}</style>{''.join(parts)}\n"


def _faults(faults: list[str]) -> str:
    if not faults:
        return "<p>No fault.</p>"
    return "<h2>Faults</h2><ul>" + "".join(f"<li class=fault>{escape(fault)}</li>" for fault in faults) + "</ul>"


def _emulator(document: dict) -> str:
    figures = document["emulator"]
    if not figures:
        return ""
    waits = f", waits for {escape(', '.join(figures['waiting_for']))}" if figures["waiting_for"] else ""
    return (
        f"<p>Emulator: {figures['samples']} samples, real-time factor {figures['real_time_factor']:.2g} at its fastest,"
        f" {figures['late_updates']} late updates, {figures['clipped_samples']} clipped samples{waits}.</p>"
    )


def _timeline(document: dict) -> str:
    """A row per node, coloured by its state over time."""
    total_s = max(document["seconds"], 1e-9)

    def x(at_s: float) -> float:
        return _LEFT + (_WIDTH - _LEFT) * at_s / total_s

    height = _ROW * (len(document["nodes"]) + 2)
    lines = [f'<svg viewBox="0 0 {_WIDTH:g} {height:g}">']
    for row, node in enumerate(document["nodes"]):
        y = _ROW * row
        lines.append(f'<text x="0" y="{y + 16:g}">{escape(node["host"])}</text>')
        for state, after in pairwise([*node["states"], {"at_s": total_s}]):
            name, begin, end = state["state"], x(state["at_s"]), x(after["at_s"])
            lines.append(
                f'<rect class="{name}" x="{begin:.1f}" y="{y + 3:g}" height="{_ROW - 6:g}" width="{max(end - begin, 0.5):.1f}">'
                f"<title>{name} {escape(state['info'], quote=True)}</title></rect>"
            )
    y = _ROW * len(document["nodes"])
    for event in document["events"]:
        at = x(event["at_s"])
        lines.append(
            f'<line x1="{at:.1f}" x2="{at:.1f}" y1="0" y2="{y:g}" stroke="#222"><title>{escape(event["event"])}</title></line>'
        )
    lines += [f'<text x="{x(s):.1f}" y="{y + 14:g}">{s:.0f} s</text>' for s in (0, total_s / 2, total_s * 0.96)]
    for place, state in enumerate(_STATES):
        at = _LEFT + 105 * place
        lines.append(
            f'<rect class="{state}" x="{at:g}" y="{y + 24:g}" width="12" height="12"/>'
            f'<text x="{at + 17:g}" y="{y + 35:g}">{state}</text>'
        )
    return "".join(lines) + "</svg>"


def _table(heads: tuple[str, ...], rows: list[list[str]]) -> str:
    head = "".join(f"<th>{escape(text)}</th>" for text in heads)
    body = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _figure(value) -> str:
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else escape(str(value))
