# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of a world: a scene, its causes at measured strengths, the files and the truth."""

from pathlib import Path

import numpy as np

from ..told import truth
from . import files, numeric
from .scene import Context, baseline, concerned, energy_left, known_mask, simulate

# Of each group a case holds one at most: within it, two look alike at moderate strength.
GROUPS = (
    {"gain_step", "gain_drift", "power_supply_hum", "tap_fading"},
    {"phase_noise", "tap_fading", "tap_doppler"},
    {"noise_floor", "signal_dependent_noise", "quantization", "impulsive_noise", "pulsed_interference"},
    {"pa_nonlinearity", "adc_clipping"},
    {"dc_offset", "lo_leakage"},
    {"front_end_filter", "diffuse_tail", "tap_delay_error"},
    {"sample_clock_offset", "sample_loss"},
    {"missing_path", "tap_gain_error", "tap_delay_error", "tap_doppler", "tap_fading"},
    {"adc_clipping", "quantization"},
    {"carrier_frequency_offset", "spectral_inversion"},
    {"iq_imbalance", "spectral_inversion"},
    {"sample_loss", "gain_step"},
)
PEAK = 0.98


class Refused(Exception):
    """This draw does not make a fair case; another is drawn."""


def compatible(family, others, twice=False):
    if family in others:
        return twice
    return not any(family in g and g & set(others) for g in GROUPS)


def strength(scene, cause):
    return sum(energy_left(scene, r, cause) for r in scene.recordings)


def tune(scene, cause, target):
    """Sets the knob for λ near `target`, as far as its range goes; returns λ."""
    value = strength(scene, cause)
    if cause.fixed:
        return value
    power = 2.0
    for _ in range(9):
        if value > 0 and abs(np.log(value / target)) < 0.3:
            break
        before, was = cause.knob, value
        step = (target / max(value, target * 1e-8)) ** (1 / power)
        cause.knob = float(np.clip(cause.knob * np.clip(step, 1e-3, 1e3), cause.lo, cause.hi))
        if cause.knob == before:
            break
        value = strength(scene, cause)
        if value > 0 and was > 0 and abs(np.log(cause.knob / before)) > 1e-3:
            power = float(np.clip(np.log(value / was) / np.log(cause.knob / before), 0.7, 8.0))
    return value


def spread(rng, lo=0.75, hi=6.0):
    return 10 ** rng.uniform(lo, hi)


# ---------------------------------------------------------------- files
def twin_of(scene):
    nodes = {tx: {"transmit": w, "amplitude": a} for tx, (w, a) in scene.transmitters.items()}
    nodes |= {rx: {} for rx in scene.receivers}
    waves = {}
    for key, w in scene.waves.items():
        waves[key] = dict(w.entry) if w.entry else {"file": f"reference_{key}", "repeat": w.repeat}
    links = []
    for (tx, rx), taps in scene.links.items():
        link = {"tx": tx, "rx": rx, "taps": [dict(t) for t in taps]}
        if (tx, rx) in scene.link_unknown:
            link["unknown"] = scene.link_unknown[(tx, rx)]
        links.append(link)
    recordings = []
    for r in scene.recordings:
        entry = {"file": r.name, "receiver": r.receiver, "transmitters": list(r.transmitters)}
        if r.amplitude:
            entry["amplitude"] = dict(r.amplitude)
        recordings.append(entry)
    twin = {
        "cast_twin": 1,
        "sample_rate_hz": scene.rate,
        "center_frequency_hz": scene.carrier,
        "waveforms": waves,
        "nodes": nodes,
        "links": links,
        "recordings": recordings,
        "unknown": ["delay", "phase", "gain"],
        "effects": scene.twin_effects,
    }
    if scene.tell_noise:
        twin["noise"] = {rx: {"power_db": round(10 * np.log10(scene.noise[rx] * stored(scene, rx)), 4)} for rx in scene.receivers}
    return twin


def stored(scene, rx):
    """What the file's own steps add to the noise."""
    step = {"cf32_le": 0.0, "ci16_le": 1 / 32768, "ci8": 1 / 128, "cu8": 1 / 128}[scene.datatype]
    return 1 + step**2 / 6 / scene.noise[rx]


def write_case(scene, samples, folder):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for key, w in scene.waves.items():
        if w.entry:
            continue
        x = w.samples.astype("<c8")
        if w.known is not None:
            x = np.where(w.known, x, np.complex64(complex(np.nan, np.nan)))
        files.write(folder, f"reference_{key}", x, "cf32_le", scene.rate, scene.carrier)
    for name, y in samples.items():
        files.write(folder, name, y, scene.datatype, scene.rate, scene.carrier)
    files.write_twin(folder, twin_of(scene))


# ---------------------------------------------------------------- truth
def owners(cause, scene):
    tx, rx = next(iter(scene.links))
    link = f"{tx}>{rx}"
    if scene.network:
        return [cause.name]
    if cause.level == "environment":
        return ["environment", link]
    return [link] if cause.level == "link" else [tx, rx, link]


def effect(scene, cause, lam, beside=()):
    hit = [r for r in scene.recordings if concerned(cause, r)]
    contexts = [Context(scene, r) for r in hit]
    parameters, values, where = cause.truth(contexts)
    if cause.family == "carrier_frequency_offset":
        wander = [c.slope_hz(contexts[0]) for c in beside if c.family == "phase_noise"]
        parameters["offset_hz"]["also"] += [parameters["offset_hz"]["value"] + f for f in wander]
    if lam < 20:
        parameters = {k: {**p, "z": False} for k, p in parameters.items()}
    same = list(cause.same_as)
    if not scene.network and len(next(iter(scene.links.values()))) == 1:
        same += ["tap_doppler"] if cause.family == "carrier_frequency_offset" else []
        same += ["carrier_frequency_offset"] if cause.family == "tap_doppler" else []
    return {
        "family": cause.family,
        "form": cause.form,
        "owner": {"level": cause.level, "name": cause.name},
        "owners_ok": owners(cause, scene),
        "parameters": parameters,
        "values": values,
        "where": where,
        "recordings": [r.name for r in hit],
        "lambda": float(lam),
        "same_as": same + (["extra_path_at_tap"] if cause.family == "tap_doppler" else []),
    }


def recorded(scene, causes, present=True):
    """{name: samples}, and the entries of truth's `fit`."""
    out, fit = {}, []
    for r in scene.recordings:
        context = Context(scene, r)
        window, mask = context.window, known_mask(scene, r)
        base = baseline(scene, r)
        if present:
            y, clean = simulate(scene, r, causes), simulate(scene, r, causes, noise=False)
        else:
            gone = type(r)(**{**r.__dict__, "gain": r.gain * scene.present})
            y = simulate(scene, gone, causes)
            clean = simulate(scene, gone, causes, noise=False)
        y, clean = y[window], clean[window]
        peak = max(np.abs(y.real).max(), np.abs(y.imag).max())
        if peak > PEAK and not any(getattr(c, "rails", False) for c in causes):
            raise Refused(f"peak {peak:.2f}")
        y = files.decoded(files.encoded(y, scene.datatype).tobytes(), scene.datatype)
        out[r.name] = y
        if not mask.any():
            raise Refused("nothing known")
        power = np.mean(np.abs(y[mask]) ** 2)
        _, fitted, moved = numeric.refit(np.pad(y, (window.start, len(base) - window.stop)), base, window, mask)
        left = y[mask] - fitted
        entry = {
            "recording": r.name,
            "twin_nmse_db": 10 * np.log10(np.mean(np.abs(left) ** 2) / power),
            "noise_floor_db": 10 * np.log10(np.mean(np.abs(y - clean)[mask] ** 2) / power),
            "snr_db": 10 * np.log10(context.wanted / context.sigma2) if present else None,
            "delay_samples": r.delay,
            "gain": abs(r.gain),
            "phase_rad": np.angle(r.gain),
        }
        fit.append(entry)
    return out, fit


def conditions(scene):
    tx = next(iter(scene.transmitters))
    w = scene.wave(tx)
    return {
        "sample_rate_hz": scene.rate,
        "samples": scene.count,
        "taps": max(len(t) for t in scene.links.values()),
        "waveform": w.name,
        "samples_per_chip": max(1, int(round(w.samples_per_chip))),
        "duration_s": scene.duration,
        "period_samples": len(w.samples),
        "repeat": w.repeat,
        "datatype": scene.datatype,
        "carrier_hz": scene.carrier,
        "known_effects": [e["family"] for e in scene.twin_effects],
    }


def truth_of(scene, kind, effects, fit, *, verdicts, tolerated=(), ambiguous=None, **more):
    first = next(iter(scene.links.values()))
    told = {"network": scene.network, "tolerated": tolerated, "ambiguous": ambiguous}
    return files.plain(truth(kind, verdicts, effects, fit, first, conditions(scene), **told, **more))


# ---------------------------------------------------------------- drawing
def settle(scene, causes):
    """What the twin cannot say once a receiver's filter or gain also shapes the noise."""
    for c in causes:
        told = any(k.family == "noise_floor" for k in causes)
        if c.slot == "rx_filter" or (c.slot == "rx_gain" and c.knob > (0.02 if c.family == "power_supply_hum" else 0.2)):
            if told:
                raise Refused("the floor must be told")
            scene.tell_noise = False


def joined(causes):
    """Two joints act in the order of time, and apart from one another."""
    joints = sorted((c for c in causes if c.family == "sample_loss"), key=lambda c: c.place)
    if any(b.place - a.place < 2500 for a, b in zip(joints, joints[1:], strict=False)):
        raise Refused("joints too near")
    return [c for c in causes if c.family != "sample_loss"] + joints


def first_scene(world, rng, family, network=False):
    for _ in range(60):
        scene = world.network(rng) if network else world.scene(rng)
        cause = world.cause(rng, family, scene)
        if cause is not None:
            return scene, cause
    raise Refused(f"no scene for {family}")


def draw_causes(world, rng, kind, family):
    count = {"single": 1, "double": 2, "triple": 3}[kind]
    families = list(world.menu)
    scene, cause = first_scene(world, rng, family)
    if kind == "triple" and world.bundle is not None and rng.random() < 0.12:
        for _ in range(40):
            scene = world.scene(rng)
            causes = world.bundle(rng, scene)
            if causes:
                return scene, causes
    causes = [cause]
    for _ in range(200):
        if len(causes) == count:
            return scene, causes
        family = families[rng.integers(len(families))]
        twice = family in ("sample_loss", "extra_path", "tone_interference") and rng.random() < 0.3
        if compatible(family, [c.family for c in causes], twice):
            more = world.cause(rng, family, scene)
            if more is not None:
                causes.append(more)
    raise Refused("no company")


def explained(world, rng, kind, family):
    scene, causes = draw_causes(world, rng, kind, family)
    causes = joined(causes)
    lams = []
    for c in causes:
        lam = tune(scene, c, spread(rng))
        if lam < 4:
            raise Refused(f"{c.family}: λ {lam:.1f}")
        lams.append(lam)
    settle(scene, causes)
    if len(causes) == 1:
        world.after(rng, scene, causes[0])
    samples, fit = recorded(scene, causes)
    effects = [effect(scene, c, lam, causes) for c, lam in zip(causes, lams, strict=True)]
    return scene, samples, truth_of(scene, kind, effects, fit, verdicts=["identified"])


def null(world, rng):
    families = [f for f in world.menu if f not in ("sample_loss", "spectral_inversion", "missing_path", "quantization")]
    hidden = []
    if rng.random() < 0.5:
        scene, cause = first_scene(world, rng, families[rng.integers(len(families))])
        cause.fixed, cause.lo = False, 0.0
        cause.knob = cause.knob * 0.05
        target = 10 ** rng.uniform(-1.5, -0.2)
        for _ in range(4):
            lam = tune(scene, cause, target)
            if lam < 1:
                break
            target /= 4
        if not lam < 1:
            raise Refused("the imperfection shows")
        settle(scene, [cause])
        hidden = [(cause, lam)]
    else:
        scene = world.scene(rng)
    samples, fit = recorded(scene, [c for c, _ in hidden])
    note = [{"family": c.family, "form": c.form, "lambda": lam} for c, lam in hidden]
    return scene, samples, truth_of(scene, "null", [], fit, verdicts=["no_mismatch"], hidden=note)


def network(world, rng):
    families = list(world.network_families)
    scene, cause = first_scene(world, rng, families[rng.integers(len(families))], network=True)
    causes = [cause]
    if rng.random() < 0.45:
        for _ in range(60):
            family = families[rng.integers(len(families))]
            if compatible(family, [cause.family]):
                more = world.cause(rng, family, scene)
                if more is not None:
                    causes.append(more)
                    break
    lams = []
    for c in causes:
        lam = tune(scene, c, spread(rng, 1.8, 6.0))
        if lam < 20:
            raise Refused("too weak for an owner")
        lams.append(lam)
    settle(scene, causes)
    samples, fit = recorded(scene, causes)
    effects = [effect(scene, c, lam, causes) for c, lam in zip(causes, lams, strict=True)]
    return scene, samples, truth_of(scene, "network", effects, fit, verdicts=["identified"])


def outside(world, rng):
    form = world.outside[rng.integers(len(world.outside))]
    for _ in range(60):
        scene = world.scene(rng)
        made = form(rng, scene)
        if made is not None:
            break
    else:
        raise Refused("no scene")
    cause, tolerated = made
    lam = tune(scene, cause, spread(rng, 2.7, 5.7))
    if lam < 200:
        raise Refused("too weak")
    if cause.slot in ("rx_gain", "rx_filter"):
        scene.tell_noise = False
    samples, fit = recorded(scene, [cause])
    return (
        scene,
        samples,
        truth_of(scene, "outside", [effect(scene, cause, lam)], fit, verdicts=["unexplained"], tolerated=tolerated),
    )


def ambiguous(world, rng):
    form = world.ambiguous[rng.integers(len(world.ambiguous))]
    for _ in range(60):
        made = form(rng)
        if made is not None:
            break
    else:
        raise Refused("no scene")
    scene, cause, sets, record_next = made
    lam = tune(scene, cause, spread(rng, 2.3, 5.5))
    if lam < 100:
        raise Refused("too weak")
    samples, fit = recorded(scene, [cause])
    told = {"family_sets": sets, "record_next": record_next}
    effects = [effect(scene, cause, lam)]
    return (
        scene,
        samples,
        truth_of(scene, "ambiguous", effects, fit, verdicts=["ambiguous"], ambiguous=told, tolerated=[cause.family]),
    )


def absent(world, rng):
    form = world.absent[rng.integers(len(world.absent))]
    for _ in range(60):
        scene = world.scene(rng)
        made = form(rng, scene)
        if made is not None:
            break
    else:
        raise Refused("no scene")
    name, causes, tolerated = made
    if scene.present == 1.0:
        scene.present = 0.0
    samples, fit = recorded(scene, causes, present=False)
    entry = {
        "family": f"outside:absent_{name}",
        "form": name,
        "owner": {"level": "environment", "name": "environment"},
        "owners_ok": ["environment"],
        "parameters": {},
        "values": {},
        "where": {},
        "recordings": [r.name for r in scene.recordings],
        "lambda": 1e6,
        "same_as": [],
    }
    return scene, samples, truth_of(scene, "outside", [entry], fit, verdicts=["unexplained"], tolerated=tolerated, absent=True)


KINDS = {"null": null, "network": network, "outside": outside, "ambiguous": ambiguous, "absent": absent}


def draw(world, rng, kind, folder):
    """One case of this kind in `folder`; returns its truth."""
    families = list(world.menu)
    family = ""
    for attempt in range(80):
        if attempt % 20 == 0:  # one that is hard to draw is not given up at once
            family = families[rng.integers(len(families))]
        try:
            if kind in ("single", "double", "triple"):
                scene, samples, truth = explained(world, rng, kind, family)
            else:
                scene, samples, truth = KINDS[kind](world, rng)
        except Refused:
            continue
        write_case(scene, samples, folder)
        return truth
    raise RuntimeError(f"{world.name}: no {kind} case in 80 draws")
