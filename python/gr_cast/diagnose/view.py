# SPDX-License-Identifier: GPL-3.0-or-later
"""What the residual of a fit shows, in the coordinates in which families are found: lines, echoes, courses,
jumps."""

from functools import cached_property

import numpy as np
from scipy import fft as sp_fft

from ..twin.basis import course_orders
from ..twin.effects import FAMILIES, Role, plays, stage_of
from ..twin.effects.base import RX_GAIN, RX_LO, at_half_the_rate, peaks
from ..twin.interpolate import TAU, phasor
from ..twin.model import predict
from ..twin.scene import PAD
from . import blanks
from .phase_cells import PhaseCells
from .policy import (
    BLANK_APART,
    ECHO_CELLS,
    ECHO_SEGMENTS,
    FASTER,
    FASTEST,
    HARMONICS,
    HUM_POINTS,
    LEAST_RAMP_CELLS,
    LEAST_SEGMENT,
    LEAST_SENT,
    LINE_NATS,
    LONGEST_JUMP,
    MOST_JUMPS,
    MOST_PERIODS,
    NEARLY_ALL_OF_PHASE,
    PERIOD_CYCLES,
    POINTS,
    QUIET,
    RAMP_CELLS,
    SKIRT,
    SLOW_HUMS,
    SLOW_POINTS,
    STILL,
    UNSIGNED,
    VIEW_AROUND,
    VIEW_JUMP_NATS,
    VIEW_SEGMENTS,
)


class View:
    def __init__(self, fit):
        self.fit, self.data, self.scene = fit, fit.data, fit.data.scene
        self.sigma2 = fit.sigma2

    @cached_property
    def weight(self) -> np.ndarray:
        return self.data.root**2

    @cached_property
    def recorded(self) -> np.ndarray:
        """The residual as recorded, zero where samples are not used."""
        return self.fit.residual * self.weight

    @cached_property
    def residual(self) -> np.ndarray:
        """The residual before the receiver's inversion, zero where samples are not used."""
        return self.fit.came(self.recorded)

    @cached_property
    def wanted(self) -> np.ndarray:
        return self.fit.came(self.fit.chain.wanted)

    @cached_property
    def carrier(self) -> np.ndarray:
        """The complex factor that oscillators and gain put on every path of the first transmitter."""
        return self.carrier_of(0)

    def carrier_of(self, code) -> np.ndarray:
        """The complex factor that oscillators and gain put on what one transmitter sends; only the receiver's on what is not
        on the air in the twin."""
        return self.receiver * self.fit.chain.sent(code) if isinstance(code, int) else self.receiver

    @cached_property
    def receiver(self) -> np.ndarray:
        """The complex factor that the receiver's oscillator and gain put on everything."""
        chain = type(self.fit.chain)(scene=self.scene, delay=0.0, ports={}, u=self.fit.chain.u, pace=self.fit.chain.pace)
        chain.y = np.full(self.scene.count, complex(*self.fit.model.base[1:3]))
        for effect in self.fit.model.effects:
            if stage_of(effect) in (RX_LO, RX_GAIN):
                chain.wanted = chain.y
                FAMILIES[effect.family].apply(chain, effect)
        return chain.y

    def amplitude_moments(self) -> tuple[np.ndarray, np.ndarray]:
        """(slope, curvature) of ln L by a real gain in nepers, per sample."""
        slope, curve = self._moments
        return slope.real, curve

    @cached_property
    def _moments(self) -> tuple[np.ndarray, np.ndarray]:
        """(slope, curvature) of ln L by the logarithm of what is wanted, per sample: of its gain, and times j of its phase."""
        slope = 2 / self.sigma2 * self.residual * np.conj(self.wanted)
        return slope, 2 / self.sigma2 * np.abs(self.wanted) ** 2 * self.weight

    @cached_property
    def phase_cells(self) -> PhaseCells:
        """What the recording says of a phase, in cells of time, besides a phase and, where a carrier offset and its drift are
        fitted, those."""
        slope, curve = (self.scene.spread(moment) for moment in (self._moments[0].imag, self._moments[1]))
        edges = np.unique(np.linspace(0, len(slope), RAMP_CELLS + 1).astype(int))
        fitted = np.any([e.free for e in self.fit.model.effects if plays(e, Role.CARRIER)] or [[False]], axis=0)
        return PhaseCells(
            knots=edges / len(slope),
            slope=np.add.reduceat(slope, edges[:-1]),
            curve=np.add.reduceat(curve, edges[:-1]),
            known=1 + np.count_nonzero(fitted),
        )

    def ramps_of_phase(self) -> list[tuple[float, float, int]]:
        """[(first, last moment as shares of the recording, pairs that were tried)] of the stretch in which a phase that turns
        evenly there and nowhere else explains most."""
        cells = self.phase_cells
        knots, count = cells.knots, len(cells.curve)
        if count < LEAST_RAMP_CELLS:
            return []
        first, last = np.triu_indices(count + 1, 1)
        first, last = first[last - first < count], last[last - first < count]  # all of it is a carrier offset
        ramps = np.clip((cells.middle - knots[first, None]) / (knots[last] - knots[first])[:, None], 0.0, 1.0)
        nats = cells.explained(ramps)[0]
        best = int(np.argmax(nats))
        enough = nats[best] > np.log(len(nats)) + VIEW_JUMP_NATS
        return [(float(knots[first[best]]), float(knots[last[best]]), len(nats))] if enough else []

    def phase_law(self, laws: list) -> int | None:
        """The number of the one of some `laws` of a phase, (cells,) each, that explains nearly all of what the recording says of
        it; None where none does."""
        cells = self.phase_cells
        if len(cells.curve) < LEAST_RAMP_CELLS:
            return None
        nats, all_nats = cells.explained(np.array(laws))
        best = int(np.argmax(nats))
        enough = nats[best] > max(VIEW_JUMP_NATS, NEARLY_ALL_OF_PHASE * (all_nats - len(cells.curve)))
        return best if enough else None

    def modulation_peak(self) -> float | None:
        """Cycles over the recording by which the wanted part turns against the prediction, where that is
        far from 0."""
        y = self.fit.came(self.data.y)
        product = self.scene.spread(y * np.conj(self.wanted) * self.weight)
        size = sp_fft.next_fast_len(2 * len(product))
        spectrum = np.abs(sp_fft.fft(product, size))
        k = int(np.argmax(spectrum))
        cycles = (k if k < size // 2 else k - size) * len(product) / size
        return cycles if abs(cycles) > 0.4 and spectrum[k] > 1.5 * spectrum[0] else None

    def amplitude_lines(self, count: int) -> list[tuple[float, bool]]:
        """[(cycles, whether it stands out of noise)] of the strongest lines in the gain over time."""
        slope, curve = (self.scene.spread(moment) for moment in self.amplitude_moments())
        block = 4
        n = len(slope) // block * block
        a = slope[:n].reshape(-1, block).sum(1)
        e = curve[:n].reshape(-1, block).sum(1)
        a = a - e * a.sum() / max(e.sum(), 1e-300)
        spectrum = np.abs(sp_fft.rfft(a, 4 * len(a)))
        k = np.arange(len(spectrum)) / 4 * self.scene.span / n
        spectrum[(k < 0.8) | (k > self.hum_bins)] = 0.0
        clear = (np.log(len(spectrum)) + LINE_NATS) * e.sum()
        return [(float(k[i]), bool(spectrum[i] ** 2 > clear)) for i in peaks(spectrum, count, 6)]

    def hums(self, count: int) -> list[tuple[float, int]]:
        """[(cycles, harmonics)] of the likeliest hums of the gain: the strongest lines alone, and the fundamental that explains
        most together with its harmonics, where they pay for themselves."""
        found = self.amplitude_lines(count)
        alone, price, best = [cycles for cycles, _ in found], np.log(self.data.count), (0.0, None)
        lines = sorted({c / part for c in alone for part in (1, 2, 3)})
        fast = max(POINTS, int(HUM_POINTS * max((cycles for cycles, clear in found if clear), default=0.0)))
        for points, fundamentals in ((SLOW_POINTS, SLOW_HUMS), (fast, lines)):
            a, e, u = self._course_of_gain(points)
            for cycles in (c for c in fundamentals if c >= SLOW_HUMS[0]):
                most = [h for h in HARMONICS if h * cycles < len(a) / 8]
                angle = 2 * np.pi * cycles * u
                waves = [f(k * angle) for k in range(1, max(most, default=0) + 1) for f in (np.cos, np.sin)]
                waves = np.array([np.ones(len(a)), *waves])
                gram, b = (waves * e) @ waves.T, waves @ a
                gram += 1e-9 * np.diag(np.diag(gram)) + 1e-30 * np.eye(len(b))
                for h in most:
                    at = slice(0, 2 * h + 1)
                    net = 0.5 * b[at] @ np.linalg.solve(gram[at, at], b[at]) - h * price
                    best = max(best, (net, (float(cycles), h)), key=lambda t: t[0])
        together = [best[1]] if best[1] and best[1][1] > 1 else []
        return [*((c, 1) for c in alone), *together]

    def _course_of_gain(self, points: int):
        """(slope, curvature of ln L by the gain in nepers, time as a share of the recording from its middle) in some blocks."""
        slope, curve = (self.scene.spread(moment) for moment in self.amplitude_moments())
        block = max(1, len(slope) // points)
        n = len(slope) // block * block
        a, e = slope[:n].reshape(-1, block).sum(1), curve[:n].reshape(-1, block).sum(1)
        return a, e, (np.arange(len(a)) + 0.5) * block / self.scene.span - 0.5

    @property
    def hum_bins(self) -> float:
        """Cycles up to which a hum is looked for: supplies switch up to some MHz."""
        return self.scene.span / 16

    def lines(self, count: int) -> list[float]:
        """Cycles over the recording of the strongest lines of the residual that stand out of their surroundings: the
        peaks of a band of noise do not, nor at half the sample rate what interpolation leaves of the signal."""
        span = self.scene.span
        spectrum = np.abs(sp_fft.fft(self.scene.spread(self.recorded), 2 * span))
        around = np.concatenate([np.arange(-VIEW_AROUND, -SKIRT), np.arange(SKIRT + 1, VIEW_AROUND + 1)])
        level = _medians(spectrum, max(1, len(spectrum) // (2 * VIEW_AROUND)))  # which no line changes
        clear = spectrum / np.maximum(level, 1e-12 * level.max()) * (level < np.sqrt(QUIET) * level.max())
        found, strongest, wanted = [], peaks(spectrum, count, 4), None
        for i in dict.fromkeys([*strongest, *peaks(clear, count, 4)]):  # beside a loud band too
            near = (i + around) % len(spectrum)
            beside = np.mean(spectrum[near] ** 2)
            if i not in strongest or at_half_the_rate(i / (2 * span)):  # where a line of the signal may be left
                if wanted is None:
                    wanted = np.abs(sp_fft.fft(self.scene.spread(self.fit.chain.wanted), 2 * span))
                beside = max(beside, np.mean(wanted[near] ** 2))
                if spectrum[i] < UNSIGNED * wanted[(i + np.arange(-SKIRT, SKIRT + 1)) % len(wanted)].max():
                    continue
            if spectrum[i] ** 2 < (np.log(len(spectrum)) + LINE_NATS) * beside:
                continue
            found.append((i if i < span else i - 2 * span) / 2)
        return found

    def stretches(self, count: int) -> np.ndarray:
        """(count + 1,) first samples of so many stretches that are alike long in time, and the end."""
        at, whole = self.scene.at, self.scene.span if self.scene.at is not None else self.scene.count
        edges = np.minimum(np.arange(count + 1) * -(-whole // count), whole)
        return edges if at is None else np.searchsorted(at, edges)

    def correlations(self, code, signal, edges: int | np.ndarray, reach: int | None = None):
        """c[m, d] of `signal` with a waveform at lags d, by segments in time (so many, or between edges in samples); and the
        lags: of a waveform that is sent once those up to `reach`, or those that paths of the twin may have."""
        source = self.scene.sources[code] if isinstance(code, int) else self.scene.extra[code]
        size = len(source.samples)
        if np.ndim(edges) == 0:
            edges = self.stretches(edges)
        segments, lengths = len(edges) - 1, np.diff(edges)
        if source.repeat:
            spectrum = np.conj(sp_fft.fft(source.samples))
            index = self.scene.wrap(size) + np.repeat(np.arange(segments), lengths) * size
            folded = np.bincount(index, signal.real, segments * size) + 1j * np.bincount(index, signal.imag, segments * size)
            c = sp_fft.ifft(sp_fft.fft(folded.reshape(segments, size), axis=1) * spectrum, axis=1)
            return c, np.arange(size)
        last = max(p.delay for p in self.scene.taps)
        low, spread = -64, PAD - 8
        if reach:
            low, spread = -reach, reach
        elif not all(s.known.all() for s in self.scene.sources):
            low, spread = -10, int(last) + 26
        block = sp_fft.next_fast_len(int(lengths.max()) + spread - low)
        c = np.zeros((segments, spread - low), complex)
        for m, begin in enumerate(edges[:-1]):
            piece = signal[begin : edges[m + 1]]
            if not len(piece):
                continue
            first = PAD + begin - spread + 1
            template = source.samples[max(first, 0) : PAD + begin + len(piece) - low]
            if first < 0:
                template = np.concatenate([np.zeros(-first, complex), template])
            # lag d pairs piece[i] with template[i + spread − 1 − d]
            both = sp_fft.ifft(sp_fft.fft(template, block) * np.conj(sp_fft.fft(piece, block)))
            c[m] = np.conj(both[: spread - low][::-1])
        return c, np.arange(low, spread)

    def echoes(self, code, count: int, fastest: float = 0.0) -> list[tuple[float, float, float, float]]:
        """The strongest (delay in samples on the taps' scale, Doppler in cycles, up to `fastest` where the waveform's delays
        leave room, places tried for one that stands still, and up to that Doppler) in which the residual holds the waveform once
        more."""
        source = self.scene.sources[code] if isinstance(code, int) else self.scene.extra[code]
        segments = self._echo_segments(source, fastest)
        c, lags = self.correlations(code, self.residual * np.conj(self.carrier_of(code)), segments)
        spectrum = np.abs(sp_fft.fft(c, 2 * segments, axis=0))
        window = np.sinc(sp_fft.fftfreq(2 * segments) * 1.0)  # loss within a segment
        power = spectrum**2 / np.maximum(window[:, None], 0.6) ** 2
        cycles = sp_fft.fftfreq(2 * segments, 1 / segments)
        # Slow paths are the rule: a place is one of those up to its own Doppler.
        places = len(lags) * np.maximum(4 * np.abs(cycles), 2 * min(segments, ECHO_SEGMENTS))
        nats = power / self._noise_of(source, self.carrier_of(code)) - np.log(places)[:, None]
        found = []
        for _ in range(count):
            k, d = np.unravel_index(int(np.argmax(nats)), nats.shape)
            delay = float(lags[d] - self.fit.model.base[0])
            if source.repeat:
                size = len(source.samples)
                delay = (delay + size / 8) % size - size / 8
            found.append((delay, float(cycles[k]), STILL * len(lags), float(places[k])))
            nats[:, np.abs(lags - lags[d]) <= 2] = -np.inf
        return found

    def _echo_segments(self, source, fastest: float) -> int:
        """How many stretches of time tell a Doppler of up to `fastest` cycles over the recording."""
        if self.scene.count <= 2048:
            return 4
        delays = len(source.samples) if source.repeat else PAD
        most = min(ECHO_CELLS // delays, self.scene.count // LEAST_SEGMENT)
        wanted = 1 << int(np.ceil(np.log2(max(2 * fastest, 1.0))))
        return max(ECHO_SEGMENTS, min(wanted, most))

    def _noise_of(self, source, carrier) -> float:
        """Energy of a correlation of white noise alone with a waveform under a carrier."""
        return self.sigma2 * np.mean(np.abs(source.samples[source.known]) ** 2) * np.sum(self.weight * np.abs(carrier) ** 2)

    def held_late(self, code: int, first: float, last: float) -> float:
        """Standard deviations by which the residual holds more of a waveform, from `first` to `last` samples late on the taps'
        scale, than white noise does."""
        carrier, source = self.carrier_of(code), self.scene.sources[code]
        c, lags = self.correlations(code, self.residual * np.conj(carrier), 1)
        late = lags - self.fit.model.base[0]
        late = late % len(source.samples) if source.repeat else late
        inside = (late >= first) & (late < last)
        if not inside.any():
            return 0.0
        noise = self._noise_of(source, carrier)
        independent = inside.sum() * np.mean(self.scene.occupied)
        return float((np.mean(np.abs(c[0, inside]) ** 2) / noise - 1) * np.sqrt(independent))

    # ------------------------------------------------------------ taps
    def tap_order(self) -> list[int]:
        """The twin's taps that can differ from the rest: all, where a source has more than one or there are
        more sources."""
        taps = self.scene.taps
        return list(range(len(taps))) if len(taps) > 1 else []

    @cached_property
    def tap_signals(self) -> np.ndarray:
        """(taps, n) what each tap of the twin adds to the prediction."""
        chain = type(self.fit.chain)(
            scene=self.scene,
            delay=self.fit.model.base[0],
            ports=self.fit.chain.ports,
            u=self.fit.chain.u,
            shift=self.fit.chain.shift,
            pace=self.fit.chain.pace,
        )
        chain.waves, chain.carriers, chain.modulations = (
            self.fit.chain.waves,
            self.fit.chain.carriers,
            self.fit.chain.modulations,
        )
        out = []
        for k in range(len(self.scene.taps)):
            one = chain.copy()
            one.paths, one.clock = [self.fit.chain.paths[k]], self.fit.chain.clock
            one.run_channel()
            out.append(one.y * self.receiver)
        return np.array(out)

    def tap_shift(self, k: int, reach: int = 24) -> list[float]:
        t = self.tap_signals[k]
        carrier = self.carrier_of(self.scene.taps[k].source)
        total = (self.residual + t * self.weight) * np.conj(carrier) / np.abs(carrier) ** 2
        clean = t / carrier
        size = sp_fft.next_fast_len(len(t) + 64)
        c = np.abs(sp_fft.ifft(sp_fft.fft(total, size) * np.conj(sp_fft.fft(clean, size))))
        near = np.concatenate([c[-reach:], c[: reach + 1]])
        lag = int(np.argmax(near)) - reach
        return [float(lag)] if lag else []

    def tap_lines(self, k: int) -> list[float]:
        t = self.tap_signals[k]
        product = self.scene.spread((self.residual + t * self.weight) * np.conj(t))
        size = 2 * len(product)
        spectrum = np.abs(sp_fft.fft(product, size))
        i = int(np.argmax(spectrum))
        cycles = (i if i < size // 2 else i - size) / 2
        return [cycles] if 0.4 < abs(cycles) < self.scene.span / 64 else []

    # ------------------------------------------------------------ time
    @cached_property
    def fast_taps(self) -> list[int]:
        """Taps whose gain and phase move faster than the courses that are tried of all: more of what is left turns against what
        comes over them so fast than faster still."""
        slowest = course_orders(self.scene)[-1] // 2  # cycles over the recording
        turns = np.abs(sp_fft.fftfreq(self.scene.span)) * self.scene.span / slowest
        fast, beyond, out = (turns > 1) & (turns < FASTEST), (turns > FASTEST) & (turns < 2 * FASTEST), []
        for k, signal in enumerate(self.tap_signals):
            power = np.abs(sp_fft.fft(self.scene.spread(self.residual * np.conj(signal)))) ** 2
            if beyond.any() and power[fast].mean() > FASTER * power[beyond].mean():
                out.append(k)
        return out

    @property
    def course_sizes(self) -> tuple[int, ...]:
        return tuple(s for s in (6, 24, 80) if s < self.scene.count / 100)

    def _wanted_correlations(self, segments: int, reach: int):
        """c[m, d], d from −reach to reach, of the recording with the prediction, carrier taken out of
        both."""
        y = self.fit.came(self.data.y) * self.weight * np.conj(self.carrier)
        clean = self.wanted / np.where(self.carrier == 0, 1, self.carrier)
        n = self.scene.count
        edges = np.linspace(0, n, segments + 1).astype(int)
        padded = np.concatenate([np.zeros(reach), clean, np.zeros(reach)])
        c = np.zeros((segments, 2 * reach + 1), complex)
        for d in range(-reach, reach + 1):
            product = y * np.conj(padded[reach - d : reach - d + n])
            c[:, d + reach] = np.add.reduceat(product, edges[:-1])
        return c

    def timing_drift(self) -> float:
        """Samples that the received waveform gains over the recording, from the lag of its correlation over
        time."""
        reach, segments = 8, 12
        if self.scene.count < 2000:
            return 0.0
        c = np.abs(self._wanted_correlations(segments, reach)) ** 2
        k = np.argmax(c, axis=1)
        weight = c.max(axis=1)
        if not weight.any():  # as where all paths are gone
            return 0.0
        lags = []
        for row, i in zip(c, k, strict=True):
            if 0 < i < 2 * reach:
                a, b, d = row[i - 1 : i + 2]
                lags.append(i - reach + 0.5 * (a - d) / min(a - 2 * b + d, -1e-30))
            else:
                lags.append(float(i - reach))
        u = self.scene.u[((np.arange(segments) + 0.5) * self.scene.count / segments).astype(int)]
        u0 = np.average(u, weights=weight)
        slope = np.sum(weight * (u - u0) * lags) / max(np.sum(weight * (u - u0) ** 2), 1e-300)
        return float(-np.clip(slope, -16, 16))

    def jumps(self, lost_everywhere) -> list[tuple[float, float, bool]]:
        """The likeliest (first sample after the joint, samples lost, whether the delay is that of the later part) and those of
        one more and one less, where a part with a delay of its own makes the recording far likelier.
        `lost_everywhere(samples)` is an effect under which so many are lost from the first one on."""
        if self.lags_over_time is None:
            return []
        edges, lag, c, sent = self.lags_over_time
        now, n, found = int(np.argmin(np.abs(lag))), self.scene.count, []
        for later in (False, True):
            there = slice(None) if later else slice(None, None, -1)  # the part with another delay comes first
            part, energy = np.cumsum(c[there], axis=0), np.cumsum(sent[there], axis=0)
            held = np.abs(part[:-1]) ** 2 / energy[:-1] / self.sigma2
            # With a gain of its own either way: a step of gain is no jump.
            nats = held - np.maximum(held[:, now], np.cumsum(self._explained(edges)[there])[:-1])[:, None]
            m, d = np.unravel_index(int(np.argmax(nats)), nats.shape)
            if nats[m, d] < np.log(nats.size) + VIEW_JUMP_NATS:
                continue
            rest = c[there][m + 1 :, now].sum()
            ahead = -int(lag[d])
            whole = self._periods(ahead, np.angle(part[m, d] * np.conj(rest)))
            first = int(edges[m + 1 if later else len(edges) - m - 2])
            # A delay between two samples hides one.
            for nearby in ((-1 if later else 1) * (ahead + periods + one) for periods in {0, whole} for one in (0, -1, 1)):
                beyond = predict(self.scene, self.fit.model.adding(lost_everywhere(-nearby if later else nearby)))
                joint = self._joint(first, beyond, later)
                found.append((float(self.scene.index[min(joint, n - 1)]), float(nearby), later))
        return found

    def zeros(self, joint: float, lost: float) -> tuple[float, float] | None:
        """(first of them, samples lost, below 0) where zeros were written near a joint, as many as were inserted there if so many
        are lost, to one sample and the waveform's period; None where none were."""
        period = len(self.scene.sources[0].samples) if self.scene.sources[0].repeat else 0
        for first, count in self.written_zeros:
            off = count + lost
            off = (off + period // 2) % period - period // 2 if period else off
            if abs(off) <= 1 and abs(first - joint) <= count + BLANK_APART:
                return first, -count
        return None

    @cached_property
    def written_zeros(self) -> list[tuple[float, float]]:
        """[(first, how many)] zeros that stand in the place of samples."""
        return [(float(self.scene.index[first]), float(end - first)) for first, end in blanks.runs(self.data.y)[:MOST_JUMPS]]

    def steps_of_lag(self) -> tuple[int, list[tuple[float, float]]]:
        """(samples by which the first part is later than the fit has it, [(first sample after a joint, samples lost)]) of the
        parts, each with a delay of its own, that together are likeliest: the best path over lags (Viterbi), a step of which
        costs what it is looked for in."""
        if self.lags_over_time is None:
            return 0, []
        edges, lag, c, sent = self.lags_over_time
        now = int(np.argmin(np.abs(lag)))
        sent = np.maximum(sent, (np.diff(edges) / self.scene.count * sent[:, now].sum())[:, None])  # silence has no delay
        nats, step = np.abs(c) ** 2 / sent / self.sigma2, np.log(c.size) + VIEW_JUMP_NATS
        nats[:, now] = np.maximum(nats[:, now], self._explained(edges))
        best, came = nats[0], []
        for row in nats[1:]:
            top = int(np.argmax(best))
            stays = best >= best[top] - step
            came.append(np.where(stays, np.arange(len(lag)), top))
            best = row + np.where(stays, best, best[top] - step)
        path = [int(np.argmax(best))]
        for back in reversed(came):
            path.append(int(back[path[-1]]))
        late, period = lag[path[::-1]], len(lag) if self.scene.sources[0].repeat else 0
        level, joints, sums = late[0], [], [0.0]
        for m, there in enumerate(late):
            moved = (there - level + period // 2) % period - period // 2 if period else there - level
            if abs(moved) > 1:  # one may be a delay between two samples
                level, joints, sums = there, [*joints, (float(self.scene.index[edges[m]]), float(-moved))], [*sums, 0.0]
            sums[-1] += c[m, path[-1 - m]]
        turned = np.angle(np.array(sums[1:]) * np.conj(sums[:-1]))
        joints = [(at, lost + self._periods(lost, turn)) for (at, lost), turn in zip(joints, turned, strict=True)]
        return (int(late[0]), joints) if len(joints) <= MOST_JUMPS else (0, [])

    def _periods(self, ahead: float, turned: float) -> int:
        """Samples, whole periods of a repeated waveform, that are lost besides `ahead`: the waveform is the same then, and an
        oscillator that goes on meanwhile has `turned` so far (rad)."""
        source, beside = self.scene.sources[0], np.diff(self.scene.index) == 1
        if not source.repeat:
            return 0
        steps = (np.conj(self.carrier[:-1]) * self.carrier[1:])[beside]
        every = np.arange(-MOST_PERIODS, MOST_PERIODS + 1) * len(source.samples)
        off = (np.angle(steps.sum()) * (ahead + every) - turned) / (2 * np.pi)
        return int(every[np.argmin(np.abs(off - np.rint(off)) + PERIOD_CYCLES * np.abs(every) / len(source.samples))])

    @cached_property
    def lags_over_time(self):
        """(edges of segments, lags from where the fit has the link, (segments, lags) correlation of the recording with the link,
        (segments, lags) energy of the link at each lag); None where too little is there."""
        edges = self._edges()
        if len(edges) < 5:
            return None
        heard = self._heard * self.weight * np.conj(self.carrier)
        repeat, gathered = self.scene.sources[0].repeat, self.scene.at is not None
        c, lags = self.correlations(0, heard, edges, reach=None if gathered else LONGEST_JUMP + self._longest)
        # The whole link, not one path: filter along the lags with the twin's taps.
        size = len(lags)
        padded = size if repeat else sp_fft.next_fast_len(size + self._longest)
        c = sp_fft.ifft(sp_fft.fft(c, padded, axis=1) * np.conj(self._response(padded)), axis=1)[:, :size]
        if not repeat and not gathered:  # farther out not all paths were heard
            c, lags = (x[..., self._longest : size - self._longest] for x in (c, lags))
        lag = lags - round(self.fit.model.base[0])
        if repeat:
            lag = (lag + size // 2) % size - size // 2
        sent, ahead = self._energy_at(edges, lags), self._ahead(edges)
        if ahead.any():
            c, sent = (np.stack([np.roll(row, k) for row, k in zip(rows, ahead, strict=True)]) for rows in (c, sent))
        return edges, lag, c, np.maximum(sent, LEAST_SENT * sent.sum(0).max() / self.scene.count * np.diff(edges)[:, None])

    @property
    def _heard(self) -> np.ndarray:
        """The recording before the receiver's inversion without tones and all else that is known beside the wanted signal."""
        return self.fit.came(self.fit.residual + self.fit.chain.wanted)

    def _explained(self, edges: np.ndarray) -> np.ndarray:
        """(segments,) nats that the fit's wanted signal explains in each segment, with the filters that the waveform has not."""
        residual, wanted = self.fit.residual, self.fit.chain.wanted
        explained = (np.abs(residual + wanted) ** 2 - np.abs(residual) ** 2) * self.weight
        return np.add.reduceat(explained, edges[:-1]) / self.sigma2

    @property
    def _near(self) -> list:
        """The paths of the first transmitter's link; of a waveform that is sent once those that are less late than the silence
        that is kept around it."""
        taps = [p for p in self.scene.taps if p.source == 0]
        return taps if self.scene.sources[0].repeat else [p for p in taps if p.delay < PAD]

    def _response(self, size: int) -> np.ndarray:
        """(size,) of the first transmitter's link over the frequencies of as many samples, as the twin has its taps."""
        f = sp_fft.fftfreq(size)
        return sum((p.gain * phasor(-TAU * f * p.delay) for p in self._near), np.zeros(size, complex))

    @property
    def _longest(self) -> int:
        """Samples by which the last of these paths is late, rounded up."""
        return int(np.ceil(max((p.delay for p in self._near), default=0.0)))

    def _energy_at(self, edges: np.ndarray, lags: np.ndarray) -> np.ndarray:
        """(segments, lags) energy of the first transmitter's signal in each segment, were it so late: what is silent there at the
        delay of the fit may be loud at another."""
        source, loud = self.scene.sources[0], np.abs(self.carrier) ** 2 * self.weight
        if source.repeat:
            size = len(source.samples)
            power = np.abs(sp_fft.ifft(sp_fft.fft(source.samples) * self._response(size))) ** 2
            index = self.scene.wrap(size) + np.repeat(np.arange(len(edges) - 1), np.diff(edges)) * size
            folded = np.bincount(index, loud, (len(edges) - 1) * size).reshape(-1, size)
            return np.maximum(sp_fft.irfft(sp_fft.rfft(folded, axis=1) * np.conj(sp_fft.rfft(power)), size, axis=1), 0.0)
        size = sp_fft.next_fast_len(len(source.samples) + self._longest)
        heard = sp_fft.ifft(sp_fft.fft(source.samples, size) * self._response(size))
        total = np.concatenate([[0.0], np.cumsum(np.abs(heard) ** 2)])
        at = np.clip(PAD + edges[:, None] - lags, 0, size)
        return np.diff(total[at], axis=0) * (np.add.reduceat(loud, edges[:-1]) / np.diff(edges))[:, None]

    def _edges(self) -> np.ndarray:
        """Of segments in time in which a jump is looked for: shorter and shorter towards the ends, where it leaves little of
        one part; and the joints that are known."""
        n = self.scene.count
        length = max(-(-n // VIEW_SEGMENTS), LEAST_SEGMENT)
        halves = length >> np.arange(1, int(np.log2(length / LEAST_SEGMENT)) + 1)
        edges = np.concatenate([np.arange(0, n - length // 2, length), [n], halves, n - halves])
        if self.fit.chain.shift is not None:
            edges = np.append(edges, np.flatnonzero(np.diff(self.fit.chain.shift)) + 1)
        return np.unique(edges)

    def _ahead(self, edges: np.ndarray) -> np.ndarray:
        """(segments,) whole samples by which the fit has each segment ahead of its delay: lost, or gained by the clock."""
        middle, chain = (edges[:-1] + edges[1:]) // 2, self.fit.chain
        lost = np.zeros(len(middle)) if chain.shift is None else chain.shift[middle]
        return np.rint(lost + chain.clock * chain.u[middle]).astype(int)

    def _joint(self, guess: int, beyond, later: bool) -> int:
        """The first sample after a joint, to the sample where the noise allows, `beyond` which the prediction is that chain's;
        the delay that the fit gave both parts may be off by most of a sample, and then the guess is anywhere."""
        y, f = self._heard, sp_fft.fftfreq(self.scene.count)
        here, there = sp_fft.fft(self.wanted), sp_fft.fft(self.fit.came(beyond.wanted))
        best = np.inf, guess
        for off in np.arange(-3, 4) / 4:
            turn = phasor(-TAU * f * off)
            w, moved = sp_fft.ifft(here * turn), sp_fft.ifft(there * turn)
            before, after = (moved, w) if later else (w, moved)
            before, after = before * gain_of(y, before, slice(None, guess)), after * gain_of(y, after, slice(guess, None))
            first, second = np.abs(y - before) ** 2 * self.weight, np.abs(y - after) ** 2 * self.weight
            cost = np.concatenate([[0.0], np.cumsum(first - second)]) + second.sum()
            best = min(best, (float(cost.min()), int(np.argmin(cost))))
        return best[1]


def _medians(values: np.ndarray, count: int) -> np.ndarray:
    """(n,) in the place of each value the median of its block, of `count` that are as long as each other but for one value."""
    size, longer = divmod(len(values), count)
    edge = longer * (size + 1)
    blocks = values[:edge].reshape(longer, size + 1), values[edge:].reshape(count - longer, size)
    return np.concatenate([np.repeat(np.median(some, axis=1), some.shape[1]) for some in blocks if len(some)])


def gain_of(y, prediction, inside) -> complex:
    """The complex gain under which a prediction (n,) comes nearest to a recording on the samples `inside`."""
    y, w = y[inside], prediction[inside]
    return complex(np.vdot(w, y)) / max(float(np.vdot(w, w).real), 1e-300)
