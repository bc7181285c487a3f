# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of received power alone: one cause, or none, that a meter on the way can show."""

from dataclasses import replace

import cases
import numpy as np
import truths
from causes import Cause, Unfit, antenna_pattern, excess_loss, ground, node_gain
from world import is_moving, position_m, power_db

FAMILIES = ("node_gain", "antenna_pattern", "ground", "excess_loss", "small_scale", "meter_limits", None)
DRAWN = {"node_gain": node_gain, "antenna_pattern": antenna_pattern, "ground": ground, "excess_loss": excess_loss}


def left(model_db, data_db, std_db, campaign):
    """Misfit over the meter's error after the gains that nobody knows."""
    rest = np.where(np.isfinite(data_db), data_db - model_db, 0)
    has = np.isfinite(data_db) / std_db[:, None]
    nodes = sorted({n for link in campaign.links for n in link})
    ends = np.array([[n in link for n in nodes] for link in campaign.links], float)
    if campaign.unknown["gain"] != "none":
        ends = ends if campaign.unknown["gain"] == "node" else np.ones((len(rest), 1))
        weight, mean = (has**2).sum(1), (has**2 * rest).sum(1)
        root = np.sqrt(weight)
        gains = np.linalg.lstsq(ends * root[:, None], mean / np.maximum(root, 1e-12), rcond=1e-9)[0]
        rest = rest - (ends @ gains)[:, None]
    return float(((has * rest) ** 2).sum())


def draw(rng, family=None):
    family = FAMILIES[int(rng.integers(len(FAMILIES)))] if family not in FAMILIES else family
    kind = str(rng.choice(["street", "yard"])) if family == "ground" else None
    twin, first, vault = cases.stage(rng, kind, family != "ground", power=True, moving=int(rng.integers(1, 3)))
    links = [k for k in first.links if any(is_moving(twin["nodes"][n]) for n in k)]
    still = [k for k in first.links if k not in links][:2]
    if family in ("excess_loss", "node_gain", "meter_limits"):
        still = [k for k in first.links if k not in links]
    first = replace(first, links=tuple(links + still))
    vault = replace(vault, links=first.links)
    if len(first.links) < 2:
        raise Unfit
    std = np.full(len(first.links), float(rng.uniform(0.3, 1.2)))
    clean = power_db(twin, first.links, first.time_s)
    if clean.min() < -170:
        raise Unfit
    if family in DRAWN:
        twin, cause = DRAWN[family](rng, twin, first, [], set())
        world, change = cause.apply(twin), None
    elif family == "small_scale":
        world, (cause, change) = twin, _fading(rng, twin, first)
    elif family == "meter_limits":
        world, (cause, change) = twin, _meter(rng, clean, std, first)
    else:
        world, cause, change = twin, None, None
    later = np.random.default_rng(int(rng.integers(2**31)))
    effects = []
    model = power_db(twin, first.links, first.time_s)
    if cause:
        shown = power_db(world, first.links, first.time_s)
        if change:
            shown = change(np.random.default_rng(5), shown, first)
        strength = left(model, shown, std, first)
        if not 50 <= strength <= 1e5:
            raise Unfit
        each = (((shown - model) / std[:, None]) ** 2).sum(1)
        where = [">".join(k) for k, e in zip(first.links, each, strict=True) if e > max(4.0, 0.01 * each.max())]
        best = _best_rival(twin, shown, std, first, cause)
        if best[0] < max(cases.MARGIN, cases.SHARE * strength):
            raise Unfit
        effects.append(truths.effect(cause, world, twin, first, std, strength, where, [best]))
    result = {"twin": twin, "world": world, "effects": effects, "first": first, "vault": vault}
    result["soundings"] = lambda r: (_files(later, world, twin, first, vault, std, change), None)
    return result


def _fading(rng, twin, campaign):
    """Rician power about the mean along the way of one link."""
    moving = [k for k in campaign.links if any(is_moving(twin["nodes"][n]) for n in k)]
    link = moving[int(rng.integers(len(moving)))]
    k_db, reach = float(rng.uniform(-2, 9)), float(rng.uniform(0.05, 0.4))
    name = ">".join(link)
    seed = int(rng.integers(2**31))

    def change(r, shown, c):
        at = np.concatenate([position_m(twin["nodes"][n], c.time_s) for n in link], 1)
        gap = np.linalg.norm(at[:, None] - at[None], axis=2)
        root = np.linalg.cholesky(np.exp(-((gap / reach) ** 2)) + 1e-9 * np.eye(len(at)))
        own = np.random.default_rng([seed, len(c.time_s)])
        ray = root @ (own.normal(size=(len(at), 2)) @ [1, 1j]) / np.sqrt(2)
        k = 10 ** (k_db / 10)
        turn = np.exp(2j * np.pi * own.random())
        out = shown.copy()
        out[c.links.index(link)] += 20 * np.log10(np.maximum(np.abs(np.sqrt(k / (k + 1)) * turn + ray / np.sqrt(k + 1)), 1e-3))
        return out

    parameters = {"k_factor_db": {"value": k_db, "z": False}, "coherence_m": {"value": reach, "z": False}}
    cause = Cause(family="small_scale", level="link", name=name, apply=lambda x: x, parameters=parameters, owners=(name,))
    return cause, change


def _meter(rng, clean, std, campaign):
    """A receiver that saturates, goes blind or reads in steps."""
    name = campaign.links[int(rng.integers(len(campaign.links)))][1]
    mine = np.array([k[1] == name for k in campaign.links])
    way = str(rng.choice(["top", "floor", "steps"]))
    if way == "steps":
        step = float(np.round(rng.uniform(3, 10), 1))
        number = {"step_db": {"value": step, "z": True}}
    else:
        level = float(np.quantile(clean[mine], rng.uniform(0.5, 0.85) if way == "top" else rng.uniform(0.15, 0.5)))
        number = {"level_db": {"value": level, "z": True}}

    def change(r, shown, c):
        on = np.array([k[1] == name for k in c.links])
        out = shown.copy()
        if way == "steps":
            out[on] = np.round(out[on] / step) * step
        else:
            out[on] = np.minimum(out[on], level) if way == "top" else np.maximum(out[on], level)
        return out

    return Cause(family="meter_limits", level="node", name=name, apply=lambda x: x, parameters=number, owners=(name,)), change


def _best_rival(twin, shown, std, campaign, cause):
    """The other family that leaves least: gains, losses, patterns, distance law, ground."""
    model = power_db(twin, campaign.links, campaign.time_s)
    out = []

    def add(family, owner, columns=None, base=model):
        if (family, owner) == (cause.family, cause.name):
            return
        rest, weight = (shown - base).ravel(), np.repeat(1 / std, shown.shape[1])
        columns = [] if columns is None else [columns]
        nodes = sorted({n for link in campaign.links for n in link})
        if campaign.unknown["gain"] == "common":
            columns.append(np.ones(shown.shape))
        if campaign.unknown["gain"] == "node":
            columns += [np.array([n in k for k in campaign.links])[:, None] * np.ones(shown.shape) for n in nodes]
        if columns:
            a = np.stack([c.ravel() for c in columns], 1) * weight[:, None]
            rest = rest - (a / weight[:, None]) @ np.linalg.lstsq(a, rest * weight, rcond=1e-9)[0]
        out.append((float(((rest * weight) ** 2).sum()), family, owner))

    for n in sorted({n for link in campaign.links for n in link}):
        add("node_gain", n, np.array([n in k for k in campaign.links])[:, None] * np.ones(shown.shape))
        for antenna in ("iso", "dipole", "hw_dipole", "tr38901"):
            nodes = {**twin["nodes"], n: {**twin["nodes"][n], "antenna": antenna}}
            add("antenna_pattern", n, base=power_db({**twin, "nodes": nodes}, campaign.links, campaign.time_s))
    if cause.family != "node_gain":
        for k, link in enumerate(campaign.links):
            add("excess_loss", ">".join(link), (np.arange(len(campaign.links)) == k)[:, None] * np.ones(shown.shape))
    ways = {n: position_m(twin["nodes"][n], campaign.time_s) for link in campaign.links for n in link}
    far = np.array([np.linalg.norm(ways[a] - ways[b], axis=1) for a, b in campaign.links])
    add("excess_loss", "place", np.log10(far))
    if campaign.kind in ("street", "yard"):
        for height in (-0.4, 0.0):
            g = {"height_m": height, "permittivity": 8.0, "conductivity": 0.01}
            add("ground", "place", base=power_db({**twin, "ground": g}, campaign.links, campaign.time_s))
    return min(out)


def _files(rng, world, twin, first, vault, std, change):
    out = []
    nodes = sorted({n for link in first.links for n in link})
    db = np.zeros(len(first.links))
    if first.unknown["gain"] == "common":
        db += rng.normal(0, 2)
    elif first.unknown["gain"] == "node":
        each = dict(zip(nodes, rng.normal(0, 1.5, len(nodes)), strict=True))
        db += [each[a] + each[b] for a, b in first.links]
    for name, c, use in (("first.npz", first, {}), ("second.npz", vault, {"use": "vault"})):
        shown = power_db(world, c.links, c.time_s) + db[:, None] + rng.normal(size=(len(c.links), len(c.time_s))) * std[:, None]
        if change:  # a meter limits what it reads, noise included
            shown = change(rng, shown, c)
        tx, rx = (np.array(x) for x in zip(*c.links, strict=True))
        out.append((name, {"tx": tx, "rx": rx, "time_s": c.time_s, "power_db": shown, "std_db": std}, use))
    return out
