# SPDX-License-Identifier: GPL-3.0-or-later
"""What is sounded: links, instants, frequencies, what the sounder does not know, and the soundings it brings home."""

from dataclasses import dataclass, replace

import numpy as np
from world import excess, is_moving, response


@dataclass(frozen=True, kw_only=True)
class Campaign:
    links: tuple
    time_s: np.ndarray
    frequency_hz: np.ndarray
    unknown: dict
    kind: str  # of the place
    free: np.ndarray  # box that nodes are drawn from


def draw(rng, w, nodes, free, kind, duration_s, senders, listeners, guests, power=False):
    """(first campaign, vault): senders to listeners first, then to nodes at other places, later."""
    first = [(a, b) for a in senders for b in listeners][:12]
    if len(senders) > 1 and rng.random() < 0.25 and len(first) < 12:
        first.append((senders[0], senders[1]))
    later = [(a, b) for a in senders for b in guests]
    later += [(guests[0], b) for b in listeners] if guests else first
    later += [(a, b) for a in senders for b in listeners if is_moving(nodes[b])]
    count = int(rng.integers(25, 41)) if power else int(rng.integers(5, 26))
    step = 0.72 * duration_s / count
    tones = int(rng.choice([32, 40, 44, 48, 51, 55, 64, 80, 96]))
    f = ((np.arange(tones) + 0.5) / tones - 0.5) * w["bandwidth_hz"]
    unknown = {
        "phase": str(rng.choice(["none", "link", "snapshot"], p=[0.25, 0.3, 0.45])),
        "delay": str(rng.choice(["none", "node", "link"], p=[0.5, 0.25, 0.25])),
        "gain": str(rng.choice(["none", "common", "node"], p=[0.45, 0.35, 0.2])),
    }
    if power:
        unknown = {"phase": "none", "delay": "none", "gain": unknown["gain"]}
    one = Campaign(
        links=tuple(first), time_s=np.round(step * np.arange(count), 4), frequency_hz=f, unknown=unknown, kind=kind, free=free
    )
    instants = max(3, count // 4)
    when = np.round(duration_s * np.linspace(0.77, 0.98, instants), 4)
    return one, replace(one, links=tuple(dict.fromkeys(later)), time_s=when)


def noises(rng, campaign, level, spread=0.15):
    return level * np.exp(rng.normal(0, spread, len(campaign.links)))


def sounded(rng, world, campaign, noise_power, change=None):
    """Responses with noise, and with the phases, delays and gains that nobody knows; `change` turns the clean ones first."""
    h = response(world, campaign.links, campaign.time_s, campaign.frequency_hz)
    if change is not None:
        h = change(h)
    count, (phase, delay, gain) = len(h), (campaign.unknown[k] for k in ("phase", "delay", "gain"))
    nodes = sorted({n for link in campaign.links for n in link})
    ends = [[nodes.index(n) for n in link] for link in campaign.links]
    if phase != "none":
        shape = (*h.shape[:2], 1) if phase == "snapshot" else (count, 1, 1)
        h = h * np.exp(2j * np.pi * rng.random(shape))
    if delay != "none":
        late = rng.normal(0, 8e-9, len(nodes))[ends].sum(1) if delay == "node" else rng.normal(0, 10e-9, count)
        h = h * np.exp(-2j * np.pi * campaign.frequency_hz * late[:, None, None])
    if gain != "none":
        db = rng.normal(0, 1.5, len(nodes))[ends].sum(1) if gain == "node" else np.full(count, rng.normal(0, 2))
        h = h * 10 ** (db[:, None, None] / 20)
    noise = (rng.normal(size=h.shape) + 1j * rng.normal(size=h.shape)) * np.sqrt(noise_power / 2)[:, None, None]
    return (h + noise).astype(np.complex64)


def left(model_world, data, campaign, noise_power):
    """Energy that a world leaves in soundings, over the noise."""
    h = response(model_world, campaign.links, campaign.time_s, campaign.frequency_hz)
    return excess(h, data, noise_power, campaign.links, campaign.frequency_hz, campaign.unknown)[0]
