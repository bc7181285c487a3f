# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of cases with a definite answer: causes, none, physics outside the list, networks."""

from dataclasses import replace

import numpy as np

from . import outside, truth, world
from .impairments import FAMILIES
from .record import finish
from .scenes import CARRIERS, RATES, Retry, draw_scene, draw_taps, draw_waveform, single_wave, with_second
from .tune import TAP_FAMILIES, compatible, draw_causes, draw_targets, owner_of, total_lambda, tune


def _twice(rng, scene):
    """The same link recorded twice: other noise, other bulk delay and phase."""
    c = scene.context
    bulk = c.bulk + float(rng.uniform(0, 300))
    later = replace(c, bulk=bulk, gain=c.gain * np.exp(1j * rng.uniform(-np.pi, np.pi)))
    return [
        replace(scene, name="recording_0"),
        replace(scene, name="recording_1", context=later, seed=int(rng.integers(1, 2**31 - 9))),
    ]


def single(rng, number, strong):
    """One link with 1–3 causes."""
    for _ in range(60):
        keys = [str(k) for k in rng.choice(list(FAMILIES), number, replace=False)]
        if not compatible(keys):
            continue
        special = TAP_FAMILIES & set(keys)
        scene = draw_scene(rng, snr_db=float(rng.uniform(14, 33)) if {"adc_clipping", "quantization"} & set(keys) else None)
        if special and len(scene.context.taps) < 3:
            continue
        scene, wave = with_second(rng, scene, "second_transmitter" in keys)
        scenes = [scene]
        if rng.random() < 0.15 and all(FAMILIES[k].level in ("tx", "link") and not FAMILIES[k].stochastic for k in keys):
            scenes = _twice(rng, scene)
            wave["keys"] *= 2
        causes = draw_causes(rng, scenes, keys, draw_targets(rng, number, strong))
        if causes is None:
            continue
        lams = [total_lambda(scenes, causes, c) for c in causes]
        if min(lams) < 2.5 or (strong and min(lams) < 100):
            continue
        return finish(rng, scenes, causes, kind={1: "single", 2: "double", 3: "triple"}[number], wave=wave)
    raise Retry("no draw fitted")


FAINT = (
    "carrier_frequency_offset gain_drift iq_imbalance:rx front_end_filter power_supply_hum phase_noise extra_path pa_nonlinearity"
).split()


def _invisible(rng, scene):
    """A cause that cannot be seen: real samples have no image, constant envelopes no compression."""
    waveform = scene.context.waveform
    blind = [("pa_nonlinearity", 0.08)] * waveform.constant_envelope + [("iq_imbalance:tx", 0.05)] * waveform.real
    faint = [(str(k), None) for k in rng.choice(FAINT, 2, replace=False) if FAMILIES[str(k)].fits(scene.context)]
    options = blind + faint
    if not options:
        raise Retry("nothing fits")
    key, strength = options[int(rng.integers(len(options)))]
    family = FAMILIES[key]
    draw = {**family.draw(rng, scene.context), "turns": 0.0}
    if strength:
        draw["memory"] = False
    cause = world.Cause(key=key, owner=owner_of(rng, family, scene), strength=strength or family.start, draw=draw)
    if strength is None:
        (cause,) = tune([scene], [cause], 0, float(rng.uniform(0.05, 0.6)))
    if total_lambda([scene], [cause], cause) > 1:
        raise Retry("not harmless")
    return cause, strength is not None


def null(rng):
    """Nothing wrong; half of them with imperfections that cannot be seen."""
    scene, wave = with_second(rng, draw_scene(rng))
    hidden, harmless, never = [], [], []
    if rng.random() < 0.5:
        cause, blind = _invisible(rng, scene)
        hidden, harmless = [cause], [{"family": cause.name, "strength": cause.strength}]
        never = [cause.name] if blind else []
    return finish(
        rng,
        [scene],
        [],
        kind="null",
        wave=wave,
        verdicts=["no_mismatch"],
        hidden=hidden,
        harmless=harmless,
        never=never,
    )


def beyond(rng):
    """Physics that no family of the contract holds."""
    name = str(rng.choice(list(outside.KINDS)))
    kind = outside.KINDS[name]
    scene = draw_scene(rng, kind=str(rng.choice(kind.waveforms)), offset_known=0.0, snr_db=float(rng.uniform(15, 30)))
    if kind.few_taps and len(scene.context.taps) > 2:
        raise Retry("too many taps")
    draw = kind.draw(rng, scene.context)
    target = float(np.exp(rng.uniform(np.log(1500), np.log(30_000))))
    size = kind.start

    def outer(part):
        return replace(scene, place=kind.place, after=lambda x, c: kind.act(x, part, draw, c))

    idle = world.play(scene if kind.fixed else outer(0.0), noise=False)  # its blocks' own delay is not λ
    for _ in range(9):
        left = world.residual(world.play(outer(size), noise=False), idle)
        lam = float(np.sum(np.abs(left) ** 2) / scene.context.noise)
        if kind.fixed or abs(np.log(max(lam, 1e-9) / target)) < 0.2:
            break
        size = float(np.clip(size * np.sqrt(target / max(lam, 1e-9)), 1e-6, kind.most))
    if lam < 800:
        raise Retry("too weak")
    owner = {
        "level": kind.level,
        "name": {"tx": "tx1", "rx": "rx1", "link": "tx1>rx1", "environment": "environment"}[kind.level],
    }
    effect = {
        "family": f"outside:{name}",
        "owner": owner,
        "owners_ok": truth.owners_ok(owner, False, "tx1", "rx1"),
        "parameters": {},
        "values": {},
        "where": kind.where(draw, scene.context),
        "recordings": ["recording"],
        "lambda": lam,
        "same_as": [],
    }
    return finish(
        rng,
        [outer(size)],
        [],
        kind="outside",
        wave=single_wave(scene),
        verdicts=["unexplained"],
        tolerated=kind.tolerated,
        lam_outside=effect,
    )


def network(rng, number, strong):
    """2–3 transmitters, 2–3 receivers, one recording per link; the owner must be told."""
    for _ in range(60):
        keys = [str(k) for k in rng.choice(list(FAMILIES), number, replace=False)]
        banned = {
            "second_transmitter",
            "quantization",
            "adc_clipping",
            "diffuse_tail",
            "pulsed_interference",
            "impulsive_noise",
            "tap_fading",
            "spectral_inversion",
            "signal_dependent_noise",
            "dc_offset",
            "lo_leakage",
            "narrowband_interference",
        }
        if not compatible(keys) or banned & set(keys):
            continue
        rate, carrier, count = (
            float(rng.choice(RATES)),
            float(rng.choice(CARRIERS)),
            int(rng.integers(20_000, 32_000)),
        )
        senders, hearers = int(rng.integers(2, 4)), int(rng.integers(2, 4))
        waves = {
            f"tx{i + 1}": draw_waveform(rng, str(rng.choice(["rrc_qpsk", "rrc", "zadoff_chu"], p=[0.6, 0.2, 0.2])))
            for i in range(senders)
        }
        levels = {t: float(rng.choice([1.0, 0.8, 0.5])) for t in waves}
        noise = {f"rx{j + 1}": None for j in range(hearers)}
        scenes, snr = [], float(rng.uniform(10, 22))
        for r in noise:
            for t, w in waves.items():
                s = draw_scene(
                    rng,
                    waveform=w,
                    rate=rate,
                    carrier=carrier,
                    count=count,
                    offset_known=0.0,
                    amplitude=levels[t],
                    snr_db=snr,
                    name=f"rec_{t}_{r}",
                    transmitter=t,
                    receiver=r,
                    taps=draw_taps(rng, w, rate, carrier, count, most=3, dopplers=False),
                )
                noise[r] = noise[r] or s.context.noise
                # one receiver, one noise floor: the level, not the noise, follows the wanted SNR
                scale = np.sqrt(noise[r] / s.context.noise * 10 ** (rng.uniform(0, 6) / 10))
                context = replace(
                    s.context,
                    gain=s.context.gain * scale,
                    power=s.context.power * scale**2,
                    rms_peak=s.context.rms_peak * scale,
                    noise=noise[r],
                )
                context = replace(context, snr_db=float(10 * np.log10(context.power / context.noise)))
                scenes.append(replace(s, context=context))
        if max(s.context.rms_peak for s in scenes) > 0.7:
            continue
        owners = []
        for key in keys:
            owners.append(owner_of(rng, FAMILIES[key], scenes[int(rng.integers(len(scenes)))]))
        causes = draw_causes(rng, scenes, keys, draw_targets(rng, number, strong), owners)
        if causes is None or min(total_lambda(scenes, causes, c) for c in causes) < (100 if strong else 3):
            continue
        wave = {
            "all": {f"w{i + 1}": w for i, w in enumerate(waves.values())},
            "keys": [f"w{list(waves).index(s.transmitter) + 1}" for s in scenes],
        }
        return finish(rng, scenes, causes, kind="network", wave=wave, noise=True)
    raise Retry("no draw fitted")
