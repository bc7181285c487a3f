# SPDX-License-Identifier: GPL-3.0-or-later
"""What explains more in the place of what was found: a search tries simple families first, and a flexible one only where its
score promises far more."""

from ..twin.effects import FAMILIES, Effect
from .fit import Fit
from .policy import MOST_EFFECTS, SEARCH_MARGIN
from .search import candidates, claim_the_same, eliminate, plausible, proven, refit_or_known, roughness


def exchanged(fit: Fit, known: list[Fit]) -> Fit:
    """The fit with another effect in the place of one, as long as that makes the recording likelier and the whole proves itself.
    `known`: fits that the search made."""
    for _ in range(MOST_EFFECTS):
        others = [f for i in range(len(fit.model.effects)) for f in _in_place_of(fit, i, known)]
        if not others or fit.data.late:
            break
        best = max(others, key=lambda f: f.evidence)
        after = proven(fit.data, eliminate(fit.data, best, known), known)
        if after.evidence <= fit.evidence or fit.data.late:
            break
        fit = after
    return fit


def _in_place_of(fit: Fit, index: int, known: list[Fit]) -> list[Fit]:
    """The fits that are likelier with another effect than that of `index`."""
    effect, data = fit.model.effects[index], fit.data
    if effect.fixed or "read" in effect.aux or FAMILIES[effect.family].noise_like or data.late:
        return []
    bare = refit_or_known(data, fit.model.without(index), known)
    lost, found = fit.evidence - bare.evidence, []
    for s in candidates(bare):
        if s.net < lost - roughness(lost) or data.late:
            break
        if not _is_one(effect, s.effect) and not FAMILIES[s.effect.family].noise_like:
            found.append(refit_or_known(data, bare.model.adding(s.effect), known))
    return [f for f in found if f.evidence > fit.evidence + SEARCH_MARGIN and plausible(f.model)]


def _is_one(a: Effect, b: Effect) -> bool:
    """Whether two effects are one, and not two lengths of a row of taps or of a course."""
    return claim_the_same(a, b) and (a.prior is None or len(a.p) == len(b.p))
