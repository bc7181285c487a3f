# SPDX-License-Identifier: GPL-3.0-or-later
"""All recordings together: whose effect it is, what cannot be told apart, and the verdict."""

import numpy as np

from ..effects import FAMILIES
from .run import Finding, nmse, numbers

SAME_DELAY_SAMPLES = 1.0


def _key(finding: Finding, effect):
    """What makes two effects in two recordings the same: family and, for paths and tones, place."""
    family = FAMILIES[effect.family]
    if family.level == "link":
        tap = effect.aux.get("tap")
        delay = (
            finding.scene.taps[tap].delay
            if tap is not None
            else round(effect.p[2])
            if effect.family == "extra_path"
            else 0
        )
        return (effect.family, finding.observation.name, round(float(delay), 1), tap)
    if effect.family in ("sample_loss", "gain_step"):
        return (
            effect.family,
            round(float(effect.p[0 if effect.family == "sample_loss" else 1]), 2),
            finding.observation.name,
        )
    if effect.family == "tone_interference":
        return (effect.family, round(float(effect.p[2] / 3)))
    return (effect.family,)


def conclude(case, findings: list[Finding]) -> dict:
    """The contract's document, without `seconds`."""
    groups: dict[tuple, list[tuple[Finding, int]]] = {}
    for finding in findings:
        for i, effect in enumerate(finding.fit.model.effects):
            if not effect.fixed:
                groups.setdefault(_key(finding, effect), []).append((finding, i))
    effects = [entry for members in groups.values() if (entry := _entry(case, findings, members))]
    left = [(f, rest) for f in findings for rest in f.left]
    ambiguous = _ambiguities(case, findings)
    if left:
        verdict = "unexplained"
    elif ambiguous:
        verdict = "ambiguous"
    elif effects:
        verdict = "identified"
    else:
        verdict = "no_mismatch"
    if len(findings) == 1 and len(effects) > 4:
        verdict = "unexplained"
    fit = _fit_numbers(findings)
    return {
        "cast_diagnosis": 1,
        "verdict": verdict,
        "effects": effects,
        "ambiguous": ambiguous,
        "fit": fit,
        "residual": {
            "unexplained_db": round(float(_excess_db(findings)), 3),
            "p_value": float(min([rest.p_value for f in findings for rest in f.left], default=0.5)),
            "where": [{**rest.where, "test": rest.test, "recording": f.observation.name} for f, rest in left],
        },
    }


def _excess_db(findings) -> float:
    shares = [sum(rest.nats for rest in f.left) / max(f.fit.data.count, 1) for f in findings]
    return 10 * np.log10(1 + max(shares, default=0.0))


def _fit_numbers(findings) -> dict:
    twin, corrected, floor = [], [], []
    for f in findings:
        inside = f.data.vault if f.data.vault.any() else f.data.use > 0
        twin.append(nmse(f.data, f.twin.chain.y, inside))
        corrected.append(nmse(f.data, f.fit.chain.y, inside))
        told = f.data.noise_power
        floor.append((told if told else f.fit.sigma2) / float(np.mean(np.abs(f.data.y) ** 2)))
    names = ("twin_nmse_db", "corrected_nmse_db", "noise_floor_db")
    return {
        name: round(float(10 * np.log10(np.mean(v))), 4)
        for name, v in zip(names, (twin, corrected, floor), strict=True)
    } | {"split": "vault"}


def owner_of(case, findings, members) -> dict:
    """The node or link whose recordings are those that show the effect."""
    finding, index = members[0]
    effect = finding.fit.model.effects[index]
    family = FAMILIES[effect.family]
    if family.level == "environment":
        return {"level": "environment", "name": "environment"}
    seen = {f.observation.name for f, _ in members}
    source = (
        finding.scene.taps[effect.aux["tap"]].source if "tap" in effect.aux else effect.aux.get("source", 0)
    )
    tx, rx = finding.scene.transmitters[source], finding.observation.receiver
    if family.level == "link":
        return {"level": "link", "name": f"{tx}>{rx}"}
    level = "tx" if effect.aux.get("side") == "tx" else family.level
    by = {
        "tx": {o.observation.name for o in findings if tx in o.observation.on_air},
        "rx": {o.observation.name for o in findings if o.observation.receiver == rx},
    }
    if len(findings) > 1 and by["tx"] != by["rx"]:
        score = {
            side: len(seen & names) - len(names - seen) - len(seen - names) for side, names in by.items()
        }
        level = max(score, key=lambda side: (score[side], side == level))
        return {"level": level, "name": tx if level == "tx" else rx}
    other = {"level": "rx" if level == "tx" else "tx", "name": rx if level == "tx" else tx}
    owner = {"level": level, "name": tx if level == "tx" else rx}
    return (
        owner
        if level == family.level and family.level == "tx" and effect.family != "iq_imbalance"
        else owner | {"alternatives": [other]}
    )


def _entry(case, findings, members) -> dict | None:
    finding, index = max(members, key=lambda m: _gain(*m))
    effect = finding.fit.model.effects[index]
    family, scene = FAMILIES[effect.family], finding.scene
    values, constants = numbers(finding, index)
    if len(members) > 1:
        for name in values:
            if not name.startswith(("time_s",)):
                values[name] = _pooled(
                    [numbers(f, i)[0][name] for f, i in members if name in numbers(f, i)[0]]
                )
    plain = {k: v["value"] for k, v in values.items()}
    where = {
        "delay_s": None,
        "time_s": [0.0, scene.duration_s],
        "frequency_hz": [-scene.sample_rate_hz / 2, scene.sample_rate_hz / 2],
        "amplitude": None,
        **{k: [float(a) for a in v] for k, v in family.where(scene, effect, plain).items()},
        "recording": finding.observation.name
        if len(members) == 1
        else [f.observation.name for f, _ in members],
    }
    margin = _gain(finding, index)
    return {
        "family": effect.family,
        "owner": owner_of(case, findings, members),
        "where": where,
        "parameters": {**values, **constants},
        "evidence": {"heldout_gain_nats": round(margin, 2), "runner_up": None, "runner_up_margin_nats": None},
        "confidence": confidence(margin),
        "sentence": family.describe(_Words(values, constants)),
        "model": family.model(effect),
    }


def confidence(nats: float) -> float:
    return round(float(0.55 + 0.42 * (1 - np.exp(-max(nats, 0) / 15))), 3)


def _pooled(items) -> dict:
    w = np.array([max(v["std"], 1e-100) ** -2.0 for v in items])
    x = np.array([v["value"] for v in items])
    if not np.all(np.isfinite(w)) or w.sum() <= 0:
        return items[0]
    mean = float((w * x).sum() / w.sum())
    return {"value": mean, "std": float(1 / np.sqrt(w.sum()))}


def _gain(finding: Finding, index: int) -> float:
    """Evidence that is lost without the effect."""
    effect = finding.fit.model.effects[index]
    if "nats" in effect.aux:
        return float(effect.aux["nats"])
    cache = finding.__dict__.setdefault("_gains", {})
    if index not in cache:
        from .search import refit

        without = refit(finding.data, finding.fit.model.without(index))
        cache[index] = float(finding.fit.evidence - without.evidence)
    return cache[index]


def _ambiguities(case, findings) -> list[dict]:
    return []


UNITS = {
    "_s": "s",
    "_hz": "Hz",
    "_db": "dB",
    "_dbc": "dBc",
    "_rad": "rad",
    "_ppm": "ppm",
    "_hz_per_s": "Hz/s",
}


class _Words:
    """Parameters as text, with their interval and unit."""

    def __init__(self, values: dict, constants: dict):
        self.values, self.constants = values, constants

    def __call__(self, name: str) -> str:
        if name not in self.values:
            return "?"
        value, std = self.values[name]["value"], self.values[name]["std"]
        unit = next((u for s, u in sorted(UNITS.items(), key=lambda p: -len(p[0])) if name.endswith(s)), "")
        scale, prefix = 1.0, ""
        if unit in ("s", "Hz"):
            for size, letter in ((1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
                if abs(value) >= size:
                    scale, prefix = size, letter
                    break
            else:
                scale, prefix = (1e-9, "n") if unit == "s" else (1.0, "")
        digits = 3 if std <= 0 else int(np.clip(np.ceil(-np.log10(std / scale)) + 1, 0, 6))
        text = f"{value / scale:.{digits}f}"
        if std > 0:
            text += f" ± {std / scale:.{digits}f}"
        return f"{text} {prefix}{unit}".rstrip()
