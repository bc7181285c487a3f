# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws cases with one to three causes, or none: only causes that matter and that no other single family explains."""

import campaign as campaigns
import numpy as np
import spaces
import truths
from causes import RESPONSE, Unfit, with_media, with_node
from rivals import Judge, runners_up
from sightings import lit_objects
from world import is_moving, material_of, response

MARGIN = 25.0  # nats by which the best other family must fail, and
SHARE = 0.05  # share of the strength
SNR_DB = (3.0, 42.0)


def stage(rng, kind=None, floor=True, power=False, moving=None):
    """(world without causes, first campaign, vault)."""
    w, free, kind = spaces.draw(rng, kind, floor)
    if rng.random() < 0.1 and not power:
        w["refraction"] = True
    senders, listeners, guests = int(rng.integers(1, 4)), int(rng.integers(2, 6)), int(rng.integers(2, 4))
    while not 4 <= senders * listeners <= 12 or senders + listeners + guests > 12:
        senders, listeners, guests = int(rng.integers(1, 5)), int(rng.integers(1, 7)), int(rng.integers(1, 4))
    moving = int(rng.choice([0, 0, 1, 1, 2])) if moving is None else moving
    moving = min(moving, listeners)
    duration = round(float(rng.uniform(4, 10)), 3)
    nodes = spaces.radios(rng, w, free, senders + listeners + guests, moving, duration, kind)
    names = list(nodes)
    shuffled = {n: nodes[n] for n in (names[k] for k in rng.permutation(len(names)))}
    w["nodes"] = shuffled
    heard, sent, spare = names[:listeners], names[listeners : listeners + senders], names[listeners + senders :]
    first, vault = campaigns.draw(rng, w, shuffled, free, kind, duration, sent, heard, spare, power)
    w["duration_s"] = duration
    return w, first, vault


def mean_power(w, campaign):
    """Median power of the links, at least six in ten of which must hear anything."""
    h = response(w, campaign.links, campaign.time_s[:3], campaign.frequency_hz[::4])
    power = (np.abs(h) ** 2).mean((1, 2))
    heard = power[power > 1e-18]
    if len(heard) < 0.6 * len(power):
        raise Unfit
    return float(np.median(heard))


def compose(worlds, causes, but=None):
    for c in causes:
        if c is not but:
            worlds = c.apply(worlds)
    return worlds


def concealed(rng, families):
    """One case with these families (the first asked for; the others drawn), or Unfit."""
    kind = str(rng.choice(["street", "yard"])) if "ground" in families else None
    moving = int(rng.integers(1, 3)) if "track_timing" in families else None
    twin, first, vault = stage(rng, kind, "ground" not in families, moving=moving)
    if "antenna_orientation" in families and not any(n["antenna"] == "tr38901" for n in twin["nodes"].values()):
        name = first.links[int(rng.integers(len(first.links)))][int(rng.integers(2))]
        twin = with_node(twin, name, antenna="tr38901")
    lit = lit_objects(twin, first)
    used, causes = set(), []
    for family in families:
        twin, cause = RESPONSE[family](rng, twin, first, lit, used)
        causes.append(cause)
    world = compose(twin, causes)
    snr = 10 ** (np.array(SNR_DB) / 10)
    power = mean_power(world, first)
    one = campaigns.noises(rng, first, power)
    raw = [truths.strengths(world, compose(twin, causes, c), first, one)[0] for c in causes]
    low, high = (50, 1e5) if len(causes) == 1 else (110, 2e4)
    target = np.exp(rng.uniform(np.log(low), np.log(high)))
    ratio = float(np.clip(target / max(min(raw), 1e-12), *snr))
    if min(raw) * ratio < low * 0.99 or max(raw) * ratio > 3e6:
        raise Unfit
    noise = one / ratio
    judge, rows = Judge(world, first, noise), []
    for c in causes:
        without = compose(twin, causes, c)
        strength, links = truths.strengths(world, without, first, noise)
        rows.append((c, without, strength, links, max(MARGIN, SHARE * strength)))
    for c, without, _, _, least in rows:
        runners_up(judge, without, c, lit, least, quick=True)  # most that fail fail here, in a moment
    effects = []
    for c, without, strength, links, least in rows:
        rivals = runners_up(judge, without, c, lit, least)
        effects.append(truths.effect(c, world, without, first, noise, strength, links, rivals))
    return {"twin": twin, "world": world, "effects": effects, "first": first, "vault": vault, "noise": noise, "lit": lit}


def clean(rng):
    """Nothing wrong; in half of them something is off by so little that nothing shows."""
    twin, first, vault = stage(rng)
    world = twin
    power = mean_power(twin, first)
    noise = campaigns.noises(rng, first, power / 10 ** (rng.uniform(5, 38) / 10))
    if rng.random() < 0.5:
        for _ in range(20):
            name = first.links[int(rng.integers(len(first.links)))][1]
            world = with_node(twin, name, offset_m=(rng.normal(size=3) * 10 ** rng.uniform(-5, -3)).tolist())
            thing = list(twin["objects"])[int(rng.integers(len(twin["objects"])))]
            world = with_media(world, thing, permittivity=_slightly(rng, twin, thing))
            late = np.full(len(vault.links), np.exp(np.mean(np.log(noise))))
            if max(truths.strengths(world, twin, *x)[0] for x in ((first, noise), (vault, late))) < 0.5:
                break
            world = twin
    return {"twin": twin, "world": world, "effects": [], "first": first, "vault": vault, "noise": noise, "lit": []}


def _slightly(rng, w, thing):
    return float(material_of(w, thing)["permittivity"] * (1 + rng.normal() * 1e-4))


def conditions(case):
    w, first = case["twin"], case["first"]
    return {
        "place": first.kind,
        "objects": len(w["objects"]),
        "links": len(first.links),
        "snapshots": len(first.time_s),
        "frequencies": len(first.frequency_hz),
        "carrier_hz": w["carrier_hz"],
        "bandwidth_hz": w["bandwidth_hz"],
        "max_depth": w["max_depth"],
        "moving": sum(is_moving(w["nodes"][n]) for n in {n for link in first.links for n in link}),
    }
