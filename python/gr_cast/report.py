# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a diagnosis: one self-contained HTML page with its pictures, written for a radio engineer."""

import base64
import io
from html import escape

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from .diagnose.residual import delay_time, time_frequency

INK, ACCENT, FAINT = "#1b2733", "#b3541e", "#8a99a8"
STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#1b2733;max-width:60rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin-bottom:.2rem} h2{font-size:1.15rem;margin:2rem 0 .4rem;border-bottom:1px solid
#d5dce3}
.verdict{font-size:1.2rem;padding:.7rem 1rem;border-left:.4rem solid;background:#f5f7f9;margin:1rem 0}
.identified{border-color:#b3541e}.no_mismatch{border-color:#3b7a57}.ambiguous{border-
color:#b8860b}.unexplained{border-color:#8b1a1a}
table{border-collapse:collapse;width:100%;font-size:.92rem} th,td{text-align:left;padding:.3rem
.6rem;border-bottom:1px solid #e3e8ed;vertical-align:top}
img{max-width:100%} small,.note{color:#5b6b7a} td.number{font-variant-numeric:tabular-nums;white-space:nowrap}
"""


def render(diagnosis) -> str:
    """The page as text."""
    d, name = diagnosis.document, escape(diagnosis.case.name)
    parts = [
        f"<h1>Diagnosis of {name}</h1>",
        f"<p class='verdict {d['verdict']}'>{escape(in_one_sentence(d))}</p>",
        _causes(d),
        _ambiguous(d),
        _rest(d),
        _fit(d),
        _pictures(diagnosis),
        f"<p class='note'>Computed in {d.get('seconds', 0):.1f} s. Numbers are given with one standard deviation.</p>",
    ]
    head = "<meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
    head += f"<title>{name}: {d['verdict']}</title>"
    return f"<!doctype html><html lang='en'><head>{head}<style>{STYLE}</style></head><body>{''.join(parts)}</body></html>\n"


def in_one_sentence(d: dict) -> str:
    """The verdict as a radio engineer would say it."""
    names = _listed([e["family"].replace("_", " ") for e in d["effects"]])
    fit = d["fit"]
    change = (
        f"the residual falls from {fit['twin_nmse_db']:.1f} to {fit['corrected_nmse_db']:.1f} dB "
        f"(noise floor {fit['noise_floor_db']:.1f} dB) on samples that took no part in the fit"
    )
    if d["verdict"] == "no_mismatch":
        return f"No mismatch: the twin explains the recordings down to their noise ({fit['corrected_nmse_db']:.1f} dB)."
    if d["verdict"] == "identified":
        return f"Identified: the twin leaves out {names}; with it {change}."
    if d["verdict"] == "ambiguous":
        pairs = "; ".join(" or ".join(f.replace("_", " ") for f in a["families"]) for a in d["ambiguous"])
        wish = _listed(sorted({a["record_next"].replace("_", " ") for a in d["ambiguous"]}))
        return f"Ambiguous: {pairs} fit alike. To decide, record: {wish}."
    found = f" Found so far: {names}." if names else ""
    return f"Unexplained: something is left that no known physics explains.{found}"


def _listed(words: list[str]) -> str:
    words = list(dict.fromkeys(words))
    return words[0] if len(words) == 1 else ", ".join(words[:-1]) + " and " + words[-1] if words else ""


def _causes(d: dict) -> str:
    if not d["effects"]:
        return ""
    rows = []
    for e in d["effects"]:
        owner = e["owner"]
        whose = owner["name"] + "".join(f" <small>(or {escape(o['name'])})</small>" for o in owner.get("alternatives", []))
        evidence = e["evidence"]
        rival = (
            f"{evidence['runner_up']}, {evidence['runner_up_margin_nats']:.0f} nats behind" if evidence["runner_up"] else "none"
        )
        rows.append(
            f"<tr><td><b>{e['family'].replace('_', ' ')}</b><br>{escape(e['sentence'])}</td><td>{whose}</td>"
            f"<td>{escape(_place(e['where']))}</td>"
            f"<td class='number'>{evidence['heldout_gain_nats']:.0f} nats</td>"
            f"<td>{escape(rival.replace('_', ' '))}</td><td class='number'>{e['confidence']:.2f}</td></tr>"
        )
    head = "".join(f"<th>{h}</th>" for h in ("Cause", "Whose", "Where", "Evidence", "Runner-up", "Confidence"))
    return f"<h2>What the twin leaves out</h2><table><tr>{head}</tr>{''.join(rows)}</table>"


def _place(where: dict) -> str:
    texts = []
    for axis, scale, unit in (("delay_s", 1e6, "µs"), ("time_s", 1e3, "ms"), ("frequency_hz", 1e-3, "kHz")):
        if where.get(axis) and not _everywhere(axis, where[axis]):
            low, high = where[axis]
            texts.append(f"{low * scale:.4g} to {high * scale:.4g} {unit}")
    names = where.get("recording")
    if names:
        texts.append(names if isinstance(names, str) else f"{len(names)} recordings")
    return "; ".join(texts)


def _everywhere(axis: str, interval: list) -> bool:
    """Whether an interval is the whole recording or the whole band, which need not be said."""
    return axis == "frequency_hz" and interval[0] == -interval[1] or axis == "time_s" and interval[0] == 0.0


def _ambiguous(d: dict) -> str:
    if not d["ambiguous"]:
        return ""
    rows = "".join(
        f"<li>{escape(a['why'])} Record next: <b>{escape(a['record_next'].replace('_', ' '))}</b>.</li>" for a in d["ambiguous"]
    )
    return f"<h2>What cannot be told apart, and what to record next</h2><ul>{rows}</ul>"


def _rest(d: dict) -> str:
    left = d["residual"]["where"]
    if not left:
        return "<h2>What is left</h2><p>Nothing that noise would not leave.</p>"
    rows = "".join(f"<li>in {escape(w['test'])}: {escape(_place(w)) or 'everywhere'}</li>" for w in left)
    return f"<h2>What is left</h2><p>About {d['residual']['unexplained_db']:.2f} dB over the noise, seen</p><ul>{rows}</ul>"


def _fit(d: dict) -> str:
    f = d["fit"]
    rows = "".join(
        f"<tr><td>{label}</td><td class='number'>{f[key]:.2f} dB</td></tr>"
        for label, key in (
            ("Twin as it is", "twin_nmse_db"),
            ("Corrected twin", "corrected_nmse_db"),
            ("Noise floor", "noise_floor_db"),
        )
    )
    return f"<h2>Fit on unseen samples</h2><table><tr><th>Model</th><th>Residual over recorded power</th></tr>{rows}</table>"


def _pictures(diagnosis) -> str:
    shown = sorted(diagnosis.findings, key=lambda f: -f.twin.sigma2 / f.fit.sigma2)[:3]
    pages = [f"<h2>Before and after: {escape(f.observation.name)}</h2>{_image(_maps(f))}" for f in shown]
    if diagnosis.document["effects"]:
        pages.insert(0, f"<h2>Residual by cause</h2>{_image(_waterfall(shown[0]))}")
    return "".join(pages)


def _image(figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    plt.close(figure)
    return f"<img alt='' src='data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}'>"


def _maps(finding):
    """Residual power before and after, over time × frequency and delay × time, in dB over the noise."""
    figure, axes = plt.subplots(2, 2, figsize=(9.5, 6.2), layout="constrained")
    scene, floor = finding.scene, finding.fit.sigma2
    for column, (label, fit) in enumerate((("twin as it is", finding.twin), ("corrected twin", finding.fit))):
        energy, count = time_frequency(fit)
        level = 10 * np.log10(np.fft.fftshift(energy / np.maximum(count, 1e-9), axes=1).T * fit.sigma2 / floor + 1e-6)
        half, span = scene.sample_rate_hz / 2e6, scene.duration_s * 1e3
        picture = axes[0, column].imshow(
            level,
            aspect="auto",
            origin="lower",
            extent=[0, span, -half, half],
            vmin=-2,
            vmax=12,
            cmap="magma",
        )
        axes[0, column].set(title=label, xlabel="time / ms", ylabel="frequency / MHz")
        delays, paths = delay_time(fit)
        level = 10 * np.log10(paths.T * fit.sigma2 / floor + 1e-6)
        extent = [0, span, delays[0] * 1e6, delays[-1] * 1e6]
        axes[1, column].imshow(level, aspect="auto", origin="lower", extent=extent, vmin=-2, vmax=12, cmap="magma")
        axes[1, column].set(xlabel="time / ms", ylabel="delay / µs")
    figure.colorbar(picture, ax=axes, label="residual over noise / dB", shrink=0.7)
    return figure


def _waterfall(finding):
    """What each cause adds to the residual: dB that come back when it alone is taken out of the corrected
    twin."""
    names, levels = ["twin as it is"], [10 * np.log10(finding.twin.sigma2 / finding.fit.sigma2)]
    for i, effect in enumerate(finding.fit.model.effects):
        if not effect.fixed and "nats" not in effect.aux:
            share = finding.gain_of(i) / finding.fit.data.count
            names.append("without " + effect.family.replace("_", " "))
            levels.append(10 / np.log(10) * max(share, 0.0))
    names.append("corrected twin")
    levels.append(0.0)
    figure, axis = plt.subplots(figsize=(9.5, 0.6 + 0.42 * len(names)), layout="constrained")
    colours = [INK, *[ACCENT] * (len(names) - 2), FAINT]
    bars = axis.barh(names[::-1], levels[::-1], color=colours[::-1])
    axis.bar_label(bars, fmt=" %.2f dB", fontsize=9)
    axis.set(xlabel="residual over that of the corrected twin / dB", xlim=(0, max(max(levels) * 1.15, 0.1)))
    axis.spines[["top", "right"]].set_visible(False)
    return figure
