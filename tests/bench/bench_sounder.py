#!/usr/bin/python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""The sounder's errors over the Cramér-Rao bound, its false alarms, and what a carrier offset costs it."""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "apps"))

import _program
import numpy as np
from gr_cast.signals import codes
from gr_cast.signals.recording import Recording
from gr_cast.signals.waveform import Waveform
from gr_cast.sounding.cir import estimate_taps
from gr_cast.sounding.correlate import Template
from gr_cast.sounding.sound import sound

CODE = codes.glfsr(8)
TAPS = {0: -3.0, 64: -20.0, 100: -15.0, 200: -8.0}  # the paper's four taps at 50 MS/s: delay in samples, gain in dB


def noise(random, *shape):
    return (random.standard_normal(shape) + 1j * random.standard_normal(shape)) / np.sqrt(2)


def errors_over_bound(random, snr_db: float, trials: int, periods: int) -> dict[int, tuple]:
    """Per tap: share detected, RMS error over the bound of delay and gain, mean gain error in dB. Sub-sample delays.

    `snr_db` is the chip SNR of a tap of 0 dB; `periods` are averaged coherently, which only scales the noise.
    """
    template, variance = Template(CODE), 10 ** (-snr_db / 10) / periods
    spectrum, f = np.abs(np.fft.fft(CODE)) ** 2, np.fft.fftfreq(len(CODE))
    slope_energy = np.sum((2 * np.pi * f) ** 2 * spectrum) / len(CODE)
    errors = {delay: [] for delay in TAPS}
    for _ in range(trials):
        true = {
            delay: (delay + random.uniform(-0.4, 0.4), 10 ** (gain / 20) * np.exp(2j * np.pi * random.random()))
            for delay, gain in TAPS.items()
        }
        received = sum(gain * template.columns([delay])[:, 0] for delay, gain in true.values())
        taps = estimate_taps(received + np.sqrt(variance) * noise(random, len(CODE)), template, noise_variance=variance)
        for slot, (delay, gain) in true.items():
            near = np.flatnonzero(np.abs(taps.delay_samples - delay) < 2)
            if len(near):
                k = near[np.argmax(np.abs(taps.gain[near, 0]))]
                errors[slot].append(
                    (taps.delay_samples[k] - delay, np.abs(taps.gain[k, 0]) - np.abs(gain), np.abs(taps.gain[k, 0] / gain))
                )
    rows = {}
    for slot, gain_db in TAPS.items():
        amplitude = 10 ** (gain_db / 20)
        found = np.array(errors[slot]).reshape(-1, 3)
        if len(found) == 0:
            rows[slot] = (0.0, np.nan, np.nan, np.nan)
            continue
        delay_bound = np.sqrt(variance / (2 * amplitude**2 * slope_energy))
        gain_bound = np.sqrt(variance / (2 * len(CODE)))
        rms = np.sqrt(np.mean(found[:, :2] ** 2, axis=0))
        rows[slot] = (len(found) / trials, rms[0] / delay_bound, rms[1] / gain_bound, 10 * np.log10(np.mean(found[:, 2] ** 2)))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=400)
    parser.add_argument("--noise-only", type=int, default=20_000, help="noise-only CIRs")
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    random = np.random.default_rng(args.seed)

    for periods in (1, 1500):
        print(
            f"four taps at 50 MS/s, {periods} periods averaged, {args.trials} trials: found, RMS/bound of delay, gain, bias (dB)"
        )
        print("chip SNR" + "".join(f"{f'tap {gain:g} dB':>34}" for gain in TAPS.values()))
        for snr_db in range(-10, 31, 5):
            rows = errors_over_bound(random, snr_db, args.trials, periods)
            cells = "".join(f"{share:>13.0%} {delay:6.2f} {gain:6.2f} {bias:+6.2f}" for share, delay, gain, bias in rows.values())
            print(f"{snr_db:>5} dB {cells}", flush=True)

    template, rate = Template(CODE), 1e-3
    for name, variance in (("noise level known", 1.0), ("noise level from the CIR", None)):
        alarms = sum(
            len(estimate_taps(noise(random, len(CODE)), template, noise_variance=variance, false_alarm_rate=rate).gain) > 0
            for _ in range(args.noise_only)
        )
        print(
            f"false alarms, {name}: {alarms} of {args.noise_only} CIRs = {alarms / args.noise_only:.2e}, stated {rate:.0e}",
            flush=True,
        )

    print("carrier offset at 10 MS/s, chip SNR 10 dB, 200 periods: loss of the path gain")
    waveform = Waveform(samples=CODE.astype(np.complex64))
    for offset_hz in (-20e3, -10e3, -1e3, 0.0, 1e3, 10e3, 20e3):
        n = np.arange(255 * 200)
        samples = np.tile(CODE, 200) * np.exp(2j * np.pi * offset_hz / 10e6 * n) + np.sqrt(0.1) * noise(random, len(n))
        result = sound(Recording(samples=samples.astype(np.complex64), sample_rate_hz=10e6), waveform)
        found_hz = result.offset.cycles_per_sample * 10e6
        print(f"  {offset_hz:>+8.0f} Hz: found {found_hz:>+11.2f} Hz, loss {-result.path_gain_db:+.3f} dB")
    return 0


if __name__ == "__main__":
    _program.run(main)
