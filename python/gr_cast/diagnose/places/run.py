# SPDX-License-Identifier: GPL-3.0-or-later
"""The diagnosis of a place, from a case to its document."""

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from ...core.units import db_from_power
from ...twin.places.believed import believed
from ...twin.places.document import Place
from ...twin.places.families.objects import ObjectMoved
from . import diffuse, elsewhere, exchange, foretold, mistakes, open_wells, policy, search, taps
from .ears import ear, told_of
from .fit import Model, applied, deviations, evaluated, fitted, without_effects
from .next_position import where_to_sound
from .view import View

_MOVED = ObjectMoved.name
_SEARCH_SHARE = 0.85  # of the budget: telling what was found takes its time too


@dataclass(frozen=True, eq=False, kw_only=True)
class PlaceDiagnosis:
    """A finished diagnosis: `document` of the contract, the fitted model, and the fits before and after on every campaign."""

    place: Place
    document: dict
    model: Model
    ears: tuple
    vault: tuple
    before: tuple
    after: tuple


def diagnose(
    place: Place, *, budget_s: float = policy.BUDGET_S, progress: Callable[[str], None] = lambda text: None
) -> PlaceDiagnosis:
    """Which effects the twin of a place leaves out. `budget_s` is processor time."""
    begin_s = time.monotonic()
    base, bandwidth_hz = believed(place), place.spec.bandwidth_hz
    ears = tuple(ear(one, place.unknown, bandwidth_hz) for one in place.soundings if not one.vault)
    vault = tuple(ear(one, place.unknown, bandwidth_hz) for one in place.soundings if one.vault)
    warnings, pathless = mistakes.of_units_and_signs(place, ears, base), False
    for number, campaign in enumerate(ears):
        kept, lost, count = told_of(campaign, base)
        if lost:
            ears, pathless = (*ears[:number], kept, *ears[number + 1 :]), pathless or lost > policy.PATHLESS_SHARE * count
            warnings.append(
                f"{lost} of {count} powers were read where the twin has no path: they are not explained, and left out."
            )
    vault = tuple(told_of(campaign, base)[0] for campaign in vault)
    if (through := taps.tapped(ears, bandwidth_hz)) and (as_taps := _as_taps(ears, through, base)):
        found, ears, vault = as_taps, through, taps.tapped(vault, bandwidth_hz) or vault
        warnings.append(taps.in_words(ears, base))
    else:
        found = search.run(ears, base, place.unknown, _SEARCH_SHARE * budget_s, progress, vault)
    told = _told(place, found, ears, vault, pathless)
    is_field, taken_nats = told.is_field, 0.0  # of what was found: none is left once it is not claimed
    if unsure := _unsure(told):
        taken_nats = max(entry["evidence"]["gain_nats"] for entry in unsure)
        warnings += [f"Not claimed, for it is likelier wrong than right: {entry['sentence']}" for entry in unsure]
        numbers = [number for cause, entry in zip(told.causes, told.effects, strict=True) if entry in unsure for number in cause]
        found = replace(found, model=fitted(ears, without_effects(ears, found.model, numbers), rounds=4))
        told = _told(place, found, ears, vault, pathless)
    if not is_field:
        warnings.append("What scattering was to explain is no random field, or gains that wander explain more of it.")
    if not told.is_foretold:
        warnings.append("What was found does not predict the soundings of the vault: something else is there.")
    model = found.model
    everything = (*ears, *vault)
    before, after = evaluated(everything, base, ()), evaluated(everything, base, model.effects)
    rest_nats = evaluated(ears, base, ()).energy - model.energy  # what is claimed explains
    is_left = taken_nats > max(policy.TAKEN_NATS, policy.TAKEN_SHARE * rest_nats)
    document = {
        "cast_diagnosis": 1,
        "verdict": "unexplained" if is_left else _verdict(told),
        "effects": told.effects,
        "ambiguous": told.open,
        "fit": residual_over_received(vault or ears, before, after, len(ears) if vault else 0, bool(vault)),
        "residual": _residual(found, ears, after),
        "warnings": warnings,
        "seconds": round(time.monotonic() - begin_s, 2),
    }
    return PlaceDiagnosis(
        place=place, document=document, model=model, ears=ears, vault=vault, before=before.fits, after=after.fits
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Told:
    """Entries of causes, the numbers of the effects that each is made of, what is open; whether nothing is left on what was
    fitted, whether scattering explains none of it that is no random field, and whether the vault is predicted."""

    effects: list[dict]
    causes: list[list[int]]
    open: list[dict]
    is_clean: bool
    is_field: bool
    is_foretold: bool


def _unsure(told: _Told) -> list[dict]:
    """Entries that are likelier wrong than right. Of two that explain all there is alike each may be less sure: that is told."""
    named = {name for one in told.open for name in one["families"]} if told.is_clean else set()
    return [entry for entry in told.effects if entry["confidence"] < policy.LEAST_SURE and entry["family"] not in named]


def _told(place: Place, found: search.Found, ears: tuple, vault: tuple, pathless: bool) -> _Told:
    model = found.model
    view = View(ears, model, place.unknown)
    alike = [_alike(found, number, ears, vault, model.base) for number in range(len(model.effects))]
    predicted = foretold.holds(view, vault, at_best=True)
    field = diffuse.unevenness(ears, model.fits, model.world) < policy.UNEVEN_DEVIATIONS and not _wanders(ears, model)
    clean = found.deviations < policy.CLEAN_DEVIATIONS and not pathless and field and predicted
    there = evaluated(vault, model.base, model.effects) if vault else None
    shown = [_shown(vault, there, [number]) for number in range(len(model.effects))]
    covariances = [
        _doubt(found, ears, clean) * own
        + _over_wells(model.effects[number], open_wells.wells(ears, vault, model, number))
        + (_besides(view, found, number) if not clean or _may_go_otherwise(found, ears, number, nats) else 0.0)
        for number, (own, nats) in enumerate(zip(deviations(ears, model), shown, strict=True))
    ]
    made_of = causes(view, model.effects)
    effects = [
        _entry(
            view,
            found,
            cause,
            covariances[cause[0]],
            clean,
            _shown(vault, there, cause),
            [nats for _, _, nats, _ in alike[cause[0]][1:]],
        )
        for cause in made_of
    ]
    return _Told(
        effects=effects,
        causes=made_of,
        open=_ambiguous(alike, ears, place),
        is_clean=clean,
        is_field=field,
        is_foretold=predicted,
    )


def _wanders(ears, model: Model) -> bool:
    """Whether gains that wander explain more than the random fields of a model and whom it has passing by."""
    families = [effect.family for effect in model.effects]
    if not any(family.is_flexible for family in families):
        return False
    bare = without_effects(ears, model, [number for number, one in enumerate(families) if one.is_flexible or one.has_ways])
    told = sum(diffuse.wander_nats(one, fit) for one, fit in zip(ears, bare.fits, strict=True) if one.has_responses)
    return told > max(bare.energy - model.energy, 0.0) + policy.BESIDE_ROUGH_NATS


def _as_taps(ears, through, base) -> search.Found | None:
    """The twin as it is, where four taps in the place of its paths explain what it leaves above noise."""
    count = sum(one.count for one in ears)
    plain = search.Found(model=evaluated(ears, base, ()), start=None, rivals={}, tried=1, count=count, spent=False)
    if plain.deviations < policy.CLEAN_DEVIATIONS:
        return None
    model = evaluated(through, base, ())
    return replace(plain, model=model, start=model) if taps.explain(plain.model, model, count) else None


def _verdict(told: _Told) -> str:
    if not told.is_clean:
        return "unexplained"
    if told.open:
        return "ambiguous"
    return "identified" if told.effects else "no_mismatch"


def _rivals(found: search.Found, effect) -> list:
    world, rivals = found.model.base, found.rivals.get(effect.key, ())
    return [(rival, nats) for rival, nats in rivals if not effect.family.covers(world, effect, rival)]


def _ambiguous(alike: list, ears, place: Place) -> list[dict]:
    """Every two that explain alike, and what tells these two apart."""
    return [
        {
            "families": [name, other],
            "why": f"{words} and {others_words} explain the soundings alike, {abs(more - nats):.1f} nats apart.",
            "record_next": where_to_sound(ears, [world, rival], place.unknown),
        }
        for ones in alike
        for (name, words, nats, world), (other, others_words, more, rival) in itertools.combinations(ones, 2)
    ]


def _alike(found: search.Found, number: int, ears, vault, base) -> list[tuple]:
    """(family, words, nats behind, world) of an effect and of the nearest of each other family that would do in its place."""
    effect, world = found.model.effects[number], found.model.world
    others = [one for index, one in enumerate(found.model.effects) if index != number]
    alike = {effect.family.name: (effect.family.name, f"{effect.family.name} of {effect.owner}", 0.0, world)}
    for rival, nats in _rivals(found, effect):
        name = rival.family.name
        if nats < policy.RIVAL_NATS and name not in alike and len(alike) <= policy.MOST_ALIKE:
            alike[name] = name, f"{name} of {rival.owner}", nats, applied(base, [*others, rival])
    if _MOVED in alike:
        _, words, nats, world = alike[_MOVED]
        moved = next(one for one in (effect, *(rival for rival, _ in _rivals(found, effect))) if one.family.name == _MOVED)
        if new := elsewhere.one_more(ears, base, [*others, moved], len(others)):
            nats += elsewhere.apart_nats((*ears, *vault), world, new)
            if nats < policy.RIVAL_NATS:
                alike["missing_object"] = "missing_object", f"something new like what is {words}", nats, new
    return [*alike.values()]


def causes(view: View, effects) -> list[list[int]]:
    """Numbers of the effects that are one cause each, the telling one first: what is found in pieces is told once."""
    groups: list[list[int]] = []
    for number, effect in enumerate(effects):
        near = [group for group in groups if any(effect.family.is_one_with(view, effect, effects[other]) for other in group)]
        groups = [group for group in groups if group not in near] + [sorted([number, *(one for group in near for one in group)])]
    return [sorted(group, key=lambda number: not effects[number].family.is_telling(view, effects[number])) for group in groups]


def _entry(
    view: View, found: search.Found, cause: list[int], covariance: np.ndarray, clean: bool, vault_nats: float | None, alike: list
) -> dict:
    effect = found.model.effects[cause[0]]
    told = effect.family.told(view, effect, covariance)
    rivals = _rivals(found, effect)
    margin = min((nats for _, nats in rivals), default=None)
    bare = without_effects(view.ears, found.model, cause)
    less = fitted(view.ears, bare, rounds=2)
    gain = less.energy - found.model.energy
    links = _links(view.ears, bare, found.model) or _links(view.ears, less, found.model)  # refitted, the rest changes others too
    where = {"links": links, "time_s": None, "delay_s": None}
    if extent := effect.family.extent_m(view, effect):
        where["position_m"] = extent
        where["extent_m"] = extent
    return {
        "family": effect.family.name,
        "owner": {"level": effect.family.level_of(view.world, effect.owner), "name": effect.owner}
        | _alternatives(effect, rivals),
        "where": where,
        "parameters": told,
        "evidence": {
            "gain_nats": float(gain),
            "heldout_gain_nats": vault_nats,
            "runner_up": rivals[0][0].family.name if rivals else None,
            "runner_up_margin_nats": margin,
        },
        "confidence": _confidence(
            effect, gain, [nats for rival, nats in rivals if rival.key != effect.key] + alike, vault_nats, clean, found
        ),
        "sentence": effect.family.sentence(effect, told),
    }


def _shown(vault: tuple, there: Model | None, numbers: list[int]) -> float | None:
    """Nats by which some effects of a model predict the vault; None where there is none."""
    return there and without_effects(vault, there, numbers).energy - there.energy


def _may_go_otherwise(found: search.Found, ears: tuple, number: int, vault_nats: float | None) -> bool:
    """Whether another way than an effect's explains nearly as much, or the vault refuses this one."""
    refused = found.model.effects[number].family.has_ways and _is_refused(vault_nats)
    return refused or exchange.is_one_of_many(ears, found.model, found.ways, number)


def _is_refused(vault_nats: float | None) -> bool:
    """Whether the vault speaks against it."""
    return vault_nats is not None and vault_nats < -policy.RIVAL_NATS


def _alternatives(effect, rivals) -> dict:
    names = [rival.owner for rival, nats in rivals if nats < policy.RIVAL_NATS and rival.family.name == effect.family.name]
    return {"alternatives": names} if names else {}


def _confidence(effect, gain: float, behind: list, vault_nats: float | None, clean: bool, found: search.Found) -> float:
    """Probability that family and owner are right; `behind`: nats of what else it may be; `vault_nats`: by which it predicts what
    took no part in fitting it."""
    margin = min(behind, default=None)
    if margin is None:  # nothing else was compared: there was none, or no time
        margin = policy.RIVAL_NATS / 2 if found.spent else 1e3
    sure = policy.SUREST / (1 + float(np.exp(-np.clip(margin / 2, -30, 30))))
    sure *= 1 - float(np.exp(-np.clip(gain / policy.LEAST_EVIDENCE_NATS, 0, 50)))
    if _is_refused(vault_nats):
        sure *= policy.SURE_IF_REFUSED if effect.family.lasts else policy.SURE_IF_ELSEWHERE
    elif vault_nats is not None and effect.family.lasts and abs(vault_nats) < 1.0:
        sure *= policy.SURE_IF_UNSHOWN
    if len(found.model.effects) >= policy.MOST_EFFECTS:
        sure *= policy.SURE_IF_MANY
    if clean and found.spent:
        sure *= policy.SURE_IF_SPENT
    if not clean:
        sure *= policy.SURE_IF_LEFT * (policy.SURE_IF_FLEXIBLE if effect.family.is_flexible else 1.0)
    return round(sure, 3)


def _over_wells(effect, wells: list) -> np.ndarray:
    """Covariance of an effect's numbers whose 95 % interval reaches every open well that has its share of the likelihood."""
    away = [(behind, values - effect.values) for behind, values in wells]
    total = 1.0 + sum(np.exp(-behind) for behind, _ in away)
    out = np.zeros((len(effect.values),) * 2)
    for behind, far in away:
        if np.exp(-behind) / total > policy.WELL_SHARE:
            out += np.outer(far, far) / ndtri(0.975) ** 2
    return out


def _besides(view: View, found: search.Found, number: int) -> np.ndarray:
    effect = found.model.effects[number]
    return effect.family.besides(view, effect)


def _doubt(found: search.Found, ears, clean: bool) -> float:
    """By what covariances are too small where something is left that nobody named: it may lie along one number of each link."""
    left = max(0.0, found.model.left_nats(found.count))
    return 1.0 if clean else 1.0 + 2 * left / sum(len(one.predictor.links) for one in ears)


def _links(ears, less: Model, model: Model) -> list[str]:
    """Links whose energy an effect changes."""
    found = {}
    for one, a, b in zip(ears, less.fits, model.fits, strict=True):
        for index, (tx, rx) in enumerate(one.predictor.links):
            nats = one.nats(a)[index] - one.nats(b)[index]
            found[f"{tx}>{rx}"] = max(found.get(f"{tx}>{rx}", 0.0), float(nats))
    return [link for link, nats in found.items() if nats > policy.LINK_NATS]


def residual_over_received(ears, before: Model, after: Model, first: int, is_vault: bool) -> dict:
    """Residual over received power on the vault, and what noise alone would leave; of responses where there are any."""
    own = slice(first, first + len(ears))
    rows = list(zip(ears, before.fits[own], after.fits[own], strict=True))
    told = [row for row in rows if row[0].has_responses]
    out = {"split": "vault" if is_vault else "fitted"}
    left = [sum(float((np.abs(fit.residual) ** 2).sum()) for fit in fits) for fits in list(zip(*(told or rows), strict=True))[1:]]
    if told:
        total = sum(float((np.abs(one.heard.y) ** 2).sum()) for one, *_ in told)
        noise = sum(float((1 / one.heard.weight[one.heard.weight > 0]).sum()) for one, *_ in told)
        names = ("twin_nmse_db", "corrected_nmse_db", "noise_floor_db")
        return out | {
            n: float(db_from_power(max(v, 1e-300) / max(total, 1e-300))) for n, v in zip(names, (*left, noise), strict=True)
        }
    count = sum(int((one.weight > 0).sum()) for one in ears)
    noise = sum(float((0.5 / one.weight[one.weight > 0]).sum()) for one in ears)
    names = ("twin_rmse_db", "corrected_rmse_db", "noise_rmse_db")
    return out | {n: float(np.sqrt(v / max(count, 1))) for n, v in zip(names, (*left, noise), strict=True)}


def _residual(found: search.Found, ears, after: Model) -> dict:
    """What is left above noise and random fields on the fitted soundings, and the links that hold it."""
    where, world = [], found.model.world
    for one, fit in zip(ears, after.fits, strict=False):
        per = diffuse.left(one, fit, world)
        count = (one.root > 0).sum(axis=(1, 2)) * (1.0 if one.has_responses else 0.5)
        for index, (tx, rx) in enumerate(one.predictor.links):
            above = (per[index] - count[index]) / np.sqrt(max(count[index], 1.0))
            if above > policy.CLEAN_DEVIATIONS:
                where.append({"links": [f"{tx}>{rx}"], "deviations": round(float(above), 1)})
    return {
        "unexplained_db": float(db_from_power(max((found.model.energy - found.model.offset) / max(found.count, 1.0), 1e-12))),
        "p_value": float(ndtr(-found.deviations)),
        "where": where,
        "out_of_time": found.spent,
    }
