# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel emulator in NumPy: y_j[n] = Σ_i Σ_d h_ij[n, d] · x_i[n − d].

Slow, double precision, and written to be read: `gr_cast.blocks.channel_emulator` must equal it.
"""

from collections.abc import Container, Iterable
from dataclasses import dataclass, replace

import numpy as np

from gr_cast.core.errors import CastError
from gr_cast.core.units import amplitude_from_db
from gr_cast.scenario.model import GRID_TAPS, MAX_DELAY_S, Scenario, base_loss_db

# The filter that stands for a tap between two samples: its length, and the share of the band it is right in.
INTERPOLATOR_TAPS = 28
INTERPOLATOR_BAND = 0.8


@dataclass(frozen=True, kw_only=True)
class LinkUpdate:
    """A change of the link from transmitter `tx` to receiver `rx`, in force from `at_sample` on.

    `taps[d]` is the complex gain at a delay of d samples; None leaves the taps as they are. With
    `ramp_samples` the taps move in a straight line and arrive that many samples later. `enabled` switches
    the link, `base_loss_db` is the link's loss on top of its taps; None leaves them.
    """

    tx: int
    rx: int
    at_sample: int = 0
    taps: np.ndarray | None = None
    enabled: bool | None = None
    base_loss_db: float | None = None
    ramp_samples: int = 0

    def __post_init__(self):
        where = f"update of link {self.tx}>{self.rx}"
        if min(self.tx, self.rx, self.at_sample, self.ramp_samples) < 0:
            raise CastError(f"{where}: a node, sample or ramp below 0")
        if self.taps is not None:
            taps = np.asarray(self.taps, dtype=complex)
            if taps.ndim != 1 or not np.all(np.isfinite(taps)):
                raise CastError(f"{where}: taps: expected finite complex gains, one per delay")
            object.__setattr__(self, "taps", taps)


@dataclass(frozen=True, kw_only=True)
class FixedPoint:
    """Arithmetic of a fixed-point machine, in two's complement.

    Samples in and out have `bits` and saturate at their full scale, taps have `tap_bits` and saturate at 2
    (so that a tap of 1 is exact).
    """

    bits: int = 16
    tap_bits: int = 16
    input_full_scale: float = 1.0
    output_full_scale: float = 1.0

    def __post_init__(self):
        if not (2 <= self.bits <= 24 and 2 <= self.tap_bits <= 24):
            raise CastError(f"fixed point: got {self.bits} and {self.tap_bits} bits, limit 2 to 24")
        if not (0 < self.input_full_scale < np.inf and 0 < self.output_full_scale < np.inf):
            raise CastError("fixed point: a full scale is not a finite number above 0")


def quantize(values: np.ndarray, full_scale: float, bits: int) -> np.ndarray:
    """Both parts of complex `values` at the nearest step of full_scale / 2^(bits-1), saturated; 0 for what is no number."""
    levels = 2 ** (bits - 1)
    parts = np.stack([np.real(values), np.imag(values)]) * (levels / full_scale)
    held = np.where(np.isnan(parts), 0, np.clip(np.rint(parts), -levels, levels - 1))
    real, imag = held * (full_scale / levels)
    return real + 1j * imag


def sqnr_db(input_power: float, taps: Iterable[complex], fixed_point: FixedPoint) -> float:
    """Signal over quantisation noise at a receiver, in dB: one link of `taps`, white input of `input_power`.

    Every rounding adds step^2/12 per part (Widrow); the taps' own roundings multiply the signal.
    """
    taps = np.asarray(list(taps))
    step_in = fixed_point.input_full_scale / 2 ** (fixed_point.bits - 1)
    step_out = fixed_point.output_full_scale / 2 ** (fixed_point.bits - 1)
    tap_error = np.sum(np.abs(quantize(taps, 2.0, fixed_point.tap_bits) - taps) ** 2)
    gain = np.sum(np.abs(taps) ** 2)
    noise = gain * step_in**2 / 6 + step_out**2 / 6 + input_power * tap_error
    return float(10 * np.log10(gain * input_power / noise))


def receiver_noise(seed: int, receiver: int, n_samples: int, first_sample: int = 0) -> np.ndarray:
    """Circular Gaussian noise of unit power, complex, (n_samples,): the block's, in double precision.

    Philox4x32-10 (Salmon et al., "Parallel random numbers", SC11) keyed by the seed and counted by pairs of
    samples, then Box-Muller: a sample's noise depends on nothing but seed, receiver and its number.
    """
    begin, end = first_sample // 2, (first_sample + n_samples + 1) // 2
    pair = np.arange(begin, end, dtype=np.uint64)
    low = np.uint64(0xFFFFFFFF)
    half = np.uint64(32)
    c = [pair & low, pair >> half, np.full_like(pair, receiver), np.zeros_like(pair)]
    key = [seed & 0xFFFFFFFF, seed >> 32]
    for _ in range(10):
        a, b = np.uint64(0xD2511F53) * c[0], np.uint64(0xCD9E8D57) * c[2]
        k0, k1 = np.uint64(key[0]), np.uint64(key[1])
        c = [(b >> half) ^ c[1] ^ k0, b & low, (a >> half) ^ c[3] ^ k1, a & low]
        key = [(key[0] + 0x9E3779B9) & 0xFFFFFFFF, (key[1] + 0xBB67AE85) & 0xFFFFFFFF]
    uniform = [((word >> np.uint64(8)) + 0.5) / 2**24 for word in (c[0], c[2])]
    turn = [word / 2**32 for word in (c[1], c[3])]
    pairs = [np.sqrt(-np.log(u)) * np.exp(2j * np.pi * t) for u, t in zip(uniform, turn, strict=True)]
    samples = np.stack(pairs, axis=1).ravel()
    return samples[first_sample - 2 * begin :][:n_samples]


def noise_power_from_snr(snr_db: float, reference_power: float) -> float:
    """Noise power that is `snr_db` below `reference_power`, both in units of the samples squared."""
    return reference_power * 10 ** (-snr_db / 10)


def link_taps(updates: Iterable[LinkUpdate], n_samples: int) -> tuple[np.ndarray, np.ndarray]:
    """One link's delays in samples, shape (P,), and its taps at every sample, (n_samples, P).

    `updates` are all of that link; those of one sample take force in the order given. Until the first the
    link is on, without a tap.
    """
    updates = sorted(updates, key=lambda update: update.at_sample)
    used = [np.flatnonzero(update.taps) for update in updates if update.taps is not None]
    delays = np.unique(np.concatenate(used)) if used else np.zeros(0, int)
    taps = np.zeros((n_samples, len(delays)), dtype=complex)
    enabled = np.ones(n_samples, dtype=bool)
    gain = np.ones(n_samples)
    begin, length = 0, 0
    start = target = np.zeros(len(delays), dtype=complex)
    for update in updates:
        if update.enabled is not None:
            enabled[update.at_sample :] = update.enabled
        if update.base_loss_db is not None:
            gain[update.at_sample :] = amplitude_from_db(-update.base_loss_db)
        if update.taps is None or update.at_sample >= n_samples:
            continue
        done = min((update.at_sample - begin) / length, 1) if length else 1
        start = start + (target - start) * done  # an update in mid-ramp starts from there
        target = np.array([update.taps[d] if d < len(update.taps) else 0 for d in delays])
        begin, length = update.at_sample, update.ramp_samples
        progress = np.minimum((np.arange(begin, n_samples) - begin + (not length)) / max(length, 1), 1)
        taps[begin:] = start + (target - start) * progress[:, None]
    return delays, taps * (enabled * gain)[:, None]


def emulate(
    inputs: np.ndarray,
    updates: Iterable[LinkUpdate],
    n_outputs: int,
    *,
    noise_power: Iterable[float] = (),
    seed: int = 0,
    fixed_point: FixedPoint | None = None,
) -> np.ndarray:
    """What every receiver gets: (transmitters, samples) complex in, (receivers, samples) complex out.

    Before the first sample the inputs are zero. `noise_power` is one per receiver, in units of the samples
    squared. Raises CastError where an update names an absent node.
    Source: y_j = Σ_i x_i * h_ij, "Colosseum as a Digital Twin", IEEE TMC 2024.
    """
    inputs = np.atleast_2d(np.asarray(inputs, dtype=complex))
    n_inputs, n_samples = inputs.shape
    if fixed_point:
        inputs = quantize(inputs, fixed_point.input_full_scale, fixed_point.bits)
    outputs = np.zeros((n_outputs, n_samples), dtype=complex)
    links: dict[tuple[int, int], list[LinkUpdate]] = {}
    for update in updates:
        if update.tx >= n_inputs or update.rx >= n_outputs:
            raise CastError(
                f"update of link {update.tx}>{update.rx}: the network has {n_inputs} transmitters and {n_outputs} receivers"
            )
        if fixed_point and update.taps is not None:
            update = replace(update, taps=quantize(update.taps, 2.0, fixed_point.tap_bits))
        links.setdefault((update.tx, update.rx), []).append(update)
    for (tx, rx), changes in links.items():
        for delay, gain in zip(*map(np.transpose, link_taps(changes, n_samples)), strict=True):
            outputs[rx, delay:] += gain[delay:] * inputs[tx, : max(n_samples - delay, 0)]
    for rx, power in enumerate(noise_power):
        outputs[rx] += np.sqrt(power) * receiver_noise(seed, rx, n_samples)
    if fixed_point:
        outputs = quantize(outputs, fixed_point.output_full_scale, fixed_point.bits)
    return outputs


def interpolator(fraction: float) -> np.ndarray:
    """Filter, (INTERPOLATOR_TAPS,), that delays by INTERPOLATOR_TAPS/2 - 1 + fraction samples.

    Least squares over INTERPOLATOR_BAND of the band (Laakso et al., "Splitting the unit delay", 1996):
    P h = p with P[k, l] = a sinc(a (k - l)), p[k] = a sinc(a (k - delay)), a the share of the band.
    """
    k = np.arange(INTERPOLATOR_TAPS)
    delay = INTERPOLATOR_TAPS / 2 - 1 + fraction
    band = INTERPOLATOR_BAND
    # A trace of stop band: the band alone leaves the solution nearly free.
    matrix = band * np.sinc(band * (k[:, None] - k)) + 1e-9 * np.eye(INTERPOLATOR_TAPS)
    return np.linalg.solve(matrix, band * np.sinc(band * (k - delay)))


def split_delay(delay_samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whole samples and the fraction left of each delay; a millionth of a sample counts as none."""
    whole = np.rint(delay_samples)
    on_grid = np.abs(delay_samples - whole) < 1e-6
    whole = np.where(on_grid, whole, np.floor(delay_samples))
    return whole.astype(int), np.where(on_grid, 0.0, delay_samples - whole)


def bulk_delay_samples(delay_samples: np.ndarray) -> int:
    """Whole samples that every link must wait so that no filter reaches ahead of its input.

    0 where all delays are whole samples. Any shape.
    """
    whole, fraction = split_delay(np.asarray(delay_samples, float))
    ahead = np.where(fraction > 0, INTERPOLATOR_TAPS // 2 - 1 - whole, 0)
    return max(0, int(np.max(ahead, initial=0)))


def fir_taps(delay_samples: np.ndarray, gain: np.ndarray, bulk_delay: int = 0) -> np.ndarray:
    """The filter, one complex tap per sample, of paths of `delay_samples` (P,) and complex `gain` (P,)."""
    whole, fraction = split_delay(np.asarray(delay_samples, float))
    taps = np.zeros(int(np.max(whole, initial=0)) + bulk_delay + INTERPOLATOR_TAPS // 2 + 1, complex)
    for start, rest, g in zip(whole + bulk_delay, fraction, gain, strict=True):
        if g == 0:
            continue
        if rest == 0:
            taps[start] += g
        else:
            first = start - (INTERPOLATOR_TAPS // 2 - 1)
            taps[first : first + INTERPOLATOR_TAPS] += g * interpolator(rest)
    return np.trim_zeros(taps, "b")


def filter_length(sample_rate_hz: float) -> int:
    """Taps that hold any scenario (MAX_DELAY_S of delay) at this rate, 512 at least."""
    return max(GRID_TAPS, int(np.ceil(MAX_DELAY_S * sample_rate_hz)) + 2 * INTERPOLATOR_TAPS)


def scenario_bulk_delay(scenario: Scenario, sample_rate_hz: float) -> int:
    """Whole samples that every link of a scenario is late by at this rate; 0 where all taps are on whole samples."""
    used = [taps.delay_s[taps.gain != 0] for taps in scenario.links.values()]
    return bulk_delay_samples(np.concatenate([np.zeros(0), *used]) * sample_rate_hz)


def has_taps_between_samples(scenario: Scenario, sample_rate_hz: float) -> bool:
    """Whether a tap of the scenario needs an interpolating filter at this rate, which is right in INTERPOLATOR_BAND alone."""
    return any((split_delay(t.delay_s * sample_rate_hz)[1] * (t.gain != 0)).any() for t in scenario.links.values())


def scenario_updates(
    scenario: Scenario,
    sample_rate_hz: float,
    from_s: float = 0.0,
    until_s: float = np.inf,
    *,
    links: Container[tuple[str, str]] | None = None,
    cycle: bool = False,
) -> list[LinkUpdate]:
    """The updates that play the instants of a scenario in from_s <= time < until_s.

    Node k of the scenario is input k and output k. Taps on whole samples stay there; others become
    band-limited filters, all later by the same bulk delay, whichever `links` (all without it) are wanted. With `cycle` the
    scenario begins again whenever it ends.
    """
    period_s = scenario.time_s[-1]
    if cycle and not scenario.is_static:
        turns = range(max(0, int(from_s // period_s)), int(np.ceil(until_s / period_s)))
        parts = {
            k: scenario_updates(
                scenario, sample_rate_hz, from_s - k * period_s, min(until_s - k * period_s, period_s), links=links
            )
            for k in turns
        }
        starts = {k: round(k * period_s * sample_rate_hz) for k in turns}
        return [replace(update, at_sample=update.at_sample + starts[k]) for k in turns for update in parts[k]]
    place = {node: index for index, node in enumerate(scenario.nodes)}
    at_sample = np.rint(scenario.time_s * sample_rate_hz).astype(int)
    steps = np.flatnonzero((scenario.time_s >= from_s) & (scenario.time_s < until_s))
    bulk = scenario_bulk_delay(scenario, sample_rate_hz)
    updates = []
    for key, link in scenario.links.items():
        if links is not None and key not in links:
            continue
        name = dict(tx=place[key[0]], rx=place[key[1]])

        def taps(step, link=link):
            return fir_taps(link.delay_s[step] * sample_rate_hz, link.gain[step], bulk)

        if from_s <= 0:
            updates.append(LinkUpdate(**name, taps=taps(0), base_loss_db=base_loss_db(scenario, key)))
        for step in [] if link.is_static else steps:
            at = int(at_sample[step])
            if scenario.interpolation == "hold" and step > 0:
                updates.append(LinkUpdate(**name, at_sample=at, taps=taps(step)))
            elif scenario.interpolation == "linear" and step + 1 < len(at_sample):
                ramp = int(at_sample[step + 1]) - at
                updates.append(LinkUpdate(**name, at_sample=at, taps=taps(step + 1), ramp_samples=ramp))
    return updates
