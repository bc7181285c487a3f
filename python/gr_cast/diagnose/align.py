# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring twin and recording together: whole-sample delay, gain and orientation, whatever the carrier offset;
build the scene."""

from dataclasses import replace

import numpy as np
from scipy import fft as sp_fft

from ..effects import FAMILIES
from ..effects.base import start
from ..effects.chain import PAD, Path, Scene, Source, reach
from .fit import Data
from .model import Model, predict

LOWEST_LAG, HIGHEST_LAG = (
    -10,
    26,
)  # samples around the taps that a model reaches where a waveform has unknown parts
LONGEST_PART = 120_000  # samples that are fitted at once
MOST_PARTS = 8
LEAST_PART = 1000  # known samples that make a part worth a look
LONGEST_SCAN = 1 << 21  # samples in which a waveform that is shorter than the recording is looked for
EDGE = 24  # samples at either end that a filter's memory makes uncertain


def source_of(name: str, samples: np.ndarray, amplitude: float, repeat: bool) -> Source:
    """A waveform (n,) as sent with an amplitude; unknown samples, NaN, are 0."""
    known = np.isfinite(samples)
    clean = np.where(known, samples, 0).astype(complex) * amplitude
    power = np.abs(clean[known]) ** 2
    return Source(
        name=name, samples=clean, repeat=repeat, known=known, power=float(power.mean()), peak=float(np.sqrt(power.max()))
    )


def _window(source: Source, delay: int, count: int) -> Source:
    """A waveform sent once as the recording sees it at `delay` whole samples: `count` samples with PAD on
    either side."""
    size = sp_fft.next_fast_len(count + 2 * PAD)
    samples, known = np.zeros(size, complex), np.ones(size, bool)
    first = max(0, -delay - PAD)
    last = min(len(source.samples), count + PAD - delay)
    if last > first:
        at = slice(first + delay + PAD, last + delay + PAD)
        samples[at], known[at] = source.samples[first:last], source.known[first:last]
    return replace(source, samples=samples, repeat=False, known=known)


def _response(taps, length: int, rate: float) -> np.ndarray:
    f = sp_fft.fftfreq(length) * rate
    return sum(t.amplitude * np.exp(-2j * np.pi * f * t.delay_s) for t in taps)


def _segment_correlations(y, templates, repeat, segment, lags=None):
    """c[m, d] = Σ over segment m of y[n]·conj(template[n − d]); lags of a repeated template are all of one
    period."""
    count = -(-len(y) // segment)
    out = []
    for m in range(count):
        piece = y[m * segment : (m + 1) * segment]
        row = 0.0
        for _, spectrum in templates:
            p = len(spectrum)
            if repeat:
                index = (np.arange(len(piece)) + m * segment) % p
                folded = np.bincount(index, piece.real, p) + 1j * np.bincount(index, piece.imag, p)
                row = row + np.abs(sp_fft.ifft(sp_fft.fft(folded) * np.conj(spectrum))) ** 2
            else:
                buffer = np.zeros(p, complex)
                buffer[m * segment : m * segment + len(piece)] = piece
                row = row + np.abs(sp_fft.ifft(sp_fft.fft(buffer) * np.conj(spectrum))) ** 2
        out.append(row)
    return out


def find_delay(y: np.ndarray, sources: list[Source], taps: list[tuple], rate: float, centre: int = 0) -> tuple[int, float]:
    """Whole-sample delay of the twin's prediction in `y`, and the share of the recording's energy that it
    holds. `centre`: the delay of a waveform sent once that began with the recording.

    Segments are added without phase, so that a carrier offset does no harm; of several segment lengths the
    one that explains most is taken.
    """
    n = len(y)
    repeat = all(s.repeat for s in sources)
    templates = []
    for source, link in zip(sources, taps, strict=True):
        p = len(source.samples)
        size = p if repeat else sp_fft.next_fast_len(n + p + 64)
        templates.append((source, sp_fft.fft(source.samples, size) * _response(link, size, rate)))
    size = len(templates[0][1])
    energy = float(np.vdot(y, y).real)
    power = sum(s.power * np.sum(np.abs([t.amplitude for t in link]) ** 2) for s, link in zip(sources, taps, strict=True))
    best = (-np.inf, 0)
    lengths = [n // 32, *([1024, 128] if repeat else []), *([16] if n < 4000 else [])]
    for segment in sorted({max(8, length) for length in lengths}, reverse=True):
        if segment > n or (n // segment) * size > 1e8:
            continue
        rows = _segment_correlations(y, templates, repeat, segment)
        share = sum(rows) / (segment * power * energy)
        if not repeat:
            share = share * max(1.0, n / len(sources[0].samples))
        share = share - 3 * len(rows) * len(templates) / n
        d = int(np.argmax(share))
        if share[d] > best[0]:
            best = (float(share[d]), d)
    delay, share = best[1], best[0]
    if not repeat:
        delay = delay - size if delay > n else delay
        if len(sources[0].samples) >= n and n > 4000:
            near = find_near(y, sources, centre, reach=2048)
            if near[1] > 1.05 * share:
                delay, share = near
    return delay, share


def find_near(y: np.ndarray, sources: list[Source], centre: int, reach: int, segment: int = 256) -> tuple[int, float]:
    """`find_delay` by short segments within `reach` of a delay, for waveforms sent once and any carrier
    offset."""
    n = len(y)
    total, energy = np.zeros(2 * reach), 0.0
    size = sp_fft.next_fast_len(segment + 2 * reach)
    for first in np.unique(np.linspace(0, n - segment, 400).astype(int)):
        piece = y[first : first + segment]
        begin = first - centre - reach + 1
        for source in sources:
            template = source.samples[max(begin, 0) : max(begin + segment + 2 * reach - 1, 0)]
            if not template.any():
                continue
            template = np.concatenate([np.zeros(max(-begin, 0)), template])
            both = sp_fft.ifft(sp_fft.fft(template, size) * np.conj(sp_fft.fft(piece, size)))[: 2 * reach]
            total += np.abs(both[::-1]) ** 2 / (segment * source.power)
        energy += float(np.vdot(piece, piece).real)
    d = int(np.argmax(total))
    return centre + d - reach, float(total[d] - np.median(total)) / max(energy, 1e-300)


def parts_of(case, observation) -> list:
    """A long recording in overlapping parts that are fitted one by one, a short one whole; the part of which most is
    known comes first."""
    low, high = 0, len(observation.samples)
    waves = [case.waveforms[w] for w, _ in observation.on_air.values()]
    if high <= LONGEST_PART:
        return [observation.part(low, high)]
    if not any(w.repeat for w in waves) and max(len(w.samples) for w in waves) < high // 2:
        delay, _ = locate(case, observation.part(0, min(high, LONGEST_SCAN)))
        low = max(low, delay - LEAST_PART)
        high = min(high, delay + max(len(w.samples) for w in waves) + LEAST_PART)
    size = min(high - low, LONGEST_PART)
    count = min(-(-(high - low) // size), MOST_PARTS)
    parts = [observation.part(int(f), int(f) + size) for f in np.linspace(low, high - size, count)]
    known = [min(_known(w, part.first, size) for w in waves) for part in parts]
    order = sorted(range(count), key=lambda k: -known[k])
    return [parts[k] for k in order if known[k] >= min(LEAST_PART, max(known))]


def _known(waveform, first: int, size: int) -> int:
    """Samples of a stretch of the recording in which a waveform that began with it is known."""
    if waveform.repeat or len(waveform.samples) < first + size:
        return size
    return int(np.isfinite(waveform.samples[first : first + size]).sum())


def _on_air(case, observation) -> tuple[list[Source], list]:
    """Waveforms and links of a recording."""
    sent = [(case.waveforms[w], amplitude) for w, amplitude in observation.on_air.values()]
    sources = [source_of(w.name, w.samples, amplitude, w.repeat) for w, amplitude in sent]
    if len({s.repeat for s in sources}) > 1:  # one kind of search for all: repeat what repeats until the recording ends
        sources = [s if not s.repeat else _unrolled(s, len(observation.samples)) for s in sources]
    return sources, [case.links[(tx, observation.receiver)] for tx in observation.on_air]


def locate(case, observation) -> tuple[int, bool]:
    """(delay in samples, whether the spectrum is inverted) of the twin's prediction in a recording."""
    sources, links = _on_air(case, observation)
    rate, n, y = case.sample_rate_hz, len(observation.samples), observation.samples.astype(complex)
    turn = np.exp(-2j * np.pi * _twin_offset_hz(case, observation, links) * np.arange(n) / rate)
    taps, centre = [link.taps for link in links], -observation.first
    told = _told_inverted(case, observation)
    delay, share = find_delay((np.conj(y) if told else y) * turn, sources, taps, rate, centre)
    if told:
        return delay, False
    other, other_share = find_delay(np.conj(y) * turn, sources, taps, rate, centre)
    flip = other_share > 1.2 * share + 0.01
    return (other if flip else delay), flip


def _told_inverted(case, observation) -> bool:
    return any(e["family"] == "spectral_inversion" for e in twin_effects(case, observation))


def build(case, observation, *, near: tuple[int, bool] | None = None):
    """Scene, data and first model of one recording; `near`: (delay in samples, inverted) where they are
    known before."""
    rate, n = case.sample_rate_hz, len(observation.samples)
    y = observation.samples.astype(complex)
    names = list(observation.on_air)
    sources, links = _on_air(case, observation)
    twin, told = twin_effects(case, observation), _told_inverted(case, observation)
    delay, flip = locate(case, observation) if near is None else near
    repeat = sources[0].repeat
    if repeat:
        delay %= len(sources[0].samples)
    seen = sources if repeat else [_window(s, delay, n) for s in sources]
    later = observation.first / rate
    paths = [
        Path(source=i, delay=t.delay_s * rate, gain=complex(t.amplitude), doppler=t.doppler_hz * n / rate)
        for i, link in enumerate(links)
        for t in link.taps
    ]
    scene = Scene(
        name=observation.name,
        sample_rate_hz=rate,
        count=n,
        sources=seen,
        taps=paths,
        transmitters=names,
        receiver=observation.receiver,
        anchor=0 if repeat else delay,
        carrier_hz=observation.center_frequency_hz,
        free_ports=tuple(i for i, link in enumerate(links) if i and {"gain", "phase"} & set(link.unknown)),
    )
    on_air = {w for w, _ in observation.on_air.values()}
    scene.extra = {
        w.name: _seen(source_of(w.name, w.samples, 1.0, w.repeat), scene, n)
        for w in case.waveforms.values()
        if w.name not in on_air and not _is_on_air(case, w.name)
    }
    scene.rms = float(np.sqrt(np.mean(np.abs(y) ** 2)))
    data = _data(case, observation, scene, y)
    scene.floor = data.noise_power or scene.floor
    base = np.array([float(delay) if repeat else 0.0, 1.0, 0.0, *(1.0, 0.0) * len(scene.free_ports)])
    model = Model(base=base)
    for entry in twin:
        model = model.adding(effect_of(scene, entry, later))
    if flip:
        model = model.adding(start(FAMILIES["spectral_inversion"], []))
    chain = predict(scene, model)
    w = data.root
    overlap = np.vdot(chain.y * w, y * w) / max(np.vdot(chain.y * w, chain.y * w).real, 1e-30)
    if flip or told:
        overlap = np.conj(overlap)
    if abs(overlap) < 1e-9:
        overlap = np.sqrt(np.mean(np.abs(y) ** 2) / max(np.mean(np.abs(chain.y) ** 2), 1e-30)) * 1e-3
    model = Model(base=np.concatenate([[base[0], overlap.real, overlap.imag], base[3:]]), effects=model.effects)
    return scene, data, model


def _unrolled(source: Source, n: int) -> Source:
    return replace(source, samples=np.resize(source.samples, n), repeat=False, known=np.resize(source.known, n))


def _seen(source: Source, scene: Scene, n: int) -> Source:
    return source if source.repeat else _window(source, scene.anchor, n)


def _is_on_air(case, name: str) -> bool:
    return any(name == w for o in case.observations for w, _ in o.on_air.values())


def twin_effects(case, observation) -> list[dict]:
    """The twin's entries of `effects` that have a part in a recording."""
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


def _twin_offset_hz(case, observation, links) -> float:
    """Carrier offset that the twin already knows, with the Doppler of the strongest tap."""
    total = 0.0
    for entry in twin_effects(case, observation):
        if entry["family"] == "carrier_frequency_offset":
            total += plain(entry["parameters"].get("offset_hz", 0.0), observation.name) or 0.0
    strongest = max((t for link in links for t in link.taps), key=lambda t: t.gain_db)
    return total + strongest.doppler_hz


def effect_of(scene, entry, later: float = 0.0):
    """A twin's entry as an effect on a recording that begins `later` seconds into it."""
    family = FAMILIES[entry["family"]]
    values = {k: plain(v, scene.name) for k, v in entry["parameters"].items()}
    values = {k: v for k, v in values.items() if v is not None}
    if family.name == "carrier_frequency_offset":
        values["offset_hz"] = values.get("offset_hz", 0.0) + values.get("drift_hz_per_s", 0.0) * later
    effect = family.parse(scene, values, {**(entry.get("model") or {}), **_owned(scene, entry["owner"])})
    stds = [v.get("std", 0.0) for v in entry["parameters"].values() if isinstance(v, dict) and "value" in v]
    free = effect.free & (family.random or any(s > 0 for s in stds))
    return replace(effect, fixed=True, free=free)


def _owned(scene, owner: dict) -> dict:
    """Where an owner's effect stands in a scene: its side, and the number of its transmitter."""
    tx, _, rx = owner["name"].partition(">")
    return {"side": "tx" if tx in scene.transmitters and not rx else "rx"} | (
        {"source": scene.transmitters.index(tx)} if tx in scene.transmitters else {}
    )


def split(valid: np.ndarray, seed: int = 1) -> np.ndarray:
    """(n,) bool, the vault: one of the samples in eight, in scattered short runs; shorter where few are `valid`."""
    n = len(valid)
    run = 16 if valid.sum() > 4000 else 4
    runs = -(-n // run)
    return np.repeat(np.random.default_rng(seed).random(runs) < 1 / 8, run)[:n]


def told_noise_db(case, observation) -> float | None:
    """The noise power that the twin tells of a recording, with the changes of the floor that it knows of."""
    told = case.noise_db.get(observation.receiver)
    if told is None:
        return None
    known = (e for e in twin_effects(case, observation) if e["family"] == "noise_floor")
    return told + sum(plain(e["parameters"]["change_db"], observation.name) for e in known)


def _data(case, observation, scene, y) -> Data:
    n = len(y)
    spread = max(p.delay for p in scene.taps)
    valid = reach(scene, LOWEST_LAG - 8, int(np.ceil(spread)) + HIGHEST_LAG + 8)
    edge = min(EDGE, n // 40)
    valid[:edge] = valid[n - edge :] = False
    vault = np.ones(n, bool) if observation.vault else split(valid)
    noise = told_noise_db(case, observation)
    return Data(
        scene=scene,
        y=y,
        use=(valid & ~vault).astype(float),
        vault=vault & valid,
        noise_power=None if noise is None else 10 ** (noise / 10),
    )
