# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene with its causes becomes a case: recordings, twin, truth."""

from dataclasses import dataclass

import numpy as np

from . import files, truth, world
from .scenes import Retry
from .tune import total_lambda


@dataclass(frozen=True, kw_only=True)
class Case:
    """All of one case: what is written for the diagnosis, and what is sealed."""

    twin: dict
    waveforms: dict
    recordings: dict
    datatype: str
    truth: dict
    scenes: tuple
    causes: tuple


def draw_datatype(rng, scene, names):
    """8-bit files only where their own step hides under the noise."""
    eight = np.sqrt(scene.context.noise / 2) * 128 > 1.5
    if eight and rng.random() < 0.5 and not {"quantization", "adc_clipping"} & set(names):
        return str(rng.choice(["ci8", "cu8"]))
    if "quantization" in names:
        return "cf32_le"
    return str(rng.choice(["cf32_le", "ci16_le"]))


def _step_noise(datatype):
    """Noise power of a file type's own step, which the twin declares too."""
    step = {"cf32_le": 0, "ci16_le": 1 / 32768, "ci8": 1 / 128, "cu8": 1 / 128}[datatype]
    return step**2 / 6


def _twin(scenes, causes, waveform_keys, datatype, declare_noise):
    first = scenes[0]
    nodes, links = {}, []
    for s in scenes:
        nodes.setdefault(s.transmitter, {"transmit": waveform_keys[s.transmitter], "amplitude": s.amplitude})
    for s in scenes:
        nodes.setdefault(s.receiver, {})
    seen = set()
    for s in scenes:
        if s.link not in seen:
            seen.add(s.link)
            links.append({"tx": s.transmitter, "rx": s.receiver, "taps": [dict(t) for t in world.twin_taps(s, causes)]})
    twin = {
        "sample_rate_hz": first.context.rate,
        "center_frequency_hz": first.context.carrier_hz,
        "nodes": nodes,
        "links": links,
        "recordings": [{"file": s.name, "receiver": s.receiver, "transmitters": [s.transmitter]} for s in scenes],
        "unknown": ["delay", "phase", "gain"],
    }
    twin["effects"] = []
    if first.context.offset_known_hz:
        twin["effects"] = [
            {
                "family": "carrier_frequency_offset",
                "owner": {"level": "rx", "name": first.receiver},
                "parameters": {
                    "offset_hz": {"value": first.context.offset_known_hz, "std": 0.0},
                    "drift_hz_per_s": {"value": 0.0, "std": 0.0},
                },
            }
        ]
    if declare_noise:
        twin["noise"] = {
            s.receiver: {"power_db": round(float(10 * np.log10(s.context.noise + _step_noise(datatype))), 3)} for s in scenes
        }
    return twin


def finish(
    rng,
    scenes,
    causes,
    *,
    kind,
    wave,
    extra=None,
    harmless=(),
    never=(),
    verdicts=None,
    ambiguous=None,
    tolerated=(),
    lam_outside=None,
    noise=None,
    hidden=(),
):
    """Plays, and writes down the truth. hidden: harmless causes that the truth does not list as effects."""
    names = [c.name for c in causes]
    datatype = draw_datatype(rng, min(scenes, key=lambda s: s.context.noise), names + [c.name for c in hidden])
    declare = noise if noise is not None else ("noise_floor" in names or bool(rng.random() < 0.7))
    recordings, fits = {}, []
    everything = [*causes, *hidden]
    for s in scenes:
        recorded = files.decoded(files.encoded(play_safely(s, everything), datatype), datatype)
        recordings[s.name] = recorded
        quiet = [c for c in everything if c.name != "quantization" and (c.family.stage != "air" or not c.family.stochastic)]
        fits.append(world.fit_of_twin(s, everything, recorded, world.play(s, quiet, noise=False)))
    effects = []
    network = kind == "network"
    for c in causes:
        mine = [s for s in scenes if world.touches(c, s)]
        lam, wanted = total_lambda(scenes, everything, c), world.wanted_power(mine[0], everything)
        effects.append(truth.effect(c, mine[0], mine, lam, network, wanted))
    if lam_outside is not None:
        effects = [lam_outside]
    context = scenes[0].context
    keys = {s.transmitter: w for s, w in zip(scenes, wave["keys"], strict=True)}
    twin = _twin(scenes, causes, keys, datatype, declare)
    record = {
        "kind": kind,
        "verdicts_ok": verdicts or ["identified"],
        "ambiguous": ambiguous,
        "tolerated": list(tolerated),
        "harmless": list(harmless),
        "never_claim": list(never),
        "case": "",
        "effects": effects,
        "fit": fits,
        "tap_delays_s": [t["delay_s"] for t in context.taps],
        "network": network,
        "conditions": {
            "sample_rate_hz": context.rate,
            "samples": context.count,
            "taps": len(context.taps),
            "waveform": context.waveform.name,
            "samples_per_chip": context.waveform.samples_per_chip,
            "duration_s": context.count / context.rate,
            "period_samples": len(context.waveform.samples),
        },
    }
    return Case(
        twin=twin,
        waveforms=wave["all"],
        recordings=recordings,
        datatype=datatype,
        truth=record,
        scenes=tuple(scenes),
        causes=tuple(everything),
    )


def play_safely(scene, causes):
    x = world.play(scene, causes)
    if max(np.max(np.abs(x.real)), np.max(np.abs(x.imag))) > 1:
        raise Retry("over full scale")
    return x
