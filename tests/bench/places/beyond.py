# SPDX-License-Identifier: GPL-3.0-or-later
"""Physics that no family holds: a diagnosis must say that it does not know."""

import campaign as campaigns
import cases
import numpy as np
import spaces
from causes import Cause, Unfit, moving_scatterer, one_of, with_media
from rivals import Judge, runners_up
from sightings import lit_objects
from world import excess, material_of, response

FAMILIES = (
    "wall_changes",
    "gain_wanders",
    "ripple",
    "clock_drifts",
    "sways",
    "tone",
    "compression",
    "swapped",
    "curved_wall",
    "two_walkers",
)
TOLERATED = {
    "wall_changes": ["material", "extra_object", "missing_object", "moving_scatterer", "roughness"],
    "gain_wanders": [],
    "ripple": [],
    "clock_drifts": [],
    "sways": ["node_position", "track_timing"],
    "tone": [],
    "compression": [],
    "swapped": [],
    "curved_wall": ["missing_object"],
    "two_walkers": ["moving_scatterer"],
}


def draw(rng, family=None):
    family = str(rng.choice(FAMILIES)) if family not in FAMILIES else family
    twin, first, vault = cases.stage(rng, moving=int(rng.choice([0, 1])))
    if family in ("gain_wanders", "ripple", "compression"):
        first.unknown["gain"] = "none" if family == "compression" else first.unknown["gain"]
    lit = lit_objects(twin, first)
    if not lit or len(first.time_s) < 8:
        raise Unfit
    owner, makes = MAKERS[family](rng, twin, first, lit)

    def changed(c):
        return lambda h: makes(c, h)

    h = response(twin, first.links, first.time_s, first.frequency_hz)
    full = changed(first)(h)
    power = cases.mean_power(twin, first)
    one = campaigns.noises(rng, first, power)
    raw = excess(h, full, one, first.links, first.frequency_hz, first.unknown)[0]
    target = np.exp(rng.uniform(np.log(400), np.log(5e4)))
    ratio = float(np.clip(target / max(raw, 1e-12), *(10 ** (np.array(cases.SNR_DB) / 10))))
    strength = raw * ratio
    if not 300 <= strength <= 3e5:
        raise Unfit
    noise = one / ratio
    judge = Judge(twin, first, noise)
    step = max(1, len(first.frequency_hz) // 16)
    judge.time_s, judge.f = first.time_s, first.frequency_hz[::step]
    judge.noise, judge.data = noise * len(judge.f) / len(first.frequency_hz), full[:, :, ::step]
    nobody = Cause(family="outside", level="place", name="", apply=lambda x: x)
    floor = max(100.0, 0.3 * strength)
    best = runners_up(judge, twin, nobody, lit, floor, TOLERATED[family])[0]
    effect = {
        "family": f"outside:{family}",
        "owner": {"level": "place", "name": owner},
        "lambda": strength,
        "margin_nats": best[0],
        "runner_up": list(best[1:]),
    }
    case = {"twin": twin, "world": twin, "effects": [effect], "first": first, "vault": vault, "noise": noise, "outside": family}
    return case | {"tolerated": TOLERATED[family], "change": (changed(first), changed(vault))}


def _time(c, h):
    return np.broadcast_to(c.time_s[None, :, None], h.shape)


def _on(c, name):
    return np.array([name in link for link in c.links])[:, None, None]


def _node(rng, first):
    return first.links[int(rng.integers(len(first.links)))][int(rng.integers(2))]


def wall_changes(rng, twin, first, lit):
    """A surface becomes another one and back while it is sounded."""
    name = lit[int(rng.integers(min(3, len(lit))))]
    other = {"permittivity": float(rng.choice([1.0, 12.0])), "conductivity": float(rng.choice([0.0, 1.0, 1e6]))}
    if other["conductivity"] > 100 and material_of(twin, name)["conductivity"] > 100:
        raise Unfit
    period = float(rng.uniform(1.0, 3.0))

    def makes(c, h):
        world = with_media(twin, name, **other)
        g = response(world, c.links, c.time_s, c.frequency_hz)
        share = (np.sin(2 * np.pi * _time(c, h) / period) + 1) / 2
        return h * (1 - share) + g * share

    return name, makes


def gain_wanders(rng, twin, first, lit):
    """An amplifier whose gain swings."""
    name, period, db, start = _node(rng, first), rng.uniform(0.8, 3), rng.uniform(2, 6), rng.uniform(0, 6)
    return name, lambda c, h: h * 10 ** (_on(c, name) * db * np.sin(2 * np.pi * _time(c, h) / period + start) / 20)


def ripple(rng, twin, first, lit):
    """A filter that is not flat in the band."""
    name, cycles, db = _node(rng, first), rng.uniform(1.5, 5), rng.uniform(1.5, 5)

    def makes(c, h):
        x = c.frequency_hz / twin["bandwidth_hz"]
        shape = db * np.cos(2 * np.pi * cycles * x) * (1 - 2 * np.abs(x)) + db * np.sign(np.sin(9 * x)) / 2
        return h * 10 ** (_on(c, name) * shape / 20)

    return name, makes


def clock_drifts(rng, twin, first, lit):
    """A sampling clock that runs away: delay grows with the square of time."""
    name, reach = _node(rng, first), rng.uniform(0.3, 1.5) / twin["bandwidth_hz"]
    end = first.time_s[-1]
    return name, lambda c, h: h * np.exp(-2j * np.pi * c.frequency_hz * reach * _on(c, name) * (_time(c, h) / end) ** 2)


def sways(rng, twin, first, lit):
    """A mast in the wind."""
    name, period, reach = _node(rng, first), rng.uniform(0.7, 2.5), rng.uniform(0.3, 1.5) * 299792458 / twin["carrier_hz"]
    angle = rng.uniform(0, 2 * np.pi)

    def makes(c, h):
        out = h.copy()
        mine = _on(c, name)[:, 0, 0]
        links = [k for k, m in zip(c.links, mine, strict=True) if m]
        for t, when in enumerate(c.time_s if links else []):
            far = reach * np.sin(2 * np.pi * when / period)
            node = {**twin["nodes"][name], "offset_m": [far * np.cos(angle), far * np.sin(angle), 0.0]}
            world = {**twin, "nodes": {**twin["nodes"], name: node}}
            out[mine, t] = response(world, links, c.time_s[t : t + 1], c.frequency_hz)[:, 0]
        return out

    return name, makes


def tone(rng, twin, first, lit):
    """Another transmitter in a part of the band, heard by one receiver, each time with a phase of its own."""
    name, width = first.links[int(rng.integers(len(first.links)))][1], rng.uniform(0.05, 0.2)
    middle, db, seed = rng.uniform(-0.4, 0.4), rng.uniform(-12, 3), int(rng.integers(2**31))

    def makes(c, h):
        x = np.abs(c.frequency_hz / twin["bandwidth_hz"] - middle) < width / 2 + 0.02
        own = np.random.default_rng([seed, len(c.time_s)])
        level = np.sqrt((np.abs(h) ** 2).mean((1, 2), keepdims=True)) * 10 ** (db / 20)
        return h + _on(c, name) * x * level * np.exp(2j * np.pi * own.random(h.shape))

    return name, makes


def compression(rng, twin, first, lit):
    """An amplifier that bends: strong answers lose more than weak ones."""
    name = _node(rng, first)
    power = (np.abs(response(twin, first.links, first.time_s, first.frequency_hz)) ** 2)[_on(first, name)[:, 0, 0]].mean()
    strength = rng.uniform(0.5, 3)
    if not power > 0:
        raise Unfit
    return name, lambda c, h: h / np.sqrt(1 + _on(c, name) * strength * np.abs(h) ** 2 / power)


def swapped(rng, twin, first, lit):
    """The recordings of two links, exchanged half of the time."""
    a, b = rng.permutation(len(first.links))[:2]

    def makes(c, h):
        if c.links != first.links:
            return h
        out = h.copy()
        odd = np.arange(h.shape[1]) % 2 == 1
        out[a, odd], out[b, odd] = h[b, odd], h[a, odd]
        return out

    return ">".join(first.links[a]), makes


def curved_wall(rng, twin, first, lit):
    """A mirror that is round, not flat: a ring of narrow metal facets stands for a pillar."""
    faces = spaces.faces_of(twin)
    x, y, _ = spaces.point(rng, faces, first.free, 0.6)
    radius, count = float(rng.uniform(0.25, 0.5 if first.kind in ("room", "corridor") else 1.5)), 48
    angle = np.arange(count + 1) * 2 * np.pi / count
    ring = np.stack([x + radius * np.cos(angle), y + radius * np.sin(angle), np.full(count + 1, -0.04)], 1)
    high = np.array([0, 0, 2.3])
    tris = np.concatenate([spaces.sheet(p, q - p, high) for p, q in zip(ring, ring[1:], strict=False)])
    world = {**twin, "objects": {**twin["objects"], "pillar": {"tris": tris, "surface": None}}}
    world = {**world, "materials": {**twin["materials"], "pillar": "metal"}, "max_depth": 1}
    flat = {**twin, "max_depth": 1}

    def makes(c, h):
        a, b = (response(w, c.links, c.time_s, c.frequency_hz) for w in (world, flat))
        return h + a - b

    return "place", makes


def two_walkers(rng, twin, first, lit):
    """Two bodies that cross each other's way."""
    bodies = [moving_scatterer(rng, twin, first, lit, set())[1].apply(twin)["person"] for _ in range(2)]

    def makes(c, h):
        return h + sum(response(one_of(twin, person=b), c.links, c.time_s, c.frequency_hz) - h for b in bodies)

    return "place", makes


MAKERS = {name: globals()[name] for name in FAMILIES}
