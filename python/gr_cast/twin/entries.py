# SPDX-License-Identifier: GPL-3.0-or-later
"""What the entries of a twin's document are in one recording: its waveforms, effects and noise."""

from dataclasses import replace

import numpy as np

from .effects import FAMILIES, Role
from .scene import Source, bridged


def source_of(name: str, samples: np.ndarray, amplitude: float, repeat: bool) -> Source:
    """A waveform (n,) as sent with an amplitude; unknown samples, NaN, are `bridged`."""
    known = np.isfinite(samples)
    clean = bridged(samples, known, repeat) * amplitude
    power = np.abs(clean[known]) ** 2
    return Source(
        name=name, samples=clean, repeat=repeat, known=known, power=float(power.mean()), peak=float(np.sqrt(power.max()))
    )


def lost_before(case, observation) -> int:
    """Samples that the twin knows to be lost before a part of a recording begins: so much earlier is what was sent there."""
    losses = (e["parameters"]["samples"] for e in _in(case, observation) if _is_over(case, observation, e))
    return sum(round(plain(samples, observation.name)) for samples in losses)


def _is_over(case, observation, entry) -> bool:
    """Whether a part of a recording begins behind the samples that an entry says are lost."""
    if FAMILIES[entry["family"]].role is not Role.SLIP:
        return False
    return plain(entry["parameters"]["time_s"], observation.name) * case.sample_rate_hz <= observation.first


def known_losses(case, observation) -> list[tuple[int, int]]:
    """[(first sample behind it, samples lost)] of the losses within a part of a recording that the twin knows, the last first."""
    slips = [e["parameters"] for e in twin_effects(case, observation) if FAMILIES[e["family"]].role is Role.SLIP]
    number = lambda value: plain(value, observation.name)  # noqa: E731
    found = [(number(p["time_s"]) * case.sample_rate_hz - observation.first, number(p["samples"])) for p in slips]
    return sorted(((round(at), round(lost)) for at, lost in found), reverse=True)


def twin_effects(case, observation) -> list[dict]:
    """The twin's entries of `effects` that have a part in a recording, or in a part of one."""
    return [e for e in _in(case, observation) if not _is_over(case, observation, e)]


def _in(case, observation) -> list[dict]:
    names = {
        observation.receiver,
        *observation.on_air,
        "environment",
        *(f"{tx}>{observation.receiver}" for tx in observation.on_air),
    }
    return [e for e in case.effects if e["owner"]["name"] in names]


def plain(parameter, recording_name):
    """The value of an entry's parameter; one that differs by recording is the mean of all in a new recording."""
    if isinstance(parameter, dict) and "per_recording" in parameter:
        every = parameter["per_recording"]
        told = [every[recording_name]] if recording_name in every else every.values()
        return float(np.mean([v["value"] for v in told]))
    return parameter.get("value") if isinstance(parameter, dict) else parameter


def effect_of(scene, entry):
    """A twin's entry as an effect on a recording, or a part of one."""
    family = FAMILIES[entry["family"]]
    values = {k: plain(v, scene.name) for k, v in entry["parameters"].items()}
    values = {k: v for k, v in values.items() if v is not None}
    model = {**(entry.get("model") or {}), **_owned(scene, entry["owner"])}
    read = lambda told: family.in_its_part(scene, family.parse(scene, told, model))  # noqa: E731
    effect = read(values)
    told = {k: v.get("std") or 0.0 for k, v in entry["parameters"].items() if isinstance(v, dict) and "value" in v}
    stds = {k: std for k, std in told.items() if std > 0 and k in values}
    free = effect.free & (family.random or bool(stds))
    off = [read({**values, k: values[k] + std}).p for k, std in stds.items() if family.role in (Role.CARRIER, Role.CLOCK)]
    if not off:
        return replace(effect, fixed=True, free=free)
    told = np.linalg.norm(np.array(off) - effect.p, axis=0)
    unsaid = [read({**values, k: 1.0}).p != effect.p for k in family.parameters if k not in entry["parameters"]]
    open_ = np.any([told > 0, *unsaid], axis=0)
    return replace(effect, fixed=True, free=free & open_, aux={**effect.aux, "_told": told})


def in_either_seconds(scene, effects: tuple) -> tuple:
    """A twin's effects with its carrier open by carrier × clock, where it tells both: its Hz may be those of the receiver's clock
    or of one that is right."""
    gained = sum(e.p[0] for e in effects if FAMILIES[e.family].role is Role.CLOCK)
    return tuple(_open_by(scene, e, gained) if gained and FAMILIES[e.family].role is Role.CARRIER else e for e in effects)


def _open_by(scene, carrier, gained: float):
    """A twin's carrier whose cycles may be off by as much as a clock that gains so many samples makes of them."""
    told = np.array(carrier.aux.get("_told", np.zeros(len(carrier.p))))
    told[0] = np.hypot(told[0], carrier.p[0] * gained / scene.span)
    free = carrier.free | (np.arange(len(carrier.p)) == 0)
    return replace(carrier, free=free, aux={**carrier.aux, "_told": told})


def _owned(scene, owner: dict) -> dict:
    """Where an owner's effect stands in a scene: its side, and the number of its transmitter."""
    tx, _, rx = owner["name"].partition(">")
    return {"side": "tx" if tx in scene.transmitters and not rx else "rx"} | (
        {"source": scene.transmitters.index(tx)} if tx in scene.transmitters else {}
    )


def told_noise_db(case, observation) -> float | None:
    """The noise power that the twin tells of a recording, with the changes of the floor that it knows of."""
    told = case.noise_db.get(observation.receiver)
    if told is None:
        return None
    known = (e for e in twin_effects(case, observation) if FAMILIES[e["family"]].role is Role.FLOOR)
    return told + sum(plain(e["parameters"]["change_db"], observation.name) for e in known)
