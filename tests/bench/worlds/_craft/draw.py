# SPDX-License-Identifier: GPL-3.0-or-later
"""One case: its scene and causes are drawn, sized, recorded and written; its truth is stated.

A world (world.py) gives `scene(rng, needs)`, `network(rng)` (scenes of all links), `menu` {family: forms}, `strangers` (names
of foreign.KINDS) and `unlike(rng, wave)` (another waveform of the same standard, which shares nothing with it).
"""

from pathlib import Path

import numpy as np

from ..told import truth
from . import files
from .causes import FAMILIES, in_order
from .chain import Prediction, received
from .foreign import KINDS

PAIRS = ("direct_current", "floor", "mirror", "image", "short_tail", "slow_hum", "same_code")

# Of each group a case has at most one: together they would explain one another.
APART = [
    {"dc_offset", "lo_leakage", "spectral_inversion"},
    {
        "noise_floor",
        "signal_dependent_noise",
        "impulsive_noise",
        "pulsed_interference",
        "narrowband_interference",
        "quantization",
    },
    {"front_end_filter", "diffuse_tail", "tap_delay_error"},
    {"extra_path", "diffuse_tail", "second_transmitter"},
    {"missing_path", "tap_gain_error", "tap_delay_error", "tap_doppler", "tap_fading"},
    {"gain_drift", "power_supply_hum", "tap_fading"},
    {"gain_drift", "gain_step", "tap_fading"},
    {"carrier_frequency_offset", "spectral_inversion", "tone_interference", "tap_doppler", "dc_offset"},
    {"carrier_frequency_offset", "narrowband_interference"},
    {"spectral_inversion", "tone_interference", "iq_imbalance"},
    {"spectral_inversion", "narrowband_interference"},
    {"spectral_inversion", "pulsed_interference"},
    {"phase_noise", "tap_fading"},
    {"phase_noise", "carrier_frequency_offset"},
    {"adc_clipping", "pa_nonlinearity", "quantization"},
    {"adc_clipping", "tap_fading"},
]


# What one recording of each link cannot tell apart, and what a network shows as well as a link does.
NEVER = {"second_transmitter", "lo_leakage", "dc_offset", "tap_fading", "spectral_inversion", "impulsive_noise"}
SELDOM = {
    "sample_loss",
    "diffuse_tail",
    "missing_path",
    "tap_gain_error",
    "tap_delay_error",
    "tap_doppler",
    "gain_step",
    "gain_drift",
    "phase_noise",
    "adc_clipping",
    "quantization",
    "pulsed_interference",
}


class Unfit(Exception):
    """These causes do not show in this scene; another is drawn."""


def wants(*causes):
    """The needs of several families at once."""
    out = {}
    for c in causes:
        for k, v in c.needs.items():
            if k == "taps":
                out[k] = max(v, out.get(k, 1))
            elif out.setdefault(k, v) != v:
                raise Unfit(k)
    return out


def nats(cause, scene, prediction):
    """Energy of the residual that this cause alone leaves, over the noise; for noise, its information."""
    own = cause.nats(scene)
    if own is not None:
        return float(own)
    alone = cause.clipped_away(scene) if cause.stage == "clip" else received(scene, in_order([*scene.known, cause]))
    left = prediction.left(alone)
    return float(np.sum(np.abs(left) ** 2) / scene.noise)


def total_nats(cause, scenes, predictions):
    return sum(nats(cause, s, p) for s, p in zip(scenes, predictions, strict=True) if shows(cause, s))


def sized(cause, scenes, predictions, target):
    """The cause at the strength at which it shows about so much; (cause, what it shows)."""
    cause = cause.sized(np.clip(cause.size, cause.low, cause.high))
    shown = total_nats(cause, scenes, predictions)
    for _ in range(6):
        if cause.low == cause.high or target / 1.3 < shown < target * 1.3:
            break
        change = np.clip(np.sqrt(target / max(shown, 1e-9)), 0.03, 30)
        size = float(np.clip(cause.size * change, cause.low, cause.high))
        if abs(size / cause.size - 1) < 1e-3:
            break
        cause = cause.sized(size)
        shown = total_nats(cause, scenes, predictions)
    return cause, shown


def target(rng):
    return 10 ** rng.uniform(np.log10(5), 6)


# ---------------------------------------------------------------- truths
def owners_ok(cause, scene, network):
    owner = owner_of(cause, scene)
    link = f"{scene.tx}>{scene.rx}"
    if network:
        return [owner["name"]]
    return {"environment": ["environment", link], "link": [link]}.get(cause.level, [scene.tx, scene.rx, link])


def owner_of(cause, scene):
    default = {"tx": scene.tx, "rx": scene.rx, "link": f"{scene.tx}>{scene.rx}", "environment": "environment"}[cause.level]
    return {"level": cause.level, "name": cause.name or default}


def shows(cause, scene):
    return (
        cause.level == "environment"
        or owner_of(cause, scene)["name"] == {"tx": scene.tx, "rx": scene.rx, "link": f"{scene.tx}>{scene.rx}"}[cause.level]
    )


def wanted_power(scene, causes):
    """Mean power of the wanted signal in the recording: what remains with noise and interference silenced."""
    quiet = [c for c in causes if not c.additive and not (c.noisy and c.stage == "air") and c.stage not in ("clip", "steps")]
    return float(np.mean(np.abs(received(scene, in_order([*scene.known, *quiet]))) ** 2))


def effect(cause, scenes, causes, shown, network):
    mine = [s for s in scenes if shows(cause, s)]
    scene = mine[0]
    parameters, values, where = cause.truth(scene, wanted_power(scene, causes))
    if network:
        per = ("power_dbc", "level_dbc", "power_db", "slope_db", "rms_rad", "level", "step", "time_s", "total_db")
        parameters = {k: {**p, "z": p["z"] and k not in per} for k, p in parameters.items()}
    if shown < 20:
        parameters = {k: {**p, "z": False} for k, p in parameters.items()}
    same = list(cause.same_as)
    if cause.family == "carrier_frequency_offset" and not network and len(scene.taps) == 1:
        same.append("tap_doppler")
    return {
        "family": cause.family,
        "owner": owner_of(cause, scene),
        "owners_ok": owners_ok(cause, scene, network),
        "parameters": parameters,
        "values": values,
        "where": {k: [float(x) for x in v] for k, v in where.items()},
        "recordings": [s.stem for s in mine],
        "lambda": float(shown),
        "same_as": same,
    }


def truth_of(kind, folder, scenes, effects, fits, **more):
    scene = scenes[0]
    verdict = {"null": "no_mismatch", "ambiguous": "ambiguous", "outside": "unexplained"}.get(kind, "identified")
    conditions = {
        "sample_rate_hz": scene.rate_hz,
        "samples": scene.n,
        "taps": len(scene.taps),
        "waveform": scene.wave.name,
        "samples_per_chip": scene.wave.samples_per_chip,
        "duration_s": scene.duration_s,
        "period_samples": scene.wave.period,
    }
    told = {"network": kind == "network", "case": Path(folder).name}
    return truth(kind, [verdict], effects, fits, scene.taps, conditions, **told, **more)


# ---------------------------------------------------------------- recording and files
def record(scene, causes, rng, predicted):
    """-> (samples as the file holds them, entry of truth's `fit`)."""
    mine = in_order([*scene.known, *[c for c in causes if shows(c, scene)]])
    noisy = received(scene, mine, rng)
    held = files.through(noisy, scene.datatype)
    clean = received(scene, mine)
    power = np.mean(np.abs(held) ** 2)
    left = predicted.left(held)
    return held, {
        "recording": scene.stem,
        "twin_nmse_db": float(10 * np.log10(np.mean(np.abs(left) ** 2) / power)),
        "noise_floor_db": float(10 * np.log10(np.mean(np.abs(held - clean) ** 2) / power)),
        "snr_db": float(10 * np.log10(np.mean(np.abs(clean) ** 2) / scene.noise)),
        "delay_samples": float(scene.delay % scene.wave.period if scene.wave.repeat else scene.delay),
        "gain": float(abs(scene.gain)),
        "phase_rad": float(np.angle(scene.gain)),
    }


def fits_file(scene, causes):
    """The converter must not clip by itself: a file type that would is replaced."""
    if scene.datatype == "cf32_le":
        return
    if any(c.stage in ("clip", "steps") for c in causes) and files.STEP[scene.datatype] > 1e-3:
        scene.datatype = "ci16_le"  # rails and steps that the file's own would blur
    peak = np.max(np.abs(received(scene, in_order([*scene.known, *causes])))) + 4.5 * np.sqrt(scene.noise)
    if peak > 0.99 or scene.noise < 1.3 * files.STEP[scene.datatype] ** 2:
        scene.datatype = "cf32_le" if peak > 0.99 else "ci16_le"


def stated_noise(scene, causes):
    """The recording's mean noise, as a twin states it: a receiver's gain scales it too."""
    gains = [c for c in causes if c.stage in ("gain", "foreign_gain") and c.level == "rx" and shows(c, scene)]
    factor = np.ones(len(scene.grid), complex)
    for c in gains:
        factor = factor * c.factor(scene.grid / scene.rate_hz, scene)
    return scene.white * float(np.mean(np.abs(factor) ** 2)) + scene.noise - scene.white


def entry(cause, scene, rng=None):
    """A cause as the twin lists it: fixed, or, with rng, only known within a std."""
    parameters, _, _ = cause.truth(scene, 1.0)
    out = {}
    for k, p in parameters.items():
        std = 0.0
        value = p["value"]
        if rng is not None and k in ("offset_hz", "offset_ppm", "step_db", "total_db", "error_db", "gain_db"):
            std = {"offset_hz": 0.05 / scene.duration_s, "offset_ppm": 0.02e6 / scene.n}.get(k, 0.05)
            value += 0.5 * std * rng.standard_normal()
        out[k] = {"value": float(value), "std": float(std)}
    return {"family": cause.family, "owner": owner_of(cause, scene), "parameters": out}


def write(folder, scenes, held, causes, listed):
    """twin.yaml, references and recordings."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    first = scenes[0]
    waves = {}
    for s in scenes:
        waves.setdefault(s.tx, s.wave)
    waveforms, nodes, links, noise = {}, {}, [], {}
    for k, (tx, wave) in enumerate(waves.items(), 1):
        stem = "reference" if k == 1 else f"reference{k}"
        files.write_sigmf(folder, stem, wave.samples, "cf32_le", first.rate_hz, first.carrier_hz)
        waveforms[f"w{k}"] = {"file": stem, "repeat": wave.repeat}
        nodes[tx] = {"transmit": f"w{k}", "amplitude": float(next(s.amplitude for s in scenes if s.tx == tx))}
    if first.second is not None:
        files.write_sigmf(folder, "silent", first.second.samples, "cf32_le", first.rate_hz, first.carrier_hz)
        waveforms["w9"] = {"file": "silent", "repeat": first.second.repeat}
    for s in scenes:
        nodes.setdefault(s.rx, {})
        links.append({"tx": s.tx, "rx": s.rx, "taps": s.taps})
        noise[s.rx] = {"power_db": round(float(10 * np.log10(stated_noise(s, causes))), 3)}
    recordings = []
    for s, y in zip(scenes, held, strict=True):
        files.write_sigmf(folder, s.stem, y, s.datatype, s.rate_hz, s.carrier_hz)
        recordings.append({"file": s.stem, "receiver": s.rx, "transmitters": [s.tx]})
    twin = {
        "cast_twin": 1,
        "sample_rate_hz": first.rate_hz,
        "center_frequency_hz": first.carrier_hz,
        "waveforms": waveforms,
        "nodes": nodes,
        "links": links,
        "recordings": recordings,
        "unknown": ["delay", "phase", "gain"],
        "effects": listed,
    }
    if first.states_noise:
        twin["noise"] = noise
    (folder / "twin.yaml").write_text(files.twin_text(twin))


def finish(folder, rng, kind, scenes, causes, shown, predictions, listed=None, **more):
    for s in scenes:
        fits_file(s, [c for c in causes if shows(c, s)])
    listed = [entry(c, scenes[0]) for c in scenes[0].known] if listed is None else listed
    recorded = [record(s, causes, rng, p) for s, p in zip(scenes, predictions, strict=True)]
    write(folder, scenes, [y for y, _ in recorded], causes, listed)
    network = kind == "network"
    effects = [effect(c, scenes, causes, x, network) for c, x in zip(causes, shown, strict=True)] if kind != "null" else []
    return truth_of(kind, folder, scenes, effects, [f for _, f in recorded], **more)


# ---------------------------------------------------------------- kinds
def make(world, rng, family, scene, level=None, name=None, form=None):
    form = form or str(rng.choice(world.menu[family]))
    cause = FAMILIES[family](rng, scene, form, level, name)
    if family == "diffuse_tail":
        cause.decays = world.decays
        cause.draw(rng, scene)
    return cause


def apart(families):
    return all(len(g & set(families)) <= 1 for g in APART) and len(set(families)) == len(families)


def families_of(world, rng, count):
    names = sorted(world.menu)
    while True:
        got = [str(x) for x in rng.choice(names, count, replace=False)]
        if apart(got):
            return got


def check(causes, shown, least=5.0):
    if min(shown) < least or not np.all(np.isfinite(shown)):
        raise Unfit("hidden")


def several(world, rng, folder, kind, plan, families=None):
    count = {"single": 1, "double": 2, "triple": 3}[kind]
    special = plan.uniform() < 0.12 * (count > 1)
    form = str(plan.choice(["joints", "oscillator", "one_tap"])) if special and not families else None
    families = families or families_of(world, plan, count)
    if form == "joints":
        families = ["sample_loss"] * count
    elif form == "oscillator":
        families = ["carrier_frequency_offset", "sample_clock_offset", "power_supply_hum"][:count]
    elif form == "one_tap":
        families = ["tap_fading", "tap_delay_error", "tap_doppler"][:count]
    needs = wants(*[FAMILIES[f] for f in families])
    if form == "oscillator":
        needs["offset"] = False
    scene = world.scene(rng, needs)
    predicted = Prediction(scene)
    causes, shown = [], []
    for f in families:
        c = make(world, rng, f, scene, form="both" if form == "oscillator" and f.startswith("carrier") else None)
        if form == "one_tap" and causes:
            c.tap, c.delay_s = causes[0].tap, causes[0].delay_s
        if form == "oscillator" and f == "sample_clock_offset":
            same_crystal(c, causes[0], scene)
        c, x = sized(c, [scene], [predicted], target(rng))
        causes.append(c)
        shown.append(x)
    if form == "joints":
        joints = sorted(c.joint for c in causes)
        if min(np.diff(joints)) < 40:
            raise Unfit("joints too near")
    check(causes, shown)
    return finish(folder, rng, kind, [scene], causes, shown, [predicted])


def null(world, rng, folder, kind, plan, families=None):
    how = str(plan.choice(["plain", "plain", "faint", "faint", "faint", "listed", "refined"]))
    scene = world.scene(rng, {})
    predicted = Prediction(scene)
    causes, shown, listed = [], [], None
    if how == "faint":  # imperfections far below what can be seen
        count = int(rng.integers(1, 4))
        sharp = ("second_transmitter", "quantization", "adc_clipping")  # a lattice shows whatever its energy
        names = [
            f
            for f in families_of(world, rng, count)
            if f not in sharp
            and FAMILIES[f].low < FAMILIES[f].high
            and (scene.offset_hz or not FAMILIES[f].needs.get("offset"))
            and FAMILIES[f].needs.get("taps", 1) <= len(scene.taps)
        ]
        for f in names:
            c = make(world, rng, f, scene, form=None if f != "carrier_frequency_offset" else "still")
            c.low = 1e-9
            c, x = sized(c, [scene], [predicted], 10 ** rng.uniform(-1.5, -0.3))
            if 0.01 < x < 1:  # what cannot be brought to its strength shows in the noise, may be
                causes.append(c)
                shown.append(x)
    elif how in ("listed", "refined"):
        options = ["carrier_frequency_offset", "sample_clock_offset", "gain_step", "extra_path", "sample_loss"]
        if len(scene.taps) > 2:
            options += ["tap_gain_error", "tap_delay_error", "missing_path"]
        family = str(rng.choice(options if how == "listed" else options[:4]))
        if family == "carrier_frequency_offset" and scene.known:
            family = "sample_clock_offset"
        c = make(world, rng, family, scene)
        c, x = sized(c, [scene], [predicted], 10 ** rng.uniform(2, 4.5))
        if c.family == "carrier_frequency_offset" and c.level == "tx":
            c.level = "rx"
        scene.known = in_order([*scene.known, c])
        scene.sheets.pop("rms", None)
        predicted = Prediction(scene)
        listed = [entry(k, scene, rng if how == "refined" and k is c else None) for k in scene.known]
    return finish(folder, rng, kind, [scene], causes, shown, [predicted], listed)


def network(world, rng, folder, kind, plan, families=None):
    count = int(plan.integers(1, 3))
    names = families or families_of(world, plan, count)
    together = plan.uniform() < 0.2 and not families
    rare = [plan.uniform() < 0.8 for _ in names]
    if not families and not together and any(f in NEVER or f in SELDOM and x for f, x in zip(names, rare, strict=True)):
        raise Unfit("not in a network")
    if together:  # one oscillator: its node's carrier and clock
        names = ["carrier_frequency_offset", "sample_clock_offset"][:count]
    scenes = world.network(rng)
    drawn = []
    for f in names:
        drawn.append(owned(world, rng, f, scenes, "both" if together else None, drawn[0] if together and drawn else None))
    predictions = [Prediction(s) for s in scenes]
    causes, shown = [], []
    for c in drawn:
        if together and causes:
            same_crystal(c, causes[0], scenes[0])
        c, x = sized(c, scenes, predictions, max(100.0, target(rng)))
        if x < 20:
            raise Unfit("hidden")
        causes.append(c)
        shown.append(x)
    return finish(folder, rng, kind, scenes, causes, shown, predictions)


def same_crystal(clock, carrier, scene):
    """Carrier and clock are off by one share."""
    ppm = carrier.offset_hz / scene.carrier_hz * 1e6
    if abs(ppm) > 250:
        raise Unfit("no crystal")
    clock.level, clock.name, clock.sign, clock.low, clock.high = carrier.level, carrier.name, np.sign(ppm), abs(ppm), abs(ppm)


def owned(world, rng, family, scenes, form, beside):
    """A cause of one node, link or the air of a network; beside: a cause whose node it shares."""
    cls = FAMILIES[family]
    level = beside.level if beside else str(rng.choice(cls.levels))
    name, options = beside.name if beside else None, scenes
    if name is None and level in ("tx", "rx"):
        name = str(rng.choice(sorted({getattr(s, level) for s in scenes})))
    elif level == "link":
        options = [s for s in scenes if len(s.taps) >= cls.needs.get("taps", 1)]
        if not options:
            raise Unfit("taps")
        s = options[int(rng.integers(len(options)))]
        name = f"{s.tx}>{s.rx}"
    key = {"tx": lambda s: s.tx, "rx": lambda s: s.rx, "link": lambda s: f"{s.tx}>{s.rx}"}.get(level)
    options = [s for s in scenes if key is None or key(s) == name]
    wave = options[0].wave
    if cls.needs.get("complex") and wave.real or cls.needs.get("envelope") and wave.flat:
        raise Unfit("waveform")
    form = (
        form
        if family == "carrier_frequency_offset" and form
        else str(rng.choice([x for x in world.menu[family] if x not in ("far", "coarse")]))
    )
    return make(world, rng, family, max(options, key=lambda s: max(t["delay_s"] for t in s.taps)), level, name, form)


def outside(world, rng, folder, kind, plan, families=None):
    cls = KINDS[families[0] if families else str(plan.choice(world.strangers))]
    scene = world.scene(rng, wants(cls))
    if cls.family == "outside:clock_wander" and scene.known:
        raise Unfit("clock")
    predicted = Prediction(scene)
    cause = cls(rng, scene, "only")
    cause, shown = sized(cause, [scene], [predicted], 10 ** rng.uniform(2.7, 5.5))
    check([cause], [shown], 300.0)
    return finish(folder, rng, kind, [scene], [cause], [shown], [predicted], tolerated=list(cls.tolerated))


def ambiguous(world, rng, folder, kind, plan, families=None):
    pair = families[0] if families else str(plan.choice(PAIRS))
    level = 10 ** rng.uniform(2.3, 4.5)
    flat = {"offset": False, "known": False}
    if pair == "direct_current":
        family, form = (("dc_offset", "steady"), ("lo_leakage", "steady"))[int(rng.integers(2))]
        scene = world.scene(rng, flat)
        sets, then = [["dc_offset", "lo_leakage"]], ["offset_carrier", "mute_transmitter", "second_link", "move_carrier"]
    elif pair == "floor":
        family, form = "noise_floor", "up"
        scene = world.scene(rng, {**flat, "flat": True, "states_noise": True, "taps_most": 1, "repeat": True})
        sets = [["noise_floor", "signal_dependent_noise"]]
        then = ["second_power", "mute_transmitter", "shaped_waveform", "second_rx_gain"]
    elif pair == "mirror":
        family, form = "spectral_inversion", "mirrored"
        scene = world.scene(rng, {**flat, "real": True, "taps": 2, "taps_most": 2})
        sets, then = [["spectral_inversion", "tap_gain_error"]], ["complex_waveform", "offset_carrier"]
    elif pair == "image":
        family, form = "iq_imbalance", "mixed"
        scene = world.scene(rng, {**flat, "real": True, "taps": 2, "taps_most": 2})
        sets, then = [["iq_imbalance", "tap_gain_error"]], ["complex_waveform", "offset_carrier"]
    elif pair == "short_tail":
        family, form = "diffuse_tail", "gaussian"
        scene = world.scene(rng, flat)
        sets, then = [["diffuse_tail", "front_end_filter"]], ["second_link", "move_carrier"]
    elif pair == "slow_hum":
        family, form = "power_supply_hum", "pure"
        scene = world.scene(rng, flat)
        sets, then = [["power_supply_hum", "gain_drift"]], ["longer_recording"]
    else:
        family, form = "second_transmitter", "listed"
        scene = world.scene(rng, {**flat, "same_code": True})
        sets, then = [["extra_path", "second_transmitter"]], ["mute_transmitter", "second_link", "other_code_length"]
    predicted = Prediction(scene)
    cause = FAMILIES[family](rng, scene, form, "rx" if pair in ("image", "slow_hum", "mirror") else None)
    if pair == "short_tail":
        cause.decays = (0.8, 0.8)
        cause.draw(rng, scene)
        cause.decay = rng.uniform(0.6, 1.2)
        cause.first = 0.5
    elif pair == "slow_hum":  # under a twelfth of a cycle, near the zero crossing: a line
        cause.frequency = rng.uniform(0.02, 0.06) / scene.duration_s
        middle = rng.choice([-1, 1]) * np.pi / 2 + rng.uniform(-0.05, 0.05)
        cause.phase = np.array([middle - np.pi * cause.frequency * scene.duration_s, 0, 0])
        cause.high = 0.8
        snr = scene.rms() ** 2 / scene.noise
        level = min(level, np.sqrt(scene.n * snr))  # a line in amplitude and one in dB do not differ visibly
    elif pair == "image" or pair == "mirror":
        turn = scene.taps[1]["phase_rad"] - scene.taps[0]["phase_rad"]
        if abs(np.sin(turn)) < 0.3:
            raise Unfit("one phase")
    elif pair == "same_code":  # an echo of its own, far enough from the twin's paths
        last = max(t["delay_s"] for t in scene.taps) * scene.rate_hz
        cause.delay = float((last + rng.uniform(8, 60) - scene.second.extra["roll"]) % scene.wave.period)
    cause, shown = sized(cause, [scene], [predicted], level)
    check([cause], [shown], 100.0)
    out = finish(folder, rng, kind, [scene], [cause], [shown], [predicted])
    out["ambiguous"] = {"family_sets": sets, "record_next": then}
    return out


def absent(world, rng, folder, kind, plan, families=None):
    """The waveform is not in the recording: noise, another waveform, a blocker, or a signal far below detection."""
    how = families[0] if families else str(plan.choice(["noise", "other", "other", "faint", "blocker", "blocker"]))
    scene = world.scene(rng, {"unique": True, "known": False})
    tolerated, there = [], []
    if how == "blocker":
        family = str(rng.choice(["tone_interference", "narrowband_interference", "pulsed_interference"]))
        cause = make(world, rng, family, scene)
        c = cause.sized(10 ** rng.uniform(-0.3, 0.5))
        there, tolerated = [c], [family]
    level = scene.rms()
    heard = scene.gain
    scene.sheets["rms"] = level  # blockers stay at their level though the signal goes
    predicted = Prediction(scene)
    kept = None
    if how == "other":
        kept, scene.wave = scene.wave, world.unlike(rng, scene.wave)
    elif how == "faint":
        scene.gain = heard * np.sqrt(0.2 * scene.noise / (level**2 * scene.n))
    else:
        scene.gain = 0.0
    fits_file(scene, there)
    y = files.through(received(scene, in_order(there), rng), scene.datatype)
    if kept is not None:
        scene.wave = kept
    scene.gain = heard
    peak = highest(scene, y)
    if peak > 30 and how != "blocker":
        raise Unfit("something of the waveform is there")
    write(folder, [scene], [y], [], [])
    share = np.mean(np.abs(predicted.left(y)) ** 2) / np.mean(np.abs(y) ** 2)
    fit = {
        "recording": scene.stem,
        "twin_nmse_db": float(10 * np.log10(share)),
        "noise_floor_db": 0.0,
        "snr_db": -99.0,
        "delay_samples": 0.0,
        "gain": 0.0,
        "phase_rad": 0.0,
    }
    effects = [
        {
            "family": f"outside:absent_{how}",
            "owner": {"level": "environment", "name": "environment"},
            "owners_ok": ["environment", f"{scene.tx}>{scene.rx}"],
            "parameters": {},
            "values": {},
            "where": {},
            "recordings": [scene.stem],
            "lambda": float(np.mean(np.abs(y) ** 2) / scene.noise * scene.n),
            "same_as": [],
        }
    ]
    return truth_of("outside", folder, [scene], effects, [fit], tolerated=tolerated, absent=True)


def highest(scene, y):
    """The largest correlation of the waveform with the recording over all delays, in units of its mean."""
    x = np.asarray(scene.wave.samples)
    if scene.wave.repeat:
        n = scene.wave.period
        whole = y[: len(y) // n * n].reshape(-1, n).sum(0)
        c = np.abs(np.fft.ifft(np.fft.fft(whole) * np.fft.fft(x).conj())) ** 2
    else:
        n = len(x) + len(y)
        c = np.abs(np.fft.ifft(np.fft.fft(y, n) * np.fft.fft(x, n).conj())) ** 2
    return float(np.max(c) / np.mean(c))


KIND = {
    "null": null,
    "single": several,
    "double": several,
    "triple": several,
    "network": network,
    "outside": outside,
    "ambiguous": ambiguous,
    "absent": absent,
}


def case(world, rng, kind, folder, families=None):
    """Writes a case into the folder; its truth. families: those that it is to hold (or the pair, stranger or absence)."""
    if kind not in KIND:
        raise ValueError(f"kind: got {kind!r}, expected one of {sorted(KIND)}")
    for _ in range(25):
        seed = int(rng.integers(2**62))  # what the case is about; kept until a scene shows it
        for _ in range(30):
            try:
                return KIND[kind](world, rng, folder, kind, np.random.default_rng(seed), families)
            except Unfit:
                continue
    raise RuntimeError(f"{world.name}: no {kind} case found in 750 tries")
