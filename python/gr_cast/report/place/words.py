# SPDX-License-Identifier: GPL-3.0-or-later
"""What a page says: the verdict in one sentence, each effect with its numbers and why it is believed."""

from html import escape

import numpy as np

from ...twin.places.families import FAMILIES
from ..cards import cards
from ..pages import in_words, listed, runner_up

NEXT = {
    "synchronise": "the same with clocks that are synchronised, so that delays are known",
    "calibrate_gain": "the same with gains that are calibrated",
    "second_carrier": "the same on another carrier",
    "wider_band": "the same with a wider band",
    "measure_phase": "the same with phases that are kept from one response to the next",
    "longer_recording": "the same for longer",
}
UNITS = {  # the end of a parameter's name, the longer one first
    "db_per_m": "dB/m", "_m_per_s": "m/s", "_rad": "rad", "_hz": "Hz", "_db": "dB", "_m": "m", "_s": "s", "conductivity": "S/m",
}  # fmt: skip
_SCALES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"), (1e-12, "p"))
_SCALED = ("Hz", "s")
_MOST_DIGITS = (4, 6)  # a tenth of a millimetre; of what has a prefix


def verdict(d: dict) -> str:
    names = listed([in_words(one["family"]) for one in d["effects"]])
    fit = fit_in_words(d["fit"])
    if d["verdict"] == "no_mismatch":
        return f"No mismatch: the twin explains all that was sounded, down to the noise ({fit})."
    if d["verdict"] == "identified":
        return f"Identified: the twin leaves out {names}; with {'them' if len(d['effects']) > 1 else 'it'} {fit}."
    if d["verdict"] == "ambiguous":
        pairs = "; ".join(" or ".join(in_words(name) for name in one["families"]) for one in d["ambiguous"])
        rest = [in_words(e["family"]) for e in d["effects"] if all(e["family"] not in a["families"] for a in d["ambiguous"])]
        sure = f" Beside it: {listed(rest)}." if rest else ""
        return f"Ambiguous: it is {pairs}, and these soundings cannot tell which.{sure}"
    if d["residual"].get("out_of_time"):
        return f"Unexplained: the time was over{' with ' + names + ' found' if names else ''}; {fit}."
    found = f" Found so far: {names}; {fit}." if names else f" {fit[0].upper()}{fit[1:]}."
    return f"Unexplained: something is left over the noise that no known physics of places explains.{found}"


def fit_in_words(fit: dict) -> str:
    where = "in the vault, which nothing was fitted to" if fit["split"] == "vault" else "in the soundings (there is no vault)"
    before, after, noise = levels(fit)
    what = "the residual" if "twin_nmse_db" in fit else "the error of power"
    if abs(before - after) < 0.05:
        return f"{what} is {after:.1f} dB, noise {noise:.1f} dB, {where}"
    return f"{what} {'falls' if after < before else 'goes'} from {before:.1f} to {after:.1f} dB, noise {noise:.1f} dB, {where}"


def levels(fit: dict) -> tuple[float, float, float]:
    """The twin's, the corrected twin's, the noise's."""
    names = ("twin_nmse_db", "corrected_nmse_db", "noise_floor_db")
    if names[0] not in fit:
        names = ("twin_rmse_db", "corrected_rmse_db", "noise_rmse_db")
    return tuple(fit[name] for name in names)


def causes(d: dict) -> str:
    """Each effect: its sentence, numbers, place, evidence, runner-up, confidence."""

    def lines(one: dict) -> dict[str, str]:
        numbers = {escape(in_words(_without_unit(key))): told for key, told in _numbers(one["parameters"])}
        seen = {"Seen by": escape(_links(one["where"].get("links") or [])), "Evidence": _evidence(one)}
        return {"Whose": escape(_owner(one["owner"]))} | numbers | seen | {"Runner-up": escape(runner_up(one, d, "explains"))}

    return cards(d, lines)


def _owner(owner: dict) -> str:
    name = "the place" if owner["level"] == "place" else f"{owner['level']} {owner['name'].replace('>', ' → ')}"
    others = [one if isinstance(one, str) else one["name"] for one in owner.get("alternatives", ())]
    return name + (f"; it could as well be {listed(others)}" if others else "")


def _links(links: list[str]) -> str:
    named = ", ".join(link.replace(">", " → ") for link in links[:8])
    return (
        (f"{len(links)} link{'s' if len(links) > 1 else ''}: {named}" + (", …" if len(links) > 8 else ""))
        if links
        else "no link alone"
    )


def _numbers(parameters: dict):
    for key, one in parameters.items():
        if not isinstance(one, dict):
            yield key, escape(in_words(str(one)))
            continue
        yield key, number(one["value"], one.get("std"), unit_of(key))


def unit_of(key: str) -> str:
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), "")


def _without_unit(key: str) -> str:
    end = next((end for end in UNITS if key.endswith(end) and end.startswith("_")), "")
    return key[: len(key) - len(end)]


def number(value, std, unit: str) -> str:
    """A value with one standard deviation (of three numbers the largest), to the digits that this one leaves."""
    values, stds = np.atleast_1d(np.array(value, float)), np.atleast_1d(np.array(0 if std is None else std, float))
    sure = values != 0 if len(values) == len(stds) and values.any() else stds >= 0  # what is exactly 0 was not asked for
    most = float(stds[sure].max())
    size = max(float(np.abs(values).max()), most)
    scale, prefix = next(((s, p) for s, p in _SCALES if size >= s), _SCALES[-1]) if unit in _SCALED and size > 0 else (1.0, "")
    if unit == "Hz" and scale < 1:
        scale, prefix = 1.0, ""
    finest = _MOST_DIGITS[unit in _SCALED]
    digits = int(np.clip(1 - np.floor(np.log10(most / scale)), 0, finest)) if most > 0 else 3
    plain = lambda v: f"{round(v / scale, digits) + 0.0:.{digits}f}"  # noqa: E731
    text = ", ".join(plain(v) for v in values)
    text = f"({text})" if len(values) > 1 else text
    spread = "" if std is None else f" ± {plain(most)}"
    return f"{text}{spread} {prefix}{unit}".strip()


def _evidence(one: dict) -> str:
    evidence = one["evidence"]
    gain = f"{evidence['gain_nats']:,.0f} nats in what was fitted"
    held = evidence["heldout_gain_nats"]
    if held is None:
        return f"{gain}; no vault to try it on"
    if abs(held) < 1.0:
        lasts = next(family.lasts for family in FAMILIES if family.name == one["family"])
        return f"{gain}; the vault shows nothing of it" + (", which lowers the confidence" if lasts else ": it may have gone")
    return f"{gain}; {abs(held):,.0f} nats {'better' if held >= 0 else 'worse'} with it in the vault"


def next_positions(d: dict) -> list:
    """Positions to sound from next, of all that is open."""
    told = [one["record_next"] for one in d["ambiguous"]] + [d["residual"].get("record_next")]
    return [one["position_m"] for one in told if isinstance(one, dict)]


def open_questions(d: dict) -> str:
    """What the soundings leave open, and what would decide it."""
    rows = [f"<p>{escape(_why(one))}</p>{_advice(one['record_next'])}" for one in d["ambiguous"]]
    if further := d["residual"].get("record_next"):
        rows.append(_advice(further))
    if left := d["residual"]["where"]:
        named = "".join(
            f"<li>{escape(', '.join(one['links']).replace('>', ' → '))}"
            + (f": {one['deviations']:.1f} standard deviations over noise" if "deviations" in one else "")
            + "</li>"
            for one in left
        )
        rows.append(f"<p>More than noise is left on</p><ul>{named}</ul>")
    body = "".join(rows) or "<p>Nothing: what is left is what noise leaves.</p>"
    return f"<h2>What is open</h2><div class='{'next' if rows else ''}'>{body}</div>"


def _why(one: dict) -> str:
    text = one["why"]
    for name in one["families"]:
        text = text.replace(name, in_words(name))
    return text.replace(">", " → ")


def _advice(told) -> str:
    if not told:
        return ""
    if isinstance(told, str):
        return f"<p><b>Record next: {escape(NEXT.get(told, in_words(told)))}</b> (<code>{escape(told)}</code>).</p>"
    place = ", ".join(f"{x:.2f}" for x in told["position_m"])
    node = "a new node" if told["node"] == "new" else f"node {escape(told['node'])}"
    return f"<p><b>Sound next with {node} at ({place}) m</b>, the cross in plan and section: {escape(told.get('why', ''))}.</p>"


def bars(fit: dict) -> str:
    """The fit beside the noise, as bars of one scale."""
    before, after, noise = levels(fit)
    is_power = "twin_rmse_db" in fit
    low = 0.0 if is_power else min(before, after, noise) - 6.0
    span = max(before, after, noise, low + 1.0) - low
    rows = []
    for name, level, kind in (("twin", before, "was"), ("corrected twin", after, "is"), ("noise", noise, "floor")):
        wide = 100 * max(level - low, 0.0) / span
        rows.append(
            f"<div class='bar'><span>{name}</span><i class='{kind}' style='width:{wide * 0.6:.1f}%'></i>{level:.1f} dB</div>"
        )
    what = "rms error of power" if is_power else "residual over received power"
    split = (
        "in the vault: other positions, other times, never fitted"
        if fit["split"] == "vault"
        else "in what was fitted: there is no vault"
    )
    return f"<h2>Fit</h2>{''.join(rows)}<p class='note'>{what}, {split}.</p>"
