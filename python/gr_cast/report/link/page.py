# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of a link's diagnosis: one self-contained HTML page with its pictures, written for a radio engineer."""

import math
from functools import partial
from html import escape

import numpy as np

from ...core.figures import fixed
from ...core.programs import called
from ...core.units import db_from_amplitude, db_from_power
from ...diagnose.maps import power_of
from ...twin.effects import FAMILIES
from ..cards import cards
from ..pages import NEGATIVE, STYLE, Album, in_words, listed, runner_up
from .pictures import maps_figure, waterfall_figure

MOST_SHOWN = 3  # recordings with pictures


EXPERIMENTS = {
    "offset_carrier": "the same with the transmitter tuned 50 to 500 Hz away from the receiver",
    "move_carrier": "the same on another carrier frequency",
    "shaped_waveform": "a waveform whose envelope varies (root-raised-cosine QPSK, OFDM)",
    "complex_waveform": "a complex waveform (Zadoff–Chu, or the code turned by 45° in alternate periods)",
    "second_power": "the same at half the transmit amplitude",
    "second_rx_gain": "the same at another receiver gain",
    "mute_transmitter": "the receiver alone, with the transmitter muted",
    "second_link": "the same receiver with another transmitter, or the same transmitter with another receiver",
    "longer_recording": "the same for longer",
    "absolute_calibration": "the path's gain against a known level (absolute calibration)",
    "other_code_length": "the same with a code of another length",
}


def render(diagnosis) -> str:
    """The page as text; pictures that would come after the diagnosis's deadline are left out, and the page says so."""
    d, name, album = diagnosis.document, escape(diagnosis.case.name), Album(diagnosis.deadline)
    parts = [
        f"<h1>Diagnosis of {name}</h1>",
        f"<p class='verdict {d['verdict']}'>{escape(in_one_sentence(d))}</p>",
        *(f"<p>{escape(line)}</p>" for line in d["warnings"]),
        _next(d),
        _causes(diagnosis),
        _rest(diagnosis),
        _waterfall(diagnosis, album),
        _recordings(diagnosis),
        _maps(diagnosis, album),
        album.note(),
        _use(d),
        f"<p class='note'>Computed in {d.get('seconds', 0):.1f} s. Numbers stand with one standard deviation.</p>",
    ]
    head = "<meta charset='utf-8'><meta name='viewport' content='width=device-width'>"
    head += f"<title>{name}: {d['verdict'].replace('_', ' ')}</title>"
    body = NEGATIVE.sub("\N{MINUS SIGN}", "".join(parts))
    return f"<!doctype html><html lang='en'><head>{head}<style>{STYLE}</style></head><body>{body}</body></html>\n"


def in_one_sentence(d: dict) -> str:
    """The verdict as a radio engineer would say it, and whether the time was over before it."""
    over = " The time was over before all was weighed: a larger --budget may find more."
    return _verdict(d) + (over if d["residual"]["out_of_time"] else "")


def _verdict(d: dict) -> str:
    names = listed([in_words(e["family"]) for e in d["effects"]])
    fit, left, unseen = d["fit"], d["residual"], "on samples that took no part in the fit"
    falls = "falls" if fit["corrected_nmse_db"] < fit["twin_nmse_db"] - 0.005 else "goes"
    fall = f"the residual {falls} from {_span(fit['twin_nmse_db'], fit['corrected_nmse_db'])} dB"
    change = f"with {'them' if len(d['effects']) > 1 else 'it'} {fall} ({_noise(fit)}) {unseen}"
    if d["verdict"] == "no_mismatch":
        level = f"residual {fit['corrected_nmse_db']:.1f} dB, {_noise(fit)} {unseen}"
        return f"No mismatch: the twin explains the recordings down to their noise ({level})."
    if d["verdict"] == "identified":
        return f"Identified: the twin leaves out {names}; {change}."
    if d["verdict"] == "ambiguous":
        pairs = "; ".join(" or ".join(in_words(f) for f in a["families"]) for a in d["ambiguous"])
        return f"Ambiguous: it is {pairs}, and this case cannot tell which."
    if not left["where"]:
        unsure = f"{names}; the list is likelier wrong than the whole truth"
        return f"Unexplained: {unsure if left['record_next'] else (names or 'nothing') + ' so far'}."
    absent = [w for w in left["where"] if w.get("signal_absent")]
    if absent:
        return f"Unexplained: {listed(sorted({w['recording'] for w in absent}))}: {absent[0]['sentence']}"
    if all("confidence" in w for w in left["where"]):
        return f"Unexplained: {listed([in_words(w['test']) for w in left['where']])}."
    by = f", by {left['unexplained_db']:.2g} dB in its loudest test" if left["unexplained_db"] else ""
    unknown = "" if left["out_of_time"] else ", and no known physics explains it"
    stays = f"The residual is {fit['corrected_nmse_db']:.1f} dB ({_noise(fit)}) {unseen}"
    return f"Unexplained: what is left is not noise{by}{unknown}. {f'Found so far: {names}; {change}' if names else stays}."


def _noise(fit: dict) -> str:
    """The noise beside the residual, which lies below it where the twin tells too much of it."""
    is_below = fit["corrected_nmse_db"] < fit["noise_floor_db"] - 0.5
    return f"noise {'was taken to be ' if is_below else ''}{fit['noise_floor_db']:.1f} dB"


def _span(before_db: float, after_db: float) -> str:
    """Two levels with as many digits as tell them apart."""
    digits = 1 if abs(before_db - after_db) > 0.5 else 2
    return f"{before_db:.{digits}f} to {after_db:.{digits}f}"


def _next(d: dict) -> str:
    """What to record next, and why."""
    rows = "".join(
        f"<p><b>Record next: {escape(EXPERIMENTS[a['record_next']])}</b> "
        f"(<code>{a['record_next']}</code>). {escape(' '.join(in_words(word) for word in a['why'].split()))}</p>"
        for a in d["ambiguous"]
    )
    if d["residual"]["out_of_time"]:
        rows = f"<p><b>First diagnose with a larger <code>--budget</code></b>: the time was over.</p>{rows}"
    if further := d["residual"]["record_next"]:
        why = "what is left may show what it is" if d["residual"]["where"] else "a list that is not sure may become it"
        rows += f"<p><b>Record next: {escape(EXPERIMENTS[further])}</b> (<code>{further}</code>): {why}.</p>"
    return rows and f"<div class='next'>{rows}</div>"


def _causes(diagnosis) -> str:
    d, alone = diagnosis.document, len(diagnosis.case.observations) == 1

    def lines(e: dict) -> dict[str, str]:
        return {
            "Whose": escape(_owner(e["owner"])),
            "Where": escape(_place(e["where"], alone)),
            "Explains": _explained(e),
            "Evidence": _unseen(e["evidence"]["heldout_gain_nats"]),
            "Runner-up": escape(runner_up(e, d, "fits")),
        }

    return cards(d, lines)


def _unseen(held_out: float | None) -> str:
    """What an effect is worth on samples that no fit saw."""
    return "not worked out" if held_out is None else f"{held_out:,.0f} nats are lost without it, on samples that no fit saw"


def _owner(owner: dict) -> str:
    said = {"tx": "transmitter ", "rx": "receiver ", "link": "the link ", "environment": "the surroundings"}
    text = said[owner["level"]] + ("" if owner["level"] == "environment" else owner["name"].replace(">", " → "))
    others = [f"{said[o['level']]}{o['name']}" for o in owner.get("alternatives", [])]
    return text + (f"; it could as well be {listed(others)}: one link alone cannot tell" if others else "")


def _explained(e: dict) -> str:
    """dB by which the residual falls with an effect, in the recording that shows it most."""
    explains_db, names = e["evidence"]["explains_db"], e["where"]["recording"]
    if explains_db is None:
        return "noise, not signal: its level is the number above" if FAMILIES[e["family"]].noise_like else "not worked out"
    return f"{explains_db:.2f} dB of residual" + ("" if isinstance(names, str) else ", where it shows most")


def _place(where: dict, alone: bool) -> str:
    """Where an effect is, in words; what it fills is said as such, and a recording that is alone has no need of a name."""
    texts = []
    for axis, scale, unit in (("delay_s", 1e6, "µs of delay"), ("time_s", 1e3, "ms"), ("frequency_hz", 1e-3, "kHz")):
        if where.get(axis) and not _everywhere(axis, where[axis]):
            low, high = (scale * v for v in where[axis])
            digits = int(np.clip(2 - np.floor(np.log10(max(high - low, 1e-9))), 0, 6))
            texts.append(f"{low:.{digits}f} to {high:.{digits}f} {unit}")
    if where.get("amplitude"):
        texts.append(f"amplitudes of {where['amplitude'][0]:.3g} to {where['amplitude'][1]:.3g}")
    names = None if alone else where.get("recording")
    shown = names if isinstance(names, str) else f"{len(names)} recordings" if names and len(names) > 3 else listed(names or [])
    return "; ".join(texts or ["everywhere, all the time"]) + (f"; in {shown}" if shown else "")


def _everywhere(axis: str, interval: list) -> bool:
    """Whether an interval is the whole recording or the whole band, which need not be said."""
    return axis == "frequency_hz" and interval[0] == -interval[1] or axis == "time_s" and interval[0] == 0.0


def _rest(diagnosis) -> str:
    d, alone = diagnosis.document, len(diagnosis.case.observations) == 1
    left = d["residual"]["where"]
    if not left:
        tested = listed([in_words(name) for name in d["residual"]["tested"]])
        untested = "What is left was not tested: the time was over."
        said = f"Nothing that noise would not leave, over {tested}." if tested else untested
        return f"<h2>What is left</h2><p>{escape(said)}</p>"
    rows = "".join(f"<li>{escape(in_words(w['test']))}: {escape(w.get('sentence') or _place(w, alone))}</li>" for w in left)
    p = d["residual"]["p_value"]
    if all(w.get("signal_absent") for w in left):
        return f"<h2>What is left</h2><p>All of it:</p><ul>{rows}</ul>"
    if all("confidence" in w for w in left):
        return f"<h2>What is left</h2><p>Nothing that is sure:</p><ul>{rows}</ul>"
    chance = f"noise alone does so once in {1 / p:.0e}" if p > 1e-30 else "noise alone never does so"
    return f"<h2>What is left</h2><p>More than noise ({chance}), seen in the residual over</p><ul>{rows}</ul>"


def _shown(diagnosis) -> list:
    """The findings worth a picture: where something is left, then where most was explained."""
    order = sorted(diagnosis.findings, key=lambda f: (-len(f.left), -f.twin.sigma2 / f.fit.sigma2))
    return order[:MOST_SHOWN]


def _waterfall(diagnosis, album: Album) -> str:
    if not diagnosis.document["effects"]:
        return ""
    most = max(diagnosis.findings, key=lambda f: f.twin.sigma2 / f.fit.sigma2)
    claimed = {e["family"] for e in diagnosis.document["effects"]}
    picture = album.image(lambda: waterfall_figure(most, claimed), "residual by cause")
    return f"<h2>Residual by cause: {escape(_title(most, diagnosis))}</h2>{picture}" if picture else ""


def _title(finding, diagnosis) -> str:
    """A recording's name, with its time where it is one part of several."""
    name = finding.observation.name
    if sum(f.observation.name == name for f in diagnosis.findings) == 1:
        return name
    first = finding.observation.first / finding.scene.sample_rate_hz
    return f"{name}, {1e3 * first:.4g} to {1e3 * (first + finding.scene.duration_s):.4g} ms"


def _late_s(finding) -> float:
    """By how much the twin's paths are later in a recording than they say; of a repeated waveform within its period."""
    scene = finding.scene
    late = scene.anchor + finding.fit.model.base[0] + finding.observation.first
    if scene.sources[0].repeat:
        period = math.lcm(*(len(source.samples) for source in scene.sources))
        late -= period * np.floor((late + 0.5) / period)
    return late / scene.sample_rate_hz


def _recordings(diagnosis) -> str:
    """What was recorded, in order of time, and how well it is explained; gain and delay, which no twin claims, as measured."""
    rows, names = [], [o.name for o in diagnosis.case.observations]
    for f in sorted(diagnosis.findings, key=lambda f: (names.index(f.observation.name), f.observation.first)):
        o = f.observation
        power = float(np.mean(np.abs(f.data.y[f.data.use > 0]) ** 2))
        before, after = (f"{db_from_power(power_of(fit) / power):.2f}" for fit in (f.twin, f.fit))
        told = "–" if not f.data.noise_power else f"{db_from_power(f.data.noise_power / power):.2f}"
        gain_db = db_from_amplitude(abs(complex(*f.fit.model.base[1:3])))
        heard = ["–", "–"] if f.absent else [f"{gain_db:.2f}", fixed(1e6 * _late_s(f), 4)]
        cells = [f"{1e3 * f.scene.duration_s:.4g}", f"{db_from_power(power):.1f}", *heard, before, after, told]
        link = f"{', '.join(o.on_air)} → {o.receiver}"
        rows.append(
            f"<tr><td>{escape(_title(f, diagnosis))}</td><td>{escape(link)}</td>"
            + "".join(f"<td class='number'>{c}</td>" for c in cells)
            + "</tr>"
        )
    heads = ("ms", "power / dBFS", "gain / dB", "delay / µs", "twin / dB", "corrected / dB", "noise told / dB")
    head = "<th>recording</th><th>link</th>" + "".join(f"<th class='number'>{h}</th>" for h in heads)
    fit = diagnosis.document["fit"]
    vault = (
        f"On the vault, which nothing was chosen or fitted on: twin {fit['twin_nmse_db']:.2f} dB, corrected "
        f"{fit['corrected_nmse_db']:.2f} dB, noise {fit['noise_floor_db']:.2f} dB."
    )
    note = (
        "Residuals are relative to the recorded power. Gain and delay, which the twin does not claim, are what was measured on "
        "top of its paths; a delay counts from the recording's first sample, of a repeated waveform within its period."
    )
    return f"<h2>Recordings</h2><p>{vault}</p><table><tr>{head}</tr>{''.join(rows)}</table><p class='note'>{note}</p>"


def _maps(diagnosis, album: Album) -> str:
    d, pages = diagnosis.document, []
    for finding in _shown(diagnosis):
        name = finding.observation.name
        here = [e["where"] if name in np.atleast_1d(e["where"]["recording"]) else {} for e in d["effects"]]
        left = [{**r.where} for r in finding.left]
        draw = partial(maps_figure, finding, here, left)
        if picture := album.image(draw, "maps of the residual before and after"):
            pages.append(f"<h2>Before and after: {escape(_title(finding, diagnosis))}</h2>{picture}")
    if not pages:
        return ""
    more = len(diagnosis.findings) - MOST_SHOWN
    rest = f"<p class='note'>{more} more in residual.npz.</p>" if more > 0 else ""
    framed = "Numbered frames: where a cause was found. " if d["effects"] else ""
    framed += "Red frames: what is left; what is everywhere has no frame. " if d["residual"]["where"] else ""
    return "".join(pages) + f"<p class='note'>{framed}White: no sample is used. Left and right share their scales.</p>" + rest


def _use(d: dict) -> str:
    if not d["effects"]:
        return ""
    return (
        f"<h2>Using the corrected twin</h2><p><code>{escape(called('cast_emulator'))} play --twin twin_corrected.yaml "
        "--output FOLDER</code> "
        "records what it would receive, with <code>--amplitude</code>, <code>--carrier</code> and <code>--duration</code> also "
        "what nobody has recorded yet. As the twin of the next case its effects are known and not accused again.</p>"
    )
