# SPDX-License-Identifier: GPL-3.0-or-later
"""Sounding: from a recording and the waveform that was sent to taps, path loss, noise floor and frames over time."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import gammainccinv

from ..core.errors import CastError
from ..core.units import db_from_power
from ..signals.doubts import doubts
from ..signals.recording import Recording
from ..signals.waveform import Waveform
from .carrier import NO_OFFSET, CarrierOffset, find_beyond, find_offset, find_offset_once
from .cir import DB_PER_NEPER, FLOAT32_ROUNDING, Taps, estimate_taps
from .correlate import Template
from .doppler import Doppler, tap_doppler
from .jumps import code_jumps, is_steady, longest_run
from .receive import Periods, clipped_fraction, contiguous_runs, remove_offset, whole_periods

MAX_SPREAD_S = 5.12e-6  # excess delay that a Colosseum scenario may have (512 taps of 10 ns)
CARRIER_TOLERANCE_PPM = 10.0  # of two free-running radios together
MIN_OFFSET_SEARCH_HZ = 25e3
_DOPPLER_BLOCKS = 64  # at least, where there are as many periods: taps may turn faster than the strongest path
_TRACKS, _TRACKED, _TRACK_BLOCKS = 16, 1e-3, 512  # delays looked at for movement, down to −30 dB, in so many blocks
_MOVES_SIGMA = 5.0  # standard deviations by which a tap must turn otherwise than the strongest one
_HALF = 0.5  # share of what repeats with the code, beyond which taps that leave it unexplained are doubted
INTERPOLATED = 10**-9.3  # power of the error, over the signal's, of the emulator's filters within their band
INTERPOLATED_SPUR = 10 ** (-101.5 / 20)  # amplitude that they leave 15 samples off a tap, at most: half-way between samples


@dataclass(frozen=True, kw_only=True)
class LinkBudget:
    """What lies between the samples and the antennas, all in dB or dBm; the zero defaults leave path gain as it is."""

    tx_power_dbm: float = 0.0  # at full scale and 0 dB of transmit gain
    tx_gain_db: float = 0.0
    rx_gain_db: float = 0.0
    rx_full_scale_dbm: float = 0.0  # at 0 dB of receive gain
    base_loss_db: float = 0.0  # of the emulator or the cables, not of the scenario

    def path_loss_db(self, path_gain_db):
        """Loss of the channel for a gain between transmitted and received samples."""
        sent_dbm = self.tx_power_dbm + self.tx_gain_db
        received_dbm = path_gain_db + self.rx_full_scale_dbm - self.rx_gain_db
        return sent_dbm - received_dbm - self.base_loss_db


@dataclass(frozen=True, kw_only=True)
class SoundingOptions:
    """How a recording is sounded. `average`: code periods per frame, 0 chooses; offsets in Hz, spread in seconds.

    A carrier offset that is known (0 between radios on one clock) is taken as it is, and what turns beyond it is Doppler. `band`:
    share of the recording's band, in the middle, that a repeated waveform is looked at in, for filters may end before it does.
    """

    average: int = 0
    false_alarm_rate: float = 1e-3
    max_taps: int = 32
    max_offset_hz: float | None = None
    correct_offset: bool = True
    carrier_offset_hz: float | None = None
    max_spread_s: float = MAX_SPREAD_S
    band: float = 1.0
    budget: LinkBudget = field(default_factory=LinkBudget)

    def __post_init__(self):
        if self.average < 0:
            raise CastError(f"average: got {self.average} periods, needs 1 or more (0 chooses)")
        if not 0 < self.false_alarm_rate < 0.5:
            raise CastError(f"false alarm rate: got {self.false_alarm_rate} per CIR, needs more than 0 and less than 0.5")
        if not 1 <= self.max_taps <= 512:
            raise CastError(f"max taps: got {self.max_taps}, needs 1 to 512")
        if self.max_offset_hz is not None and not 0 <= self.max_offset_hz < np.inf:
            raise CastError(f"max offset: got {self.max_offset_hz} Hz, needs a finite number, 0 or more")
        if self.carrier_offset_hz is not None and not np.isfinite(self.carrier_offset_hz):
            raise CastError(f"carrier offset: got {self.carrier_offset_hz} Hz, needs a finite number")
        if not 0 < self.band <= 1:
            raise CastError(f"band: got {self.band}, needs more than 0 and at most 1 (all of it)")
        if not 0 < self.max_spread_s < np.inf:
            raise CastError(f"max spread: got {self.max_spread_s} s, needs a finite number above 0")


@dataclass(frozen=True, kw_only=True)
class Sounding:
    """What was measured. Frames are rows: `frame_gain` (frames, taps) complex; power and gains in linear units."""

    sample_rate_hz: float
    taps: Taps
    doppler: tuple[Doppler | None, ...]  # of every tap beyond the carrier offset, cycles per sample
    offset: CarrierOffset
    noise_power: float  # per complex sample, full scale 1
    period_samples: int
    periods_per_frame: int
    frame_time_s: np.ndarray
    frame_gain: np.ndarray
    frame_power: np.ndarray  # (frames,) in the waveform's band, noise bias removed
    frame_detected: np.ndarray
    response: np.ndarray  # complex CIR on whole samples from `response_start`, for the picture
    residual_response: np.ndarray  # the same after the taps are taken out
    response_noise_power: float
    response_start: int
    path_gain_db: float | None  # of the power in the waveform's band
    path_gain_std_db: float | None
    tap_sum_db: float | None  # sum of |tap|^2: another figure where taps are not whole samples apart
    path_loss_db: float | None
    smallest_path_gain_db: float  # a weaker single tap would be missed
    residual_db: float  # power that the taps leave unexplained, over the power received; noise counts
    gaps: tuple[tuple[float, int], ...]  # (time of the file in s, samples lost there)
    jumps: tuple[tuple[float, int], ...]  # (time in s, samples by which the code comes later from there on)
    warnings: tuple[str, ...]

    @property
    def frames(self) -> int:
        return len(self.frame_time_s)

    @property
    def blocks(self) -> int:
        """Stretches with gains of their own that the recording was sounded in: more than one where the channel moves."""
        return self.taps.gain.shape[1]

    @property
    def is_moving(self) -> bool:
        """Whether the channel changes so much that one mean over the recording would lose power of some tap."""
        return self.blocks > 1


def sound(recording: Recording, waveform: Waveform, options: SoundingOptions | None = None) -> Sounding:
    """Sound one recording of one known waveform. Raises CastError where the recording cannot hold it."""
    options = options or SoundingOptions()
    if recording.sample_rate_hz is None:
        raise CastError("recording: sample rate: missing from the metadata, needs a rate in Hz")
    rate = waveform.sample_rate_hz
    if rate is not None and abs(rate / recording.sample_rate_hz - 1) > 1e-9:
        raise CastError(
            f"{waveform.name}: sample rate: got {rate:g} Hz, the recording has {recording.sample_rate_hz:g} Hz; resample one"
        )
    if not np.any(recording.samples):
        raise CastError("recording: every sample is zero")
    if waveform.repeat:
        if not np.isfinite(waveform.samples).all():
            raise CastError(f"{waveform.name}: a repeated waveform needs all its samples known; it holds NaN")
        return _sound_periodic(recording, waveform, options)
    return _sound_once(recording, waveform, options)


def _refuse_a_tone(template: Template, waveform: Waveform) -> None:
    if template.rms_bandwidth_rad < 1e-6:
        raise CastError(f"{waveform.name}: a tone or a constant has no bandwidth: no delay can be read from it")


def _max_offset(recording: Recording, options: SoundingOptions) -> float:
    """Largest carrier offset to search, cycles per sample."""
    if not options.correct_offset:
        return 0.0
    carrier_hz = recording.center_frequency_hz or 0.0
    expected = max(MIN_OFFSET_SEARCH_HZ, CARRIER_TOLERANCE_PPM * 1e-6 * abs(carrier_hz))
    wanted = expected if options.max_offset_hz is None else options.max_offset_hz
    return min(wanted / recording.sample_rate_hz, 0.5)


def _noise_of_differences(samples: np.ndarray) -> float | None:
    """Noise power from second differences of periods: what turns steadily cancels too. None for fewer than four periods.

    The median over them, so that a switch-on or a burst does not count; for n samples it is 1 − 1/(3n) of the mean.
    """
    on = samples[np.any(samples, axis=1)]  # digital silence is no noise
    if len(on) < 4:
        return None
    second = np.mean(np.abs(on[:-2] - 2 * on[1:-1] + on[2:]) ** 2, axis=1) / 6
    rounding = FLOAT32_ROUNDING * float(np.mean(np.abs(samples) ** 2))
    return max(float(np.median(second) / (1 - 1 / (3 * samples.shape[1]))), rounding)


def _coherent_blocks(tracks: np.ndarray, noise: float) -> int:
    """The fewest blocks whose coherent means keep 99 % of the power of each of `tracks` (periods, delays) in noise."""
    power = np.mean(np.abs(tracks) ** 2, axis=0) - noise
    chance = _MOVES_SIGMA * noise / np.sqrt(len(tracks))
    tracks, power = tracks[:, power > chance], power[power > chance]
    count = 1
    while count < len(tracks):
        kept = np.mean(np.abs(_block_means(tracks, count)) ** 2, axis=1) - noise * count / len(tracks)
        if (kept > 0.99 * power - chance).all():
            break
        count *= 2
    return min(count, len(tracks))


def _block_means(samples: np.ndarray, count: int) -> np.ndarray:
    """Means over `count` equal blocks of periods: (window, count) complex128."""
    size = len(samples) // count
    return samples[: size * count].reshape(count, size, -1).mean(axis=1, dtype=np.complex128).T


def _sound_periodic(recording: Recording, waveform: Waveform, options: SoundingOptions) -> Sounding:
    length = len(waveform.samples)
    periods = whole_periods(recording, length)
    count = len(periods.samples)
    average = options.average or max(1, count // 1500)
    if average > count:
        raise CastError(f"average: got {average} periods, the recording holds {count} whole ones")
    if not np.any(periods.samples):
        raise CastError("recording: every sample of its whole periods is zero")
    template = Template(waveform.samples, band=options.band)
    _refuse_a_tone(template, waveform)
    samples, offset = _without_offset(periods, template, recording, options)
    jumps = [] if is_steady(_delay_profiles(samples, template)) else code_jumps(samples, template)
    if jumps:
        run = longest_run(jumps, count)
        jumps = [(periods.start_sample[k] / recording.sample_rate_hz, shift) for k, shift in jumps]
        periods = Periods(samples=periods.samples[run], start_sample=periods.start_sample[run])
        count, average = len(periods.samples), min(average, len(periods.samples))
        samples, offset = _without_offset(periods, template, recording, options)

    noise = _noise_of_differences(samples)
    tracks = _tracks(samples, template)
    blocks = 1 if noise is None else _coherent_blocks(tracks, noise / template.energy)
    observed = _block_means(samples, blocks)
    taps = estimate_taps(
        observed,
        template,
        noise_variance=None if noise is None else noise / (count // blocks) + _least_noise(observed, options),
        noise_freedom=np.inf if noise is None else length * (count - 2) / 1.94,  # differences share their periods
        false_alarm_rate=options.false_alarm_rate,
        max_taps=options.max_taps,
        spur=INTERPOLATED_SPUR if options.band < 1 else 0.0,
    )
    unexplained = _unexplained(observed, template, taps)
    searches = options.correct_offset and not offset.known
    if searches and unexplained > _HALF and (beyond := find_beyond(samples, template)) is not None:
        _refuse_beyond(offset, beyond, recording, options)
    noise = taps.noise_variance * (count // blocks) if noise is None else noise
    doppler = _dopplers(samples, periods.start_sample, template, taps, noise, min(count, max(4 * blocks, _DOPPLER_BLOCKS)))

    frames = count // average
    frame_samples = _block_means(samples[: frames * average], frames)
    warnings = _jump_warnings(jumps, count * length / recording.sample_rate_hz) + _carrier_warnings(offset, recording, options)
    if len(taps.delay_samples) and unexplained > _HALF:
        warnings.append(
            f"the taps explain {100 * (1 - unexplained):.2g} % of what repeats with the code: is the code the one that was sent, "
            "the carrier within the range searched (--max-offset HZ)?"
        )
    if length / recording.sample_rate_hz < options.max_spread_s * (1 - 1e-9):
        warnings.append(
            f"code shorter than the channel's spread: one period lasts {length / recording.sample_rate_hz * 1e6:.4g} µs, "
            f"delays up to {options.max_spread_s * 1e6:.4g} µs alias; take a longer code"
        )
    if average > 1 and len(taps.delay_samples):
        loss_db = _averaging_loss_db(tracks[:, 0], average, noise / template.energy)
        if loss_db > 0.1:
            warnings.append(
                f"averaging {average} periods loses {loss_db:.1f} dB: the carrier or the channel turns within a frame; "
                "average fewer"
            )
    return _result(
        recording,
        options,
        template=template,
        taps=taps,
        doppler=doppler,
        offset=offset,
        noise_power=noise,
        periods_per_frame=average,
        frame_time_s=periods.start_sample[: frames * average : average] / recording.sample_rate_hz,
        frame_samples=frame_samples,
        observed=observed,
        warnings=warnings,
        jumps=jumps,
    )


def _unexplained(observed: np.ndarray, template: Template, taps: Taps) -> float:
    """Share of the power over the noise in blocks `observed` (window, blocks) that the taps leave; 1 without taps."""
    noise = taps.noise_variance
    heard = np.mean(np.abs(observed) ** 2) - noise
    rest = np.mean(np.abs(observed - template.columns(taps.delay_samples) @ taps.gain) ** 2) - noise
    return float(np.clip(rest / heard, 0.0, 1.0)) if len(taps.delay_samples) and heard > 0 else 1.0


def _refuse_beyond(offset: CarrierOffset, beyond: float, recording: Recording, options: SoundingOptions) -> None:
    rate = recording.sample_rate_hz
    searched_hz, found_hz = _max_offset(recording, options) * rate, (offset.cycles_per_sample + beyond) * rate
    raise CastError(
        f"carrier offset: not within ±{searched_hz:.6g} Hz, which was searched; the code stands out at about {found_hz:.6g} Hz: "
        f"add --max-offset {1.05 * abs(found_hz):.3g}"
    )


def _without_offset(periods: Periods, template: Template, recording: Recording, options: SoundingOptions):
    """(samples of the periods, their carrier offset, which is taken out of them)."""
    if options.carrier_offset_hz is not None and options.correct_offset:
        cycles = options.carrier_offset_hz / recording.sample_rate_hz
        known = CarrierOffset(cycles_per_sample=cycles, std_cycles_per_sample=0.0, found=True, searched=np.inf, known=True)
        return remove_offset(periods.samples, cycles, periods.start_sample), known
    offset = find_offset(periods, template, max_offset=_max_offset(recording, options)) if options.correct_offset else NO_OFFSET
    return remove_offset(periods.samples, offset.cycles_per_sample, periods.start_sample), offset


def _dopplers(
    samples: np.ndarray, start: np.ndarray, template: Template, taps: Taps, noise: float, blocks: int
) -> tuple[Doppler | None, ...]:
    """Doppler of every tap from its gains in short blocks of periods, which begin at samples `start` (periods,)."""
    rows = np.linalg.pinv(template.columns(taps.delay_samples))
    size = len(samples) // blocks
    time = start[: size * blocks].reshape(blocks, size).mean(axis=1)
    variance = noise / size * np.sum(np.abs(rows) ** 2, axis=1)
    return tuple(
        tap_doppler(track, power, time) for track, power in zip(rows @ _block_means(samples, blocks), variance, strict=True)
    )


def _jump_warnings(jumps: list[tuple[float, int]], kept_s: float) -> list[str]:
    if not jumps:
        return []
    (time_s, shift), more = jumps[0], f", and {len(jumps) - 1} times more" if len(jumps) > 1 else ""
    return [
        f"the code jumps by {shift:+d} samples at {time_s:.6g} s{more}: did the transmitter run out of samples? "
        f"Sounded the longest stretch without a jump, {kept_s:.4g} s"
    ]


def _least_noise(observed: np.ndarray, options: SoundingOptions) -> float:
    """Noise power that no averaging takes away: what interpolating filters leave in the band."""
    return INTERPOLATED * float(np.mean(np.abs(observed) ** 2)) if options.band < 1 else 0.0


def _delay_profiles(samples: np.ndarray, template: Template, blocks: int = 64) -> np.ndarray:
    """Power at every delay in up to `blocks` blocks of periods, (delays, blocks)."""
    return np.abs(template.matched_filter(_block_means(samples, min(len(samples), blocks)))) ** 2


def _tracks(samples: np.ndarray, template: Template) -> np.ndarray:
    """Complex response of every period at the strongest delays, the strongest first, (periods, delays)."""
    power = _delay_profiles(samples, template, _TRACK_BLOCKS).sum(axis=1)
    delays = np.argsort(-power)[:_TRACKS]
    delays = delays[power[delays] > _TRACKED * power[delays[0]]]
    return samples @ np.conj(template.columns(delays)) / template.energy


def _averaging_loss_db(track: np.ndarray, average: int, noise: float) -> float:
    """Power that the coherent mean over `average` periods loses, noise taken off both sides."""
    frames = track[: len(track) // average * average].reshape(-1, average)
    power = np.mean(np.abs(frames) ** 2) - noise
    kept = np.mean(np.abs(frames.mean(axis=1)) ** 2) - noise / average
    return float(-db_from_power(kept / power)) if power > 5 * noise / np.sqrt(frames.size) and kept > 0 else 0.0


def _sound_once(recording: Recording, waveform: Waveform, options: SoundingOptions) -> Sounding:
    first, end = _longest_known_run(waveform.samples)
    known = waveform.samples[first:end]
    _refuse_a_tone(Template(known), waveform)
    # Across a gap nothing is coherent with a waveform sent once: the longest run without one is sounded.
    begin, stop, lost = max(contiguous_runs(recording), key=lambda run: run[1] - run[0])
    samples = recording.samples[begin:stop]
    offset, start = find_offset_once(samples, known, max_offset=_max_offset(recording, options))
    # Delays from a quarter of the spread before the strongest path to the spread after it are searched. Only samples
    # take part that no unknown part of the waveform reaches over any of them.
    spread = int(min(np.ceil(options.max_spread_s * recording.sample_rate_hz), len(known) // 4))
    early = spread // 4
    low = start - early if first == 0 else start + spread
    high = start + len(known) + (spread if end == len(waveform.samples) else -early)
    low, high = max(0, low), min(len(samples), high)
    if high - low < 16:
        raise CastError(f"recording: {max(high - low, 0)} samples meet known samples of {waveform.name}, needs 16 or more")
    window = remove_offset(samples[low:high], offset.cycles_per_sample, begin + lost + low)
    lead = start - early - low  # window sample that delay 0 puts known[0] at
    padded = np.concatenate([np.zeros(max(lead, 0)), known])
    template = Template(padded, circular=False, window=high - low, skip=max(-lead, 0))
    searched = early + spread + 1
    taps = estimate_taps(
        window,
        template,
        false_alarm_rate=options.false_alarm_rate,
        max_taps=options.max_taps,
        delays_searched=searched,
    )
    return _result(
        recording,
        options,
        template=template,
        taps=taps,
        offset=offset,
        noise_power=taps.noise_variance,
        periods_per_frame=1,
        frame_time_s=np.array([(begin + lost + low) / recording.sample_rate_hz]),
        frame_samples=window[:, None],
        observed=window[:, None],
        searched=searched,
        response_start=begin + lost + start - early - first,
        warnings=_carrier_warnings(offset, recording, options),
    )


def _result(
    recording, options, *, template, taps, offset, noise_power, periods_per_frame, frame_time_s, frame_samples, observed,
    warnings, searched=None, response_start=0, jumps=(), doppler=None,
) -> Sounding:  # fmt: skip
    """What periodic and sent-once sounding share: frames at the found delays, path gain and loss, warnings."""
    columns = template.columns(taps.delay_samples)
    found = len(taps.delay_samples)
    frames = len(frame_time_s)
    frame_gain = np.linalg.lstsq(columns, frame_samples, rcond=None)[0].T if found else np.empty((frames, 0), complex)
    explained = columns @ frame_gain.T
    frame_noise = noise_power / periods_per_frame
    detected = np.zeros(frames, bool)
    if found:  # the energy along the taps is a χ² variable when there is noise alone
        energy = np.sum(np.abs(explained) ** 2, axis=0)
        detected = energy > frame_noise * gammainccinv(found, options.false_alarm_rate)
    gram = template.gram(taps.delay_samples)
    blocks = taps.gain.shape[1]
    scatter = gram @ np.linalg.pinv(columns.conj().T @ columns)  # times the noise, what it puts on top of gᴴGg is the trace
    bias = float(np.trace(scatter).real)
    power = _in_band(taps.gain.T, gram).mean() - taps.noise_variance * bias * (blocks > 1) if found else 0.0
    power = max(power, taps.noise_variance * bias)
    power_std = np.sqrt(2 * taps.noise_variance * _in_band(taps.gain.T, scatter @ gram).mean() / blocks) if found else 0.0
    gain_db = float(db_from_power(power)) if found else None
    # Phases are those at the first sample: an offset that is a little off turns them from the middle of the recording on.
    middle = frame_time_s.mean() * recording.sample_rate_hz + len(frame_samples) / 2
    turned_rad = 2 * np.pi * offset.std_cycles_per_sample * middle if offset.cycles_per_sample else 0.0
    residual = np.sum(np.abs(frame_samples - explained) ** 2) / np.sum(np.abs(frame_samples) ** 2)
    return Sounding(
        sample_rate_hz=recording.sample_rate_hz,
        taps=replace(
            taps, delay_samples=taps.delay_samples + response_start, phase_std_rad=np.hypot(taps.phase_std_rad, turned_rad)
        ),
        doppler=doppler if doppler is not None else (None,) * found,
        offset=offset,
        noise_power=noise_power,
        period_samples=template.window if template.circular else len(frame_samples),
        periods_per_frame=periods_per_frame,
        frame_time_s=frame_time_s,
        frame_gain=frame_gain,
        frame_power=_in_band(frame_gain, gram) - bias * frame_noise,
        frame_detected=detected,
        response=_response(template, observed)[:searched],
        residual_response=_response(template, observed - columns @ taps.gain)[:searched],
        response_noise_power=taps.noise_variance / template.energy,
        response_start=response_start,
        path_gain_db=gain_db,
        path_gain_std_db=float(DB_PER_NEPER / 2 * power_std / power) if found else None,
        tap_sum_db=float(db_from_power(taps.power.sum())) if found else None,
        path_loss_db=None if gain_db is None else float(options.budget.path_loss_db(gain_db)),
        smallest_path_gain_db=float(db_from_power(taps.smallest_power)),
        residual_db=float(db_from_power(max(residual, 1e-30))),
        gaps=tuple((start / recording.sample_rate_hz, lost) for start, lost in recording.gaps),
        jumps=tuple(jumps),
        warnings=tuple(_recording_warnings(recording) + warnings + _tap_warnings(taps, options, detected)),
    )


def _in_band(gain: np.ndarray, gram: np.ndarray) -> np.ndarray:
    """Power in the band through taps `gain` (n, k), (n,)."""
    return np.einsum("np,pq,nq->n", gain.conj(), gram, gain, optimize=True).real


def _response(template: Template, observed: np.ndarray) -> np.ndarray:
    """CIR on whole samples; of several blocks the rms, which has no phase."""
    response = template.matched_filter(observed) / template.energy
    return response[:, 0] if observed.shape[1] == 1 else np.sqrt(np.mean(np.abs(response) ** 2, axis=1))


def _carrier_warnings(offset: CarrierOffset, recording: Recording, options: SoundingOptions) -> list[str]:
    searched_hz = _max_offset(recording, options) * recording.sample_rate_hz
    reached_hz = offset.searched * recording.sample_rate_hz
    if reached_hz < 0.99 * searched_hz:
        return [f"carrier offset searched to ±{reached_hz:.3g} Hz, not ±{searched_hz:.3g} Hz: the waveform is too long for more"]
    return []


def _recording_warnings(recording: Recording) -> list[str]:
    warnings = doubts(recording)
    clipped = clipped_fraction(recording.samples, recording.datatype)
    if clipped:
        warnings.append(f"clipping: {100 * clipped:.2g} % of the samples sit at the largest value; lower the receive gain")
    if recording.gaps:
        lost = sum(count for _, count in recording.gaps)
        first_s = recording.gaps[0][0] / recording.sample_rate_hz
        warnings.append(f"{len(recording.gaps)} gaps, {lost} samples lost, the first at {first_s:.6g} s of the file")
    return warnings


def _tap_warnings(taps: Taps, options: SoundingOptions, detected: np.ndarray) -> list[str]:
    if len(taps.delay_samples) == 0:
        return ["no signal: nothing above the noise at the stated false-alarm rate"]
    warnings = []
    if len(taps.delay_samples) >= options.max_taps:
        warnings.append(f"more taps than the {options.max_taps} that --max-taps allows are above the noise")
    missing = int(np.sum(~detected))
    if missing:
        warnings.append(f"{missing} of {len(detected)} frames are missing: nothing above the noise in them")
    return warnings


def _longest_known_run(samples: np.ndarray) -> tuple[int, int]:
    """(first, end) of the longest stretch without NaN."""
    edges = np.diff(np.concatenate([[0], np.isfinite(samples).astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    longest = int(np.argmax(ends - starts))
    return int(starts[longest]), int(ends[longest])
