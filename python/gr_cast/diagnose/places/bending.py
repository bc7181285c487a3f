# SPDX-License-Identifier: GPL-3.0-or-later
"""Diffraction is known less well than mirror images: real corners are no perfect wedges. How strong each edge bends on a link is
therefore a random number about what the theory says, and what the sounding says of it is taken out of the residual."""

from dataclasses import dataclass, replace

import numpy as np

from ...scenario.create.images import tracing
from ...twin.places.predict import summed
from . import policy

_UNSPOILT = 0.5  # of a response's say: where all have more, nothing is to be weighed anew


def loosened(ear, fit, world):
    """The fit with the likeliest strength of every edge on every link, Gaussian about the theory; energy: all strengths alike.
    And the same where responses that these leave spoilt, by another cause, have no more say than their noise would give them."""
    if not ear.has_responses or not world.diffraction:
        return fit, fit
    weight, columns = ear.heard.weight, _columns(ear, fit, world)
    if not any(map(len, columns)):  # the same to the last digit
        return fit, fit
    plain = _loosened(ear, fit, columns, weight)
    share = np.where((weight > 0).any(axis=2), ear.undisturbed(plain), 1.0)[:, :, None]
    return plain, plain if share.min() > _UNSPOILT else _loosened(ear, fit, columns, weight * share)


def _loosened(ear, fit, links: list[np.ndarray], weight: np.ndarray):
    model, residual = fit.model.copy(), fit.residual.copy()
    price = 0.0
    for columns, *link in zip(links, weight, model, residual, strict=True):
        price += _loosen(policy.EDGE_SHARE * columns, *link) if len(columns) else 0.0
    energy = float((np.abs(residual) ** 2 * ear.heard.weight).sum()) + fit.offset + price
    return replace(fit, model=model, residual=residual, energy=energy, offset=fit.offset + price)


def _loosen(fields: np.ndarray, weight: np.ndarray, model: np.ndarray, residual: np.ndarray) -> float:
    """Model and residual (T, K), in their place, with the likeliest strengths of edges that make so much more (E, T, K) by a
    Gaussian number of unit power each; what these cost, in nats."""
    if tracing:
        return tracing.loosen(fields, weight, model, residual)
    flat = fields.reshape(len(fields), -1)
    own = flat.conj() * weight.ravel()
    inner = own @ flat.T + np.eye(len(flat))
    change = np.linalg.solve(inner, own @ residual.ravel())
    more = (change @ flat).reshape(residual.shape)
    model += more
    residual -= np.where(weight > 0, more, 0)
    return float((np.abs(change) ** 2).sum() + np.linalg.slogdet(inner)[1])


@dataclass(frozen=True, eq=False, kw_only=True)
class Edges:
    """How loud edges are on a link, over noise: `bent` (E, T·K), the powers (E,) that these have together, and what turns them
    to these (E, E)."""

    bent: np.ndarray
    power: np.ndarray
    turn: np.ndarray


def edges(ear, fit, world) -> list[Edges | None]:
    """Of each link; None where none counts."""
    if not ear.has_responses or not world.diffraction:
        return []
    return [_edges(*link) for link in zip(_columns(ear, fit, world), ear.heard.weight, strict=True)]


def _edges(columns: np.ndarray, weight: np.ndarray) -> Edges | None:
    if not len(columns):
        return None
    bent = policy.EDGE_SHARE * (columns * np.sqrt(weight)).reshape(len(columns), -1)
    power, turn = np.linalg.eigh(bent.conj() @ bent.T)
    return Edges(bent=bent, power=np.maximum(power, 0), turn=turn)


def whitened(links: list[Edges | None], rows: np.ndarray, *, left: bool = False) -> np.ndarray:
    """Rows (n, numbers of the residual) of a linear problem, over what noise and edges of unknown strength together may be.
    `left`: of what `loosened` leaves, which is less already."""
    if not any(links):
        return rows
    half = rows.shape[1] // 2
    fields = (rows[:, :half] + 1j * rows[:, half:]).reshape(len(rows), len(links), -1)
    for index, one in enumerate(links):
        if one:
            share = (1 - (1 + one.power) ** (0.5 if left else -0.5)) / np.where(one.power > 0, one.power, 1)
            seen = (fields[:, index] @ one.bent.conj().T) @ one.turn.conj()
            fields[:, index] -= (seen * share) @ (one.turn.T @ one.bent)
    flat = fields.reshape(len(rows), -1)
    return np.concatenate([flat.real, flat.imag], axis=1)


def _columns(ear, fit, world) -> list[np.ndarray]:
    """(E, T, K) of every link: what each edge that counts gives to its response."""
    predictor = ear.predictor
    scale = fit.factor * predictor.all_cables(world)[:, None]
    power = (np.abs(scale) ** 2 * ear.heard.weight).sum(axis=(1, 2))
    out = []
    for bent, own, loud in zip(predictor.all_bent(world), scale, power, strict=True):
        strength = np.bincount(bent.edge, np.abs(bent.gain) ** 2) * (loud / bent.many)
        counts = strength * policy.EDGE_SHARE**2 > policy.EDGE_NATS
        use, place, edges = counts[bent.edge], np.cumsum(counts) - 1, int(counts.sum())
        if not edges:
            out.append(np.zeros((0, *own.shape), complex))
            continue
        rows, many = place[bent.edge[use]] * bent.many + bent.instant[use], edges * bent.many
        fields = summed(rows, bent.gain[use], bent.length_m[use], many, world.carrier_hz, predictor.frequency_hz)
        out.append(fields.reshape(edges, bent.many, -1) * own)
    return out
