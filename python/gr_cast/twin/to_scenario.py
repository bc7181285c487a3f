# SPDX-License-Identifier: GPL-3.0-or-later
"""A corrected twin's links as a scenario: paths that a diagnosis found, took away or moved; what is a radio's stays behind."""

from dataclasses import dataclass, replace

import numpy as np

from ..core.errors import CastError
from ..core.units import amplitude_from_db, db_from_amplitude
from ..scenario import LinkTaps, Scenario, base_loss_db, link_name
from .chain import Chain
from .document import Case, Observation
from .effects import FAMILIES
from .effects.base import LINK
from .playback import Conditions, Playback
from .scene import Path

UPDATE_S, LASTS_S = 1e-3, 1.0  # of a scenario that stood still, where a path turns with a Doppler
SURE = 3.0  # standard deviations
SAME_DELAY_S = 5e-9  # half a step of the scenarios' grid


@dataclass(frozen=True, kw_only=True)
class Corrected:
    """The scenario, the links that changed in it, and the twin's effects that no scenario can hold, each `family (owner)`."""

    scenario: Scenario
    changed: tuple[tuple[str, str], ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _Found:
    """One link's paths before and after the twin's effects, on the span of `span_s` of its recording from its beginning on."""

    before: list[Path]
    after: list[Path]
    span_s: float
    rate_hz: float


def corrected(twin: Case, onto: Scenario | None = None, at_s: float = 0.0) -> Corrected:
    """The links of `twin` with its effects on them, in the scenario `onto` that the twin was made from at `at_s`; without it a
    scenario of the twin's links alone, each from its first path on."""
    twin = replace(twin, effects=tuple(_sure(entry) for entry in twin.effects))
    found, left_out, held = {}, {}, set()
    for observation in twin.observations:
        for tx, link in _links(twin, observation, left_out, held).items():
            found.setdefault((tx, observation.receiver), link)
    start = onto or _own(twin, found)
    wrong = [link_name(key) for key in found if key not in start.links]
    if wrong:
        raise CastError(f"{start.name}: has no link {', '.join(wrong)}, which the twin has: another scenario?")
    links, clock, changed = dict(start.links), start.time_s, []
    if start.is_static and any(p.doppler != q.doppler for f in found.values() for p, q in _pairs(f)):
        clock = np.arange(0, LASTS_S + UPDATE_S / 2, UPDATE_S)
    for key, link in found.items():
        if not _differs(link):
            continue
        back = (key[1], key[0])
        both_ways = back not in found and links.get(back) == links[key]  # the same channel the other way
        links[key] = _moved(start, key, link, clock, at_s)
        changed.append(key)
        if both_ways:
            links[back] = links[key]
    early_s = min(0.0, *(float(t.delay_s[t.gain != 0].min(initial=0.0)) for t in links.values()))
    if early_s:  # an echo ahead of the first path: all links wait for it alike
        links = {key: LinkTaps(delay_s=t.delay_s - early_s, gain=t.gain) for key, t in links.items()}
    lost = tuple(name for key, name in left_out.items() if key not in held)
    position_m = {node: track if len(clock) == len(start.time_s) else track[:1] for node, track in start.position_m.items()}
    made = replace(start, name=f"{start.name}, corrected", links=links, time_s=clock, position_m=position_m)
    return Corrected(scenario=made, changed=tuple(changed), left_out=lost)


def _sure(entry: dict) -> dict:
    """The entry without a Doppler that its error may make: a path would turn for ever by what is chance."""
    told = entry["parameters"].get("doppler_hz")
    if isinstance(told, dict) and told.get("std") and abs(told.get("value") or 0.0) < SURE * told["std"]:
        return entry | {"parameters": entry["parameters"] | {"doppler_hz": told | {"value": 0.0}}}
    return entry


def _links(twin: Case, observation: Observation, left_out: dict, held: set) -> dict[str, _Found]:
    """Transmitter to its link in one recording. Effects that are no plain path are noted in `left_out`, the others in `held`."""
    count = round(twin.sample_rate_hz * LASTS_S)
    playback = Playback(twin, observation, count, Conditions(gain_db=0.0))
    scene = playback.scene
    paths = list(scene.taps)
    for effect in playback.model.effects:
        family, entry = FAMILIES[effect.family], effect.aux["entry"]
        chain = Chain(scene=scene, delay=0.0, ports={}, paths=list(paths), u=scene.u)
        if family.at(effect) == LINK:
            family.apply(chain, effect)
        if chain.paths == paths or any(p.track is not None or p.shape is not None for p in chain.paths):
            left_out[entry] = f"{effect.family} ({twin.effects[entry]['owner']['name']})"
            continue
        paths = chain.paths
        held.add(entry)
    return {
        tx: _Found(
            before=[p for p in scene.taps if p.source == i],
            after=[p for p in paths if p.source == i],
            span_s=scene.duration_s,
            rate_hz=twin.sample_rate_hz,
        )
        for i, tx in enumerate(scene.transmitters)
    }


def _pairs(link: _Found):
    """Every path of the twin with what became of it, and every new one with none of no gain."""
    for k, after in enumerate(link.after):
        yield (link.before[k] if k < len(link.before) else replace(after, gain=0j, doppler=0.0)), after


def _differs(link: _Found) -> bool:
    return any((p.gain, p.delay, p.doppler) != (q.gain, q.delay, q.doppler) for p, q in _pairs(link))


def _moved(scenario: Scenario, key: tuple[str, str], link: _Found, clock: np.ndarray, at_s: float) -> LinkTaps:
    """A scenario's link with what the twin's paths became, over the whole scenario."""
    taps = scenario.links[key]
    turns = any(p.doppler != q.doppler for p, q in _pairs(link))
    rows = len(clock) if turns else len(taps.gain)
    delay_s = np.broadcast_to(taps.delay_s, (rows, taps.delay_s.shape[1])).copy()
    gain = np.broadcast_to(taps.gain, delay_s.shape).copy()
    here = int(np.clip(np.searchsorted(scenario.time_s, at_s + 1e-12, side="right") - 1, 0, len(taps.gain) - 1))
    shift_s = _twin_delay_s(link) - taps.delay_s[here][taps.gain[here] != 0].min()
    when = (clock if turns else clock[:rows]) - at_s
    for before, after in _pairs(link):
        turn = np.exp(2j * np.pi * (after.doppler - before.doppler) / link.span_s * when)[:rows]
        if before.gain == 0:  # a path that was not there
            new = np.full((rows, 1), after.delay / link.rate_hz - shift_s)
            delay_s = np.concatenate([delay_s, new], axis=1)
            played = after.gain / amplitude_from_db(-base_loss_db(scenario, key)) * turn
            gain = np.concatenate([gain, played[:, None]], axis=1)
            continue
        apart_s = np.abs(taps.delay_s[here] + shift_s - before.delay / link.rate_hz)
        tap = int(np.argmin(np.where(taps.gain[here] != 0, apart_s, np.inf)))
        if apart_s[tap] > SAME_DELAY_S:
            raise CastError(
                f"{scenario.name}: link {link_name(key)}: no tap at {before.delay / link.rate_hz:.4g} s, where the twin has one: "
                f"another scenario, or another --at than {at_s:g} s?"
            )
        delay_s[:, tap] += (after.delay - before.delay) / link.rate_hz
        gain[:, tap] *= after.gain / before.gain * turn
    used = (gain != 0).any(axis=0)
    return LinkTaps(delay_s=delay_s[:, used], gain=gain[:, used])


def _twin_delay_s(link: _Found) -> float:
    return min(p.delay for p in link.before) / link.rate_hz


def _own(twin: Case, found: dict) -> Scenario:
    """The twin's links as they are, each from its first path on, the strongest path of all at 0 dB before the base loss."""
    strongest = max(abs(p.gain) for link in found.values() for p in link.before)
    links = {
        key: LinkTaps(
            delay_s=[[p.delay / link.rate_hz - _twin_delay_s(link) for p in link.before]],
            gain=[[p.gain / strongest for p in link.before]],
        )
        for key, link in found.items()
    }
    carriers = [o.center_frequency_hz for o in twin.observations if o.center_frequency_hz]
    return Scenario(
        name=twin.name,
        nodes=tuple(dict.fromkeys(node for key in links for node in key)),
        links=links,
        center_frequency_hz=carriers[0] if carriers else None,
        base_loss_db=-float(db_from_amplitude(strongest)),
    )
