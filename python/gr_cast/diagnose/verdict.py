# SPDX-License-Identifier: GPL-3.0-or-later
"""All recordings together: whose effect it is, what cannot be told apart, and the verdict."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..twin.effects import FAMILIES
from . import heldout
from .finding import Finding, nmse, numbers
from .ownership import kind_of, owner

SAME_DELAY_SAMPLES = 0.7
SURELY_APART = 3.0  # standard deviations
HURRIED = 0.9  # of the confidence of an effect of a search that its time ended, with nothing left that would tell against it
UNTRUSTED = 0.2  # of the confidence of an effect that stands in a list with something left unexplained
LEAST_NATS = 8.0  # that an effect must bring over all recordings


def _group(findings: list[Finding]) -> list[list[tuple[Finding, int]]]:
    """Effects of several recordings that are one: the same kind at the same place."""
    groups: list[tuple[tuple, float, float, list]] = []
    for finding in findings:
        for i, effect in enumerate(finding.fit.model.effects):
            if not finding.is_cause(effect):
                continue
            kind, (place, doubt) = kind_of(finding, effect), _place(finding, i)
            for other, where, theirs, members in groups:
                near = abs(where - place) < max(SAME_DELAY_SAMPLES, SURELY_APART * np.hypot(doubt, theirs))
                if other == kind and near and all(f is not finding for f, _ in members):
                    members.append((finding, i))
                    break
            else:
                groups.append((kind, place, doubt, [(finding, i)]))
    return [members for *_, members in groups]


def _place(finding: Finding, index: int) -> tuple[float, float]:
    """A coordinate that is the same where the effect is the same, and its standard deviation where that may be large, in units
    of SAME_DELAY_SAMPLES."""
    family = FAMILIES[finding.fit.model.effects[index].family]
    return (0.0, 0.0) if family.place is None else family.placed(finding.scene, numbers(finding, index)[0])


def conclude(case, findings: list[Finding], vault: Callable[[list[dict]], list[tuple]]) -> dict:
    """The contract's document, without `seconds`; `vault` predicts the recordings for the vault with the entries found."""
    heard = [f for f in findings if not f.absent] or findings  # the others say nothing of whose an effect is
    effects = [entry for members in _group(findings) if (entry := _entry(heard, members))]
    left = [(f, rest) for f in findings for rest in f.left]
    ambiguous = _ambiguities(findings)
    crowded = any(f.crowded for f in findings)
    if left or not all(f.complete for f in findings):
        verdict = "unexplained"
    elif ambiguous:
        verdict = "ambiguous"
    elif effects:
        verdict = "unexplained" if crowded else "identified"
    else:
        verdict = "no_mismatch"
    share = UNTRUSTED if left or crowded else HURRIED
    _doubted(effects, share if verdict == "unexplained" else 1.0, ambiguous)
    fit = _fit_numbers(findings, vault(effects))
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
    # The tests see the same samples: the loudest tells.
    shares = [max((rest.nats for rest in f.left), default=0.0) / max(f.fit.data.count, 1) for f in findings]
    return 10 * np.log10(1 + max(shares, default=0.0))


def _fit_numbers(findings, vault) -> dict:
    """Averages over recordings for the vault where the case has some, else over the vault's samples of
    every recording."""
    twin, corrected, floor = ([v[k] for v in vault] for k in range(3))
    for f in findings if not vault else ():
        data = f.twin.data  # a stretch that the search was made without counts too
        inside = data.vault if data.vault.any() else data.use > 0
        twin.append(nmse(data, f.twin.chain.y, inside))
        corrected.append(nmse(data, f.fit.chain.y, inside))
        told = data.noise_power
        floor.append((told if told else f.fit.sigma2) / float(np.mean(np.abs(data.y) ** 2)))
    names = ("twin_nmse_db", "corrected_nmse_db", "noise_floor_db")
    numbers = {name: round(float(10 * np.log10(np.mean(v))), 4) for name, v in zip(names, (twin, corrected, floor), strict=True)}
    gain = sum(heldout.log_likelihood(f.fit) - heldout.log_likelihood(_where_fitted(f)) for f in findings)
    return numbers | {"split": "vault", "heldout_gain_nats": round(float(gain), 2)}


def _where_fitted(finding: Finding):
    """The twin's fit on the samples that the search was made with."""
    data = finding.fit.data
    return replace(finding.twin, data=replace(finding.twin.data, use=data.use, vault=data.vault))


def _entry(findings, members) -> dict | None:
    """One effect of the document, from the recordings that show it; None where all of them together say too
    little."""
    whose, group = owner(findings, members)
    members = [m for m in members if m[0].observation.name in group] or members
    gain = sum(f.gain_of(i) for f, i in members)
    finding, index = max(members, key=lambda m: (not m[0].later, m[0].gain_of(m[1])))
    effect = finding.fit.model.effects[index]
    if gain < LEAST_NATS and effect.free.any():
        return None
    held_out = sum(f.worth_of(i).held_out for f, i in members)
    if held_out < 0 and not all(f.complete for f, _ in members):  # its proof was cut short, and unseen samples speak against it
        return None
    family, scene = FAMILIES[effect.family], finding.scene
    values, constants = numbers(finding, index)
    plain = {k: v["value"] for k, v in values.items()}
    if len(members) > 1:
        every = {}  # recording → numbers of its parts
        for f, i in members:
            every.setdefault(f.observation.name, []).append(numbers(f, i)[0])
        for name in values:
            told = {r: [v[name] for v in parts if name in v] for r, parts in every.items()}
            values[name] = _pooled({r: _mean(parts) for r, parts in told.items() if parts}, values[name])
    spans = [(f.observation.first, f.observation.first + f.scene.span) for f, _ in members]
    spans = [(0, scene.whole)] if effect.aux.get("whole") else spans
    where = {
        "delay_s": None,
        "time_s": [min(a for a, _ in spans) / scene.sample_rate_hz, max(b for _, b in spans) / scene.sample_rate_hz],
        "frequency_hz": [-scene.sample_rate_hz / 2, scene.sample_rate_hz / 2],
        "amplitude": None,
        **{k: [float(a) for a in v] for k, v in family.where(scene, effect, plain).items()},
        "recording": finding.observation.name if len(members) == 1 else sorted({f.observation.name for f, _ in members}),
    }
    others = [r for r in finding.worth_of(index).rivals if r.effect.family != effect.family]
    evidence = {
        "heldout_gain_nats": round(held_out, 2),
        "runner_up": FAMILIES[others[0].effect.family].told if others else None,
        "runner_up_margin_nats": round(others[0].evidence, 2) if others else None,
    }
    return {
        "family": family.told,
        "owner": whose,
        "where": where,
        "parameters": {**values, **constants},
        "evidence": evidence,
        "confidence": confidence(gain),
        "sentence": family.describe(Words(values, constants)),
        "model": family.model(scene, family.since_the_beginning(scene, effect)),
    }


def confidence(nats: float) -> float:
    """Share of effects with this evidence that are true when the whole list is trusted
    (tests/bench/bench_confidence.py)."""
    return round(float(0.60 + 0.38 * (1 - np.exp(-max(nats, 0) / 20))), 3)


def _doubted(effects: list[dict], trust: float, ambiguous: list[dict]) -> None:
    """Lower the confidence of effects to the share `trust` of their list, and of those that have an equal rival."""
    rivals = {family for a in ambiguous for family in a["families"]}
    for effect in effects:
        if effect["family"] in rivals:
            effect["confidence"] = min(effect["confidence"], 0.5)
        else:
            effect["confidence"] = round(trust * effect["confidence"], 3)


def _mean(parts: list[dict]) -> dict:
    """One number of the parts of a recording: their weighted mean, its error not below what they differ by."""
    x, std = (np.array([v[key] for v in parts]) for key in ("value", "std"))
    if len(parts) == 1 or np.any(std <= 1e-300):
        return parts[0]
    w = std**-2.0
    mean = float((w * x).sum() / w.sum())
    chi2 = float((w * (x - mean) ** 2).sum())
    return {"value": mean, "std": float(np.sqrt(max(1.0, chi2 / (len(x) - 1)) / w.sum()))}


def _pooled(items: dict[str, dict], first: dict) -> dict:
    """One number of several recordings: their weighted mean, or each its own where they differ by more than
    their errors."""
    x = np.array([v["value"] for v in items.values()])
    std = np.array([v["std"] for v in items.values()])
    if len(x) == 1:
        return next(iter(items.values()))
    if np.any(std <= 1e-300) or np.ptp(x) == 0:
        return first
    w = std**-2.0
    mean, dof = float((w * x).sum() / w.sum()), len(x) - 1
    chi2 = float((w * (x - mean) ** 2).sum())
    if chi2 > dof + 6 * np.sqrt(2 * dof) + 6:
        return {"per_recording": items}
    return {"value": mean, "std": float(np.sqrt(max(1.0, chi2 / max(dof, 1)) / w.sum()))}


def _ambiguities(findings) -> list[dict]:
    """Pairs that stay open: in a network only those that no other recording of the same effect decides."""
    found = {}
    for finding in findings:
        for entry in finding.ambiguous:
            found.setdefault(frozenset(entry["families"]), {}).setdefault(finding.observation.name, entry)
    recordings, open_ones = {f.observation.name for f in findings}, []
    for families, entries in found.items():
        holders = {f.observation.name for f in findings if any(e.family in families for e in f.fit.model.found)}
        if holders <= set(entries) and (len(holders) > 1 or len(recordings) == 1):
            open_ones.append(next(iter(entries.values())))
    return open_ones


UNITS = {
    "_s": "s",
    "_hz": "Hz",
    "_db": "dB",
    "_dbc": "dBc",
    "_rad": "rad",
    "_ppm": "ppm",
    "_hz_per_s": "Hz/s",
}


class Words:
    """Parameters as text, with their interval and unit."""

    def __init__(self, values: dict, constants: dict):
        self.values, self.constants = values, constants

    def __call__(self, name: str) -> str:
        if name not in self.values:
            return "?"
        if "per_recording" in self.values[name]:
            every = self.values[name]["per_recording"].values()
            low, high = min(every, key=lambda v: v["value"]), max(every, key=lambda v: v["value"])
            return f"{Words({name: low}, {})(name)} to {Words({name: high}, {})(name)} (by recording)"
        value, std = self.values[name]["value"], self.values[name]["std"]
        unit = next((u for s, u in sorted(UNITS.items(), key=lambda p: -len(p[0])) if name.endswith(s)), "")
        scale, prefix = 1.0, ""
        if unit in ("s", "Hz"):
            for size, letter in ((1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
                if max(abs(value), std) >= size:
                    scale, prefix = size, letter
                    break
            else:
                scale, prefix = (1e-9, "n") if unit == "s" else (1.0, "")
        if std <= 1e-6 * abs(value):
            return f"{value / scale:.6g} {prefix}{unit}".rstrip()
        digits = int(np.clip(np.ceil(-np.log10(std / scale)) + 1, 0, 12))
        text = f"{value / scale:.{digits}f} ± {std / scale:.{digits}f}"
        return f"{text} {prefix}{unit}".rstrip()
