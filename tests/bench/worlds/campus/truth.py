# SPDX-License-Identifier: GPL-3.0-or-later
"""What is told of a case, and its files."""

from dataclasses import dataclass, field

import numpy as np

from ..rig import files
from ..told import truth
from . import channel, strength
from .scene import db, power

STEPS = {"cf32_le": 0.0, "ci16_le": 1 / 32768, "ci8": 1 / 128}


def told(value, z=False, also=(), unsigned=False):
    """One parameter. z: a right observer's std covers it; also: other values that the contract's words allow."""
    return {"value": float(value), "z": bool(z), "also": [float(a) for a in also], "unsigned": bool(unsigned)}


@dataclass(kw_only=True)
class Found:
    """A cause as it acts (spec), as strong as it is, and as it is told."""

    spec: dict
    lam: float
    parameters: dict = field(default_factory=dict)
    values: dict = field(default_factory=dict)
    where: dict = field(default_factory=dict)
    same_as: list = field(default_factory=list)


def effect(family, level, found, recordings=("recording",), tx="tx1", rx="rx1", only=None):
    """only: the one right owner, in a network; one link alone cannot tell its ends apart."""
    level = found.spec.get("at", "rx") if level == "side" else level
    path = f"{tx}>{rx}"
    name = {"tx": tx, "rx": rx, "link": path, "environment": "environment"}[level]
    fair = {"link": [path], "environment": ["environment", path]}.get(level, [tx, rx, path])
    return {
        "family": family,
        "owner": {"level": level, "name": only or name},
        "owners_ok": [only] if only else fair,
        "parameters": found.parameters,
        "values": found.values,
        "where": found.where,
        "recordings": list(recordings),
        "lambda": float(found.lam),
        "same_as": list(found.same_as),
    }


def relevel(link, causes, founds):
    """Levels re the mean wanted power, where other causes change it; the level re the twin's stays allowed."""
    alone = {"dc_offset", *channel.OTHERS, "adc_clipping", "quantization", "second_transmitter", "sample_loss"}
    alone |= {"signal_dependent_noise", "noise_floor"}
    rest = {k: v for k, v in causes.items() if k not in alone}
    if not rest or not alone & set(causes):
        return
    change = db(link.wanted / power(channel.received(link, rest)))
    for family, found in founds.items():
        for name, way in (("level_dbc", 1), ("power_dbc", 1), ("slope_db", -1)):
            p = found.parameters.get(name)
            if p is not None and family != "lo_leakage":
                p["also"] = [*p["also"], p["value"], *(a + way * change for a in p["also"])]
                p["value"] += way * change


def datatype(rng, link, y, causes):
    """A file's format that takes the peaks, and whose steps are finer than the noise."""
    peak = max(np.max(np.abs(y.real)), np.max(np.abs(y.imag)))
    options = ["cf32_le"]
    if peak < 0.98 and link.noise > 3e-8 and not link.exact_file:
        options += ["ci16_le", "ci16_le"]
        if link.noise > 8e-4 and not {"quantization", "adc_clipping", "noise_floor"} & set(causes):
            options += ["ci8", "ci8"]
    return str(rng.choice(options))


def stored(y, kind):
    return files.decoded(files.encoded(y, kind).tobytes(), kind)


def fit(link, name, y, clean):
    """An entry of `fit`; y as the file holds it, clean: the same without noise."""
    mask, p = link.mask, power(y[link.mask])
    left = strength.refitted(link, y - link.y)
    return {
        "recording": name,
        "twin_nmse_db": db(power(left) / p),
        "noise_floor_db": db(power((y - clean)[mask]) / p),
        "snr_db": db(link.wanted / link.noise),
        "delay_samples": link.delay,
        "gain": float(abs(link.gain)),
        "phase_rad": float(np.angle(link.gain)),
    }


def conditions(links):
    first = links[0]
    return {
        "sample_rate_hz": first.rate,
        "samples": min(link.n for link in links),
        "taps": max(len(link.taps) for link in links),
        "waveform": first.traits["name"],
        "samples_per_chip": max(1, int(first.traits["spc"])),
        "duration_s": first.duration,
        "period_samples": len(first.x),
        "repeat": bool(first.repeat),
        "carrier_hz": first.carrier,
    }


def noise_db(link, kind):
    """The twin's noise: the radio's and the rounding of the file."""
    return round(db(link.noise + STEPS[kind] ** 2 / 6), 4)


def write(folder, links, samples, kind):
    """links: {(tx, rx): link}; samples: {name of a recording: samples}, in the same order."""
    folder.mkdir(parents=True, exist_ok=True)
    first = next(iter(links.values()))
    waves, nodes, noise = {}, {}, {}
    for (tx, _), link in links.items():
        if tx in nodes:
            continue
        key = f"w{len(waves) + 1}"
        nodes[tx] = {"transmit": key, "amplitude": link.amplitude}
        waves[key] = entry(folder, f"reference_{key}", link, link.x, link.traits, link.repeat)
    if first.second is not None:
        waves["w9"] = entry(folder, "reference_w9", first, *first.second, True)
    for (_, rx), link in links.items():
        nodes.setdefault(rx, {})
        noise[rx] = {"power_db": noise_db(link, kind)}
    for name, y in samples.items():
        files.write(folder, name, y, kind, first.rate, first.carrier)
    parts = zip(links, samples, strict=True)
    twin = {
        "cast_twin": 1,
        "sample_rate_hz": first.rate,
        "center_frequency_hz": first.carrier,
        "waveforms": waves,
        "nodes": nodes,
        "links": [{"tx": tx, "rx": rx, "taps": link.taps} for (tx, rx), link in links.items()],
        "recordings": [{"file": name, "receiver": rx, "transmitters": [tx]} for (tx, rx), name in parts],
        "unknown": first.unknown,
        "effects": [],
    }
    if first.tells_noise:
        twin["noise"] = noise
    if first.offset_hz:
        p = {"offset_hz": {"value": first.offset_hz, "std": 0.0}, "drift_hz_per_s": {"value": 0.0, "std": 0.0}}
        owner = {"level": "rx", "name": "rx1"}
        twin["effects"] = [{"family": "carrier_frequency_offset", "owner": owner, "parameters": p}]
    files.write_twin(folder, twin)


def entry(folder, stem, link, x, traits, repeat):
    if "code" in traits:
        return traits["code"]
    if "known" in traits:
        x = np.where(traits["known"], x, complex(np.nan, np.nan))
    files.write(folder, stem, x, "cf32_le", link.rate, link.carrier)
    return {"file": stem, "repeat": bool(repeat)}


def of(kind, links, effects, fits, verdict, **more):
    """The truth of a case."""
    network = kind == "network"
    return files.plain(truth(kind, [verdict], effects, fits, links[0].taps, conditions(links), network=network, **more))
