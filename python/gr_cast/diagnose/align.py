# SPDX-License-Identifier: GPL-3.0-or-later
"""Bring twin and recording together: whole-sample delay, gain and orientation, whatever the carrier offset;
build the scene."""

import math
from dataclasses import replace

import numpy as np
from scipy import fft as sp_fft

from ..core.errors import CastError
from ..twin.effects import FAMILIES, Role, with_role
from ..twin.effects.base import start
from ..twin.entries import effect_of, in_either_seconds, known_losses, lost_before, plain, source_of, told_noise_db, twin_effects
from ..twin.interpolate import TAU, phasor
from ..twin.model import Model, predict
from ..twin.scene import PAD, Path, Scene, Source, bridged, reach
from . import blanks, delays, gate, offsets, pieces, presence
from .fit import Data
from .policy import (
    ALIGN_MARGIN,
    BESIDE_A_MOMENT,
    DELAY_SHORTEST,
    DELAY_SURE_NATS,
    EDGE,
    FACTORS,
    FAST,
    FEWEST_PARTS,
    HIGHEST_LAG,
    LAGS_AROUND,
    LEAST_GATHERED,
    LEAST_HEARD,
    LEAST_OF_QUICK,
    LEAST_PART,
    LONGEST_EVERYWHERE,
    LONGEST_FAST,
    LONGEST_PART,
    LONGEST_SCAN,
    LONGEST_WHOLE,
    LOWEST_LAG,
    MOST_PARTS,
    MOSTLY,
    NEAR_MOST,
    PART,
    PART_OF_PIECES,
)


def _stretch(waveform, amplitude: float, first: int, size: int) -> Source:
    """`size` samples of a waveform from its sample `first` on, as sent with an amplitude; silence around one that is
    sent once."""
    length = len(waveform.samples)
    if waveform.repeat:
        begin = first % length
        samples = waveform.samples[begin : begin + size]
        while len(samples) < size:
            samples = np.concatenate([samples, waveform.samples[: size - len(samples)]])
    else:
        samples = np.zeros(size, np.complex64)
        begin, end = max(first, 0), min(first + size, length)
        if end > begin:
            samples[begin - first : end - first] = waveform.samples[begin:end]
    known, (power, peak) = np.isfinite(samples), waveform.level
    return Source(
        name=waveform.name,
        samples=bridged(samples, known, False) * amplitude,
        repeat=False,
        known=known,
        power=power * amplitude**2,
        peak=peak * amplitude,
    )


def _window(waveform, amplitude: float, delay: int, count: int) -> Source:
    """A waveform as the recording sees it at `delay` whole samples: `count` samples with PAD on either side."""
    return _stretch(waveform, amplitude, -delay - PAD, sp_fft.next_fast_len(count + 2 * PAD))


def quick(size: int) -> int:
    """The most samples, no more than that and hardly less, whose number has small prime factors alone: transforms of others take
    several times as long. Where there is no such number, of few samples, `size`."""
    for fewer in range(size, size - size // LEAST_OF_QUICK, -1):
        left = fewer
        for factor in FACTORS:
            while left % factor == 0:
                left //= factor
        if left == 1:
            return fewer
    return size


def parts_of(case, observation) -> list[tuple]:
    """[(part, its `near` for `build`)]: a short recording whole (see `quick`), a long one in parts that are fitted one by one,
    the part of which most is known first."""
    low, high = 0, len(observation.samples)
    waves = [case.waveforms[w] for w, _ in observation.on_air.values()]
    near = None if any(w.repeat for w in waves) else locate(case, observation.part(0, min(high, LONGEST_SCAN)))
    stretches = [(low, high, near)] if near is None else _stretches(observation, waves, near)
    if len(stretches) > 1:
        parts = [p for begin, end, at in stretches for p in _parts(case, observation, waves, begin, end, at)]
        return sorted(parts, key=lambda p: -min(_known(w, p[0].first - near[0], len(p[0].samples)) for w in waves))
    if high <= LONGEST_WHOLE:
        return [_trimmed(observation, waves, near)]
    return _parts(case, observation, waves, low, high, near)


def _stretches(observation, waves, near) -> list[tuple]:
    """[(first sample, last + 1, `near` of the recording's beginning)] between the jumps of a recording against waveforms that
    are known in pieces; in others a fit finds them."""
    delay, inverted = near
    samples = observation.samples
    high = min(len(samples), delay + max(len(w.samples) for w in waves))
    if high > LONGEST_SCAN or all(np.isfinite(w.samples[:]).all() for w in waves):
        return [(0, len(samples), near)]
    y = samples[:].astype(complex)
    found = pieces.segments(np.conj(y) if inverted else y, [w.samples[:] for w in waves], delay)
    return [(first, last, (at, inverted)) for first, last, at in found]


def _parts(case, observation, waves, low: int, high: int, near) -> list[tuple]:
    """`parts_of` a stretch of a recording, the part of which most is known first."""
    if near is not None:
        delay, _ = near
        low = max(low, delay - LEAST_PART)
        high = max(min(high, delay + max(len(w.samples) for w in waves) + LEAST_PART), low + LEAST_PART)
    share = min(_known(w, low, high - low) for w in waves) / (high - low)
    part = PART if share > MOSTLY else PART_OF_PIECES
    size = min(high - low, int(part / max(share, part / LONGEST_PART)))
    count = min(max(-(-(high - low) // size), FEWEST_PARTS if share > MOSTLY and high - low > LONGEST_WHOLE else 1), MOST_PARTS)
    size = quick(min(size, -(-(high - low) // count)))  # no sample is in two parts
    parts = [observation.part(int(f), int(f) + size) for f in np.linspace(low, high - size, count)]
    known = [min(_known(w, part.first, size) for w in waves) for part in parts]
    order = sorted(range(count), key=lambda k: -known[k])
    kept = [parts[k] for k in order if known[k] >= min(LEAST_PART, max(known))]
    if near is None:
        return [(part, None) for part in kept]
    # the sample clocks may have moved it by some samples since the beginning
    return [(part, locate(case, part, (near[0] - part.first, near[1]))) for part in kept]


def around(case, observation, gap: tuple[int, int], size: int):
    """The part of `size` samples of a long recording around the middle of a gap between others; None where too little of
    the gap is known."""
    waves = [case.waveforms[w] for w, _ in observation.on_air.values()]
    if min(_known(w, gap[0], gap[1] - gap[0]) for w in waves) < LEAST_PART:
        return None
    first = int(np.clip((gap[0] + gap[1] - size) // 2, 0, len(observation.samples) - size))
    return observation.part(first, first + size)


def _trimmed(observation, waves, near) -> tuple:
    """(part, near): a recording without the beginning and the end of which nothing is known, of a length that is quick."""
    n = len(observation.samples)
    if near is None:
        return observation.part(0, quick(n)), None
    known = np.ones(n, bool)
    for w in waves:
        begin, end = max(0, near[0]), max(0, min(n, near[0] + len(w.samples)))
        here = np.isfinite(w.samples[begin - near[0] : end - near[0]])
        if not here.all():  # else the silence around it is known too
            known[:begin] = known[end:] = False
            known[begin:end] &= here
    at = np.flatnonzero(known)
    low, high = (max(0, at[0] - ALIGN_MARGIN), min(n, at[-1] + 1 + ALIGN_MARGIN)) if len(at) else (0, n)
    return observation.part(int(low), int(low) + quick(int(high - low))), (near[0] - int(low), near[1])


def _known(waveform, first: int, size: int) -> int:
    """Samples of a stretch of the recording in which a waveform that began with it is known."""
    if waveform.repeat or len(waveform.samples) < first + size:
        return size
    return int(np.isfinite(waveform.samples[first : first + size]).sum())


def _on_air(case, observation) -> tuple[list, list]:
    """(waveform, amplitude) and link of every transmitter of a recording."""
    sent = [(case.waveforms[w], amplitude) for w, amplitude in observation.on_air.values()]
    return sent, [case.links[(tx, observation.receiver)] for tx in observation.on_air]


def _looped(sent) -> bool:
    """Whether one period stands for all that was sent."""
    return all(w.repeat and len(w.samples) <= LONGEST_SCAN for w, _ in sent)


def _with_what_was_lost(y: np.ndarray, losses, period: int) -> np.ndarray:
    """A recording with silence for the samples that were lost, [(first behind them, how many)] from the last on, and without
    those that were inserted: in it all that was sent has one delay."""
    for at, lost in losses:
        lost = lost % period if period else lost
        if lost < LONGEST_SCAN:
            y = np.concatenate([y[: at + min(lost, 0)], np.zeros(max(lost, 0)), y[at:]])
    return y


def locate(case, observation, about: tuple[int, bool] | None = None) -> tuple[int, bool]:
    """(delay in samples, whether the spectrum is inverted) of the twin's prediction in a recording; `about`: what they
    are nearly."""
    sent, links = _on_air(case, observation)
    rate, low, period = case.sample_rate_hz, 0, math.lcm(*(len(w.samples) for w, _ in sent)) if _looped(sent) else 0
    y = _with_what_was_lost(observation.samples[:].astype(complex), known_losses(case, observation), period)
    n = len(y)
    if period:
        sources = [source_of(w.name, w.samples, amplitude, True) for w, amplitude in sent]
    else:  # one kind of search for all: what repeats is sent until the recording ends
        high = max(n, *(len(w.samples) for w, _ in sent))
        if high > LONGEST_SCAN:  # then it began when the recording began, or nearly
            low = max(0, observation.first - LONGEST_SCAN // 4)
            high = min(high, observation.first + n + LONGEST_SCAN // 4)
        sources = [_stretch(w, amplitude, low, high - low) for w, amplitude in sent]
    sources = [replace(s, samples=delays.without_lines(s.samples)) if s.repeat and s.known.all() else s for s in sources]
    turn = phasor(-TAU * _twin_offset_hz(case, observation, links) * np.arange(n) / rate)
    taps, told = [link.taps for link in links], _told_inverted(case, observation)
    signals = [np.conj(y) * turn] if told else [y * turn, np.conj(y) * turn]
    late = round(_loudest(links).delay_s * rate)

    def near_to(signal, delay: int, reach: int):  # by the loudest path, which is late by itself
        found, share, clear = delays.near(signal, sources, delay + late, reach=reach)
        return found - late, share, clear

    def carried(signals, found):
        return delays.of_one_carrier(signals, sources, taps, rate, found)

    if about:
        signal = signals[about[1]]
        found = near_to(signal, low + about[0], 64)[0]
        return (found if (told := carried([signal], [found])) is None else told[0].delay) - low, about[1]
    tried, find = period or n + len(sources[0].samples), delays.of_repeated if period else delays.of_sent_once
    near = []
    if not period and len(sources[0].samples) >= n and n > 4000:
        near = [near_to(signal, low - observation.first, 2048) for signal in signals]
    clear = any(clear for *_, clear in near)
    again = clear and all(delays.comes_again(s.samples) for s in sources)
    most = clear and not again and max(share for _, share, clear in near if clear) > NEAR_MOST

    def likelier(signals, found) -> int | None:
        return presence.likelier(
            [(s, *_sent_at(sources, taps, rate, d, n)) for s, d in zip(signals, found, strict=True)], period, tried
        )

    found = [delay for delay, *_ in near] if clear else []
    if not most and (not clear or tried <= LONGEST_EVERYWHERE):  # what is like itself stands out at a wrong delay too
        everywhere = [find(signal, sources, taps, rate) for signal in signals]
        found = everywhere + found if again else found + everywhere
    both = [*signals, *signals][: len(found)]
    if told := carried(both, found):
        found = [one.delay for one in told]
        clearest = int(np.argmax([one.share for one in told]))
        if any(told[clearest].is_clearer(one) for one in told):
            return found[clearest] - low, clearest % 2 == 1
    if len(sources) == 1 and not period and tried <= LONGEST_EVERYWHERE:
        turning = [delays.of_products(s, sources[0], taps[0], rate) for s in signals]
        if any(t.nats > DELAY_SURE_NATS for t in turning):
            both = [*both, *(s * phasor(-TAU * t.carrier * np.arange(n)) for s, t in zip(signals, turning, strict=True))]
            found = [*found, *(t.delay for t in turning)]
    best = likelier(both, found)

    def otherwise():
        yield [presence.within(s, sources) for s in signals]
        for carrier in FAST if not period and tried <= LONGEST_FAST else ():
            yield [s * phasor(-TAU * carrier * np.arange(n)) for s in signals]

    for others in otherwise() if best is None else ():
        elsewhere = [find(s, sources, taps, rate) for s in others]
        best = likelier(others, elsewhere)
        if best is not None:
            found = elsewhere
            break
    return found[best or 0] - low, (best or 0) % 2 == 1


def _sent_at(sources, taps, rate: float, delay: int, n: int):
    """((sources, n) what every link makes of what is sent at a delay, (n,) 1 where all of it is known)."""
    signals, known, index = [], np.ones(n, bool), np.arange(n) - delay
    for source, link in zip(sources, taps, strict=True):
        length = len(source.samples)
        heard = sp_fft.ifft(delays.heard_spectrum(source, link, rate))
        inside = slice(None) if source.repeat else (index >= 0) & (index < length)
        signal, at = np.zeros(n, complex), index[inside] % length
        signal[inside], known[inside] = heard[at], known[inside] & source.known[at]
        signals.append(signal)
    return np.array(signals), known.astype(float)


def looked_at(case, observation) -> tuple[tuple[int, int], float]:
    """((first, last) delay in samples, widest carrier in cycles per sample) at which `locate` looks for what is sent."""
    length, n = max(len(case.waveforms[w].samples) for w, _ in observation.on_air.values()), len(observation.samples)
    if _looped(_on_air(case, observation)[0]):
        return (0, length - 1), 1 / (2 * DELAY_SHORTEST)
    return (1 - length, n - 1), FAST[-1] if n + length <= LONGEST_FAST else 1 / 80


def _told_inverted(case, observation) -> bool:
    return any(FAMILIES[e["family"]].role is Role.ORIENTATION for e in twin_effects(case, observation))


def build(case, observation, *, near: tuple[float, bool] | None = None):
    """Scene, data and first model of one recording; `near`: (delay in samples, inverted) where they are
    known before."""
    rate, n = case.sample_rate_hz, len(observation.samples)
    y = observation.samples[:].astype(complex)
    names = list(observation.on_air)
    sent, links = _on_air(case, observation)
    twin, told = twin_effects(case, observation), _told_inverted(case, observation)
    delay, flip = locate(case, observation) if near is None else near
    repeat, lost = _looped(sent), sum(max(0, lost) for _, lost in known_losses(case, observation))
    if repeat:
        sources = [source_of(w.name, w.samples, amplitude, True) for w, amplitude in sent]
        delay %= math.lcm(*(len(s.samples) for s in sources))
    else:
        whole = int(round(delay))
        sources = [_window(w, amplitude, whole, n + lost) for w, amplitude in sent]
    later = observation.first / rate  # a moving path has turned since the recording's first sample
    paths = [
        Path(
            source=i,
            delay=t.delay_s * rate,
            gain=complex(t.amplitude) * np.exp(2j * np.pi * t.doppler_hz * later),
            doppler=t.doppler_hz * n / rate,
        )
        for i, link in enumerate(links)
        for t in link.taps
    ]
    scene = Scene(
        name=observation.name,
        sample_rate_hz=rate,
        count=n,
        sources=sources,
        taps=paths,
        transmitters=names,
        receiver=observation.receiver,
        anchor=0 if repeat else whole,
        begins=observation.first,
        ahead=lost_before(case, observation),
        whole=observation.whole,
        carrier_hz=observation.center_frequency_hz,
        free_ports=tuple(i for i, link in enumerate(links) if i and {"gain", "phase"} & set(link.unknown)),
    )
    on_air = {w for w, _ in observation.on_air.values()}
    scene.extra = {
        w.name: source_of(w.name, w.samples, 1.0, True) if _looped([(w, 1.0)]) else _window(w, 1.0, scene.anchor, n + lost)
        for w in case.waveforms.values()
        if w.name not in on_air and not _is_on_air(case, w.name)
    }
    data = _known_alone(_data(case, observation, scene, y, delay if repeat else 0))
    if not (data.use.any() or data.vault.any()):
        names, last = ", ".join(s.name for s in scene.sources), int(np.ceil(max(p.delay for p in paths)))
        raise CastError(
            f"{case.name}: {observation.name}: {names}: known nowhere for as long as the paths are, {last} samples, with some on "
            "either side: nothing can be compared"
        )
    scene, y = data.scene, data.y
    scene.rms = float(np.sqrt(np.mean(np.abs(y) ** 2)))
    scene.floor = data.noise_power or scene.floor
    base = np.array([float(delay) if repeat else delay - whole, 1.0, 0.0, *(1.0, 0.0) * len(scene.free_ports)])
    model = Model(base=base)
    for entry in twin:
        model = model.adding(effect_of(scene, entry))
    model = replace(model, effects=in_either_seconds(scene, model.effects))
    data = _without_moments(data, model)
    if flip:
        model = model.adding(start(with_role(Role.ORIENTATION), []))
    model = offsets.within_told(data, model)
    chain = predict(scene, model)
    w = data.root
    overlap = np.vdot(chain.y * w, y * w) / max(np.vdot(chain.y * w, chain.y * w).real, 1e-30)
    if flip or told:
        overlap = np.conj(overlap)
    if abs(overlap) < 1e-9:
        overlap = np.sqrt(np.mean(np.abs(y) ** 2) / max(np.mean(np.abs(chain.y) ** 2), 1e-30)) * 1e-3
    model = replace(model, base=np.concatenate([[model.base[0], overlap.real, overlap.imag], model.base[3:]]))
    return scene, data, model


def whole_over_part(case, whole, part, scene) -> float:
    """The rms of what was sent during the whole recording over that during a part with its scene."""
    if scene.sources[0].repeat:
        return 1.0
    sent, here, at = 0.0, 0.0, slice(PAD, PAD + scene.count)
    for (w, _), source in zip(_on_air(case, whole)[0], scene.sources, strict=True):
        begin, length = scene.anchor + part.first, len(w.samples)
        during = len(whole.samples) if w.repeat else min(len(whole.samples), begin + length) - max(0, begin)
        sent += source.power * during / len(whole.samples)
        here += float(np.sum(np.abs(source.samples[at]) ** 2) / max(1, source.known[at].sum()))
    return float(np.sqrt(sent / here)) if sent > 0 and here > 0 else 1.0


def _without_moments(data: Data, model: Model) -> Data:
    """The data without the samples beside what the twin knows to happen at a moment, at a transmitter as late as its paths:
    rounding of its time may move it by one."""
    scene, beside = data.scene, np.zeros(data.scene.count, bool)
    for e in model.effects:
        moment = FAMILIES[e.family].moment(scene, e)
        lates = {p.delay for p in scene.taps if p.source == e.aux["source"]} if e.aux.get("side") == "tx" else {0.0}
        for late in lates if moment is not None else ():
            beside |= np.abs(scene.index - moment - late) < BESIDE_A_MOMENT
    return replace(data, use=np.where(beside, 0.0, data.use), vault=data.vault & ~beside) if beside.any() else data


def _known_alone(data: Data) -> Data:
    """The data without the samples around which nothing is known, where those are many: every step of a fit then costs
    what the known ones cost. Kept are, with the samples to fit, those that a model reaches from them."""
    scene, wanted = data.scene, (data.use > 0) | data.vault
    if scene.count < LEAST_GATHERED or scene.sources[0].repeat or not wanted.any():
        return data
    low, high = LOWEST_LAG - 8, int(np.ceil(max(p.delay for p in scene.taps))) + HIGHEST_LAG + 8
    sums = np.concatenate([[0], np.cumsum(wanted)])
    n = np.arange(scene.count)
    at = np.flatnonzero(sums[np.minimum(n + high + 1, scene.count)] > sums[np.maximum(n + low, 0)])
    if len(at) > MOSTLY * scene.count:
        return data
    gathered = lambda source: source if source.repeat else _gathered(source, at)  # noqa: E731
    scene = replace(
        scene,
        count=len(at),
        sources=[gathered(s) for s in scene.sources],
        extra={name: gathered(s) for name, s in scene.extra.items()},
        span=scene.count,
        at=at,
    )
    return replace(data, scene=scene, y=data.y[at], use=data.use[at], vault=data.vault[at])


def _gathered(source: Source, at: np.ndarray) -> Source:
    """A window of what was sent, cut down to the samples `at` of the recording, with silence around them."""
    size = sp_fft.next_fast_len(len(at) + 2 * PAD)
    samples, known = np.zeros(size, complex), np.ones(size, bool)
    samples[PAD : PAD + len(at)], known[PAD : PAD + len(at)] = source.samples[PAD + at], source.known[PAD + at]
    return replace(source, samples=samples, known=known)


def _is_on_air(case, name: str) -> bool:
    return any(name == w for o in case.observations for w, _ in o.on_air.values())


def _twin_offset_hz(case, observation, links) -> float:
    """Carrier offset that the twin already knows, with the Doppler of the strongest tap."""
    total = 0.0
    for entry in twin_effects(case, observation):
        if FAMILIES[entry["family"]].role is Role.CARRIER:
            total += plain(entry["parameters"].get("offset_hz", 0.0), observation.name) or 0.0
    return total + _loudest(links).doppler_hz


def _loudest(links):
    """The strongest tap of all links."""
    return max((t for link in links for t in link.taps), key=lambda t: t.gain_db)


def split(valid: np.ndarray, seed: int = 1) -> np.ndarray:
    """(n,) bool, the vault: of every eight short runs of valid samples one; shorter runs where few are valid."""
    run = 16 if valid.sum() > 4000 else 4
    number = (np.cumsum(valid) - 1) // run
    chosen = np.random.default_rng(seed).integers(0, 8, len(valid) // (8 * run) + 1)
    return valid & (number % 8 == chosen[number // 8])


def _reached(scene, delay: float) -> np.ndarray:
    """(count,) bool: samples around which all is known that a model reaches; of a waveform of which so much is known nowhere in
    one piece, less around what the twin's own paths reach."""
    last, valid = int(np.ceil(max(p.delay for p in scene.taps))), np.zeros(scene.count, bool)
    for around in LAGS_AROUND:
        low, high = (int(np.rint(around * lag)) for lag in (LOWEST_LAG - 8, HIGHEST_LAG + 8))
        valid = reach(scene, low, last + high, delay)
        if valid.sum() >= min(LEAST_HEARD, scene.count // 4):
            break
    return valid


def _data(case, observation, scene, y, delay: float) -> Data:
    n = len(y)
    valid = _reached(scene, delay)
    edge = min(EDGE, n // 40)
    valid[:edge] = valid[n - edge :] = False
    valid &= ~blanks.inside(y)
    vault = np.ones(n, bool) if observation.vault else split(valid)
    noise = told_noise_db(case, observation)
    return Data(
        scene=scene,
        y=y,
        use=(valid & ~vault).astype(float),
        vault=vault & valid,
        noise_power=None if noise is None else 10 ** (noise / 10),
        rounding=gate.native_step(observation.datatype) ** 2 / 6,
    )
