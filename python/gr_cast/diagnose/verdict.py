# SPDX-License-Identifier: GPL-3.0-or-later
"""All recordings together: whose effect it is, what cannot be told apart, and the verdict."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..core.units import db_from_power
from ..twin.effects import FAMILIES
from . import claims, heldout
from .confidence import Figures, confidence, is_whole
from .finding import Finding, nmse, numbers
from .maps import power_of, steps
from .mistakes import of_carriers
from .ownership import groups, kind_of, owner
from .policy import CLAIMED, REFUSED_NATS, SAME_DELAY_SAMPLES, SURELY_APART, VERDICT_LEAST_NATS
from .residual import Leftover
from .search import imitates

LONGER = "longer_recording"  # what tells more of effects that are not sure enough


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
    told = [_told(heard, members) for members in _group(findings)]
    claimed, refused = [t for t in told if t.claimed and not t.harms], [t for t in told if t.refused]
    harmful = [t for t in told if t.claimed and t.harms]
    left = [(f, rest) for f in findings for rest in f.left] + [(t.finding, _against_unseen(t)) for t in refused]
    ambiguous, complete = _ambiguities(findings, claimed), all(f.complete for f in findings)
    sure = _confidences(claimed, ambiguous, complete)
    if left or harmful or not complete:
        verdict = "unexplained"
    elif ambiguous:
        verdict = "ambiguous"
    elif claimed:
        verdict = "identified" if is_whole(sure) else "unexplained"
    else:
        verdict = "no_mismatch"
    open_ones = {family for a in ambiguous for family in a["families"]}
    likely = [s >= CLAIMED or FAMILIES[t.effect.family].told in open_ones for t, s in zip(claimed, sure, strict=True)]
    effects = [_entry(t, how_sure) for t, how_sure, kept in zip(claimed, sure, likely, strict=True) if kept]
    doubtful = [(t.finding, _doubtful(t, s)) for t, s, kept in zip(claimed, sure, likely, strict=True) if not kept]
    doubtful += [(t.finding, _doubtful(t, s)) for t, s in zip(harmful, _confidences(harmful, [], False), strict=True)]
    fit = _fit_numbers(findings, vault(effects))
    return {
        "cast_diagnosis": 1,
        "verdict": verdict,
        "effects": effects,
        "ambiguous": ambiguous,
        "fit": fit,
        "residual": {
            "unexplained_db": round(float(_excess_db(findings)), 3),
            "p_value": _smallest([rest.p_value for f in findings for rest in f.tested], [rest.p_value for _, rest in left]),
            "tested": sorted({rest.test for f in findings for rest in f.tested}),
            "where": [{**rest.where, "test": rest.test, "recording": f.observation.name} for f, rest in left + doubtful],
            "record_next": _record_next(verdict, left or doubtful, complete),
            "out_of_time": not complete or any(f.data.late for f in findings),
        },
        "warnings": of_carriers(case),
    }


def _record_next(verdict: str, left: list, complete: bool) -> str | None:
    """What would tell more of what is unexplained; None where nothing is, or only the time was over."""
    if left:
        return max((rest for _, rest in left), key=lambda rest: rest.nats).record_next
    return LONGER if verdict == "unexplained" and complete else None


def _smallest(tested: list[float], left: list[float]) -> float | None:
    """The smallest p-value of what is left, else of all tests after their number; None where none was made."""
    return float(min(left)) if left else float(min(1.0, min(tested) * len(tested))) if tested else None


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
    gain = sum(heldout.gained(f.fit, _where_fitted(f)) for f in findings)
    return numbers | {"split": "vault", "heldout_gain_nats": round(float(gain), 2)}


def _where_fitted(finding: Finding):
    """The twin's fit on the samples that the search was made with."""
    data = finding.fit.data
    return replace(finding.twin, data=replace(finding.twin.data, use=data.use, vault=data.vault))


@dataclass(frozen=True, kw_only=True)
class Told:
    """One effect of all recordings: the `members` (finding, index) that show it, the one that shows it best, its owner, the
    families of which one owner has all these recordings, and the nats that it brings, on unseen samples too (None where no
    finding worked that out)."""

    members: list[tuple[Finding, int]]
    finding: Finding
    index: int
    owner: dict
    shared: set[str]
    nats: float
    held_out: float | None

    @property
    def effect(self):
        return self.finding.fit.model.effects[self.index]

    @property
    def surely_read(self) -> bool:
        """Whether the samples themselves show it, whatever it changes of their prediction."""
        return self.effect.aux.get("read", 0.0) >= VERDICT_LEAST_NATS

    @property
    def evidence(self) -> float:
        """Nats for it, by the fits and by what was read."""
        return self.nats + self.effect.aux.get("read", 0.0)

    @property
    def enough(self) -> bool:
        return self.nats >= VERDICT_LEAST_NATS or not self.effect.free.any()

    @property
    def claimed(self) -> bool:
        """No effect is claimed against unseen samples, nor unfounded, whether or not there was time to take it out."""
        if self.surely_read:
            return True
        founded = not all(claims.is_unfounded(f, i) for f, i in self.members)
        return self.enough and not self._contradicted and founded

    @property
    def _contradicted(self) -> bool:
        """Whether unseen samples speak against it; those that happen to have nothing of what is scattered do not."""
        if self.held_out is None or self.held_out >= 0:
            return False
        family, asked = FAMILIES[self.effect.family], [(f.fit, i) for f, i in self.members if f.worth_of(i).held_out is not None]
        spared = sum(family.spared_nats(fit.model.effects[i], float(fit.data.vault.sum())) for fit, i in asked)
        return self.held_out < -spared and not (family.scattered and claims.by_chance(self.members))

    @property
    def harms(self) -> bool:
        """Whether more is left with it, once all louder ones are there, and no unseen samples were asked."""
        return not self.surely_read and self.held_out is None and (_explains_db(self) or 0.0) < 0

    @property
    def refused(self) -> bool:
        """Whether it explains much of what was fitted, and none of what was not: something is there that has another form."""
        return self.nats >= REFUSED_NATS and not self.claimed

    @property
    def rivals(self) -> list:
        mine = FAMILIES[self.effect.family].told
        found = [r for r in self.finding.worth_of(self.index).rivals if r.effect.family in self.shared]
        return [r for r in found if FAMILIES[r.effect.family].told != mine]


def _told(findings, members) -> Told:
    whose, group = owner(findings, members)
    members = [m for m in members if m[0].observation.name in group] or members
    finding, index = max(members, key=lambda m: (not m[0].later, m[0].gain_of(m[1])))
    held_out = [w for f, i in members if (w := f.worth_of(i).held_out) is not None]
    return Told(
        members=members,
        finding=finding,
        index=index,
        owner=whose,
        shared=_shared(findings, {f.observation.name for f, _ in members}),
        nats=sum(f.gain_of(i) for f, i in members),
        held_out=sum(held_out) if held_out else None,
    )


def _shared(findings, holders: set[str]) -> set[str]:
    """Families of which one owner has a part in all of some recordings."""
    return {name for name, family in FAMILIES.items() if any(holders <= group for group in groups(findings, family))}


def _against_unseen(told: Told) -> Leftover:
    """What an effect fits that unseen samples refuse, as what is left."""
    test = f"{FAMILIES[told.effect.family].told} explains what was fitted, and nothing of unseen samples"
    return Leftover(test=test, p_value=float(np.exp(-told.nats)), nats=told.nats, where={}, record_next=LONGER)


def _doubtful(told: Told, sure: float) -> Leftover:
    """An effect that is likelier wrong than right, or was not proved and leaves more than is left without it, as what is left."""
    family = FAMILIES[told.effect.family]
    where = {"sentence": family.describe(Words(*numbers(told.finding, told.index))), "confidence": sure}
    return Leftover(test=f"{family.told}, or something else", p_value=1.0, nats=told.nats, where=where, record_next=LONGER)


def _confidences(told: list[Told], ambiguous: list[dict], complete: bool) -> list[float]:
    """How sure every effect is."""
    out, open_ones = [], {family for a in ambiguous for family in a["families"]}
    for t in told:
        figures = Figures(
            evidence=t.evidence,
            held_out=None if t.surely_read else t.held_out,
            lead=t.rivals[0].evidence if t.rivals else None,
            left=max([rest.nats for rest in t.finding.left if not rest.apart], default=0.0),
            explains=t.finding.explained_nats,
            flexible=imitates(t.effect),
            complete=complete,
            proven=t.surely_read or t.held_out is not None,
            open=FAMILIES[t.effect.family].told in open_ones,
        )
        out.append(round(confidence(figures), 3))
    return out


def _explains_db(told: Told) -> float | None:
    """By how much the residual of the recording that shows an effect most falls with it, once all louder ones are in the model;
    None of noise, and where the time was over."""
    before = power_of(told.finding.twin)
    for index, power in steps(told.finding) or ():
        if index == told.index:
            return round(float(db_from_power(before / power)), 3)
        before = power
    return None


def _entry(told: Told, sure: float) -> dict:
    """One effect of the document."""
    members, finding, index, effect = told.members, told.finding, told.index, told.effect
    family, scene = FAMILIES[effect.family], finding.scene
    values, constants = numbers(finding, index)
    plain = {k: v["value"] for k, v in values.items()}
    if len(members) > 1:
        every = {}  # recording → numbers of its parts
        for f, i in members:
            every.setdefault(f.observation.name, []).append(numbers(f, i)[0])
        for name in values:
            by_recording = {r: [v[name] for v in parts if name in v] for r, parts in every.items()}
            values[name] = _pooled({r: _mean(parts) for r, parts in by_recording.items() if parts}, values[name])
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
    evidence = {
        "heldout_gain_nats": None if told.held_out is None else round(told.held_out, 2),
        "runner_up": FAMILIES[told.rivals[0].effect.family].told if told.rivals else None,
        "runner_up_margin_nats": round(told.rivals[0].evidence, 2) if told.rivals else None,
        "explains_db": _explains_db(told),
    }
    return {
        "family": family.told,
        "owner": told.owner,
        "where": where,
        "parameters": {**values, **constants},
        "evidence": evidence,
        "confidence": sure,
        "sentence": family.describe(Words(values, constants)),
        "model": family.model(scene, family.since_the_beginning(scene, effect)),
    }


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


def _ambiguities(findings, claimed: list[Told]) -> list[dict]:
    """Pairs, of which one is claimed, that stay open: in a network those that no other recording of the same effect decides, and
    of which the other too may be one owner's."""
    found, names = {}, {FAMILIES[t.effect.family].told for t in claimed}
    for finding in findings:
        for entry in (e for e in finding.ambiguous if names & {*e["families"]}):
            found.setdefault(frozenset(entry["families"]), {}).setdefault(finding.observation.name, entry)
    recordings, open_ones = {f.observation.name for f in findings}, []
    for families, entries in found.items():
        holders = {f.observation.name for f in findings if any(e.family in families for e in f.fit.model.found)}
        shared = {FAMILIES[name].told for name in _shared(findings, holders)}
        if families <= shared | names and holders <= set(entries) and (len(holders) > 1 or len(recordings) == 1):
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
        value, std = self.values[name]["value"] + 0.0, self.values[name]["std"]  # no −0
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
