# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's comparison of code sequences (figure "code comparison over 800 µs"), with the fair codes beside them."""

import numpy as np

from ..core.units import amplitude_from_db, db_from_amplitude
from ..emulation.reference import LinkUpdate, emulate
from ..signals.codes import periodic_autocorrelation
from ..signals.waveform import spec_from_text, waveform_from_spec

SAMPLE_RATE_HZ = 1e6
DURATION_S = 800e-6
LINK_LOSS_DB = 30.0  # the attenuator of the paper's laboratory link
NOISE_DB = -60.0  # of full scale: 30 dB below what arrives
FLOOR = 1e-5  # correlations below −100 dB are rounding
ROUNDING_DB = -90.0  # sidelobes below it are none

PAPER_CODES = ("glfsr:8", "gold_paper", "ga128", "ls")
FAIR_CODES = ("gold:127", "gold:511", "ga128+gb128", "zadoff_chu:255:1")


def _correlation(received: np.ndarray, code: np.ndarray) -> np.ndarray:
    """Σ_n r[n + k]·s*[n] / sᵀs at every lag k that sees a whole period, complex128."""
    return np.correlate(received.astype(np.complex128), code.astype(np.complex128), "valid") / np.sum(np.abs(code) ** 2)


def _through_link(sent: np.ndarray, random: np.random.Generator) -> np.ndarray:
    gain = complex(amplitude_from_db(-LINK_LOSS_DB))
    heard = emulate(sent[None, :].astype(np.complex64), [LinkUpdate(tx=0, rx=0, taps=[gain])], 1)[0]
    noise = random.standard_normal((2, len(sent))) * amplitude_from_db(NOISE_DB) / np.sqrt(2)
    return heard + noise[0] + 1j * noise[1]


def _sidelobe_db(correlation: np.ndarray) -> float | None:
    """Largest periodic sidelobe under the peak, dB; None where there is none."""
    return _none_below(float(db_from_amplitude(np.max(np.abs(correlation[1:])))))


def _none_below(level_db: float) -> float | None:
    """A level, or None for what is only the rounding of numbers."""
    return level_db if level_db > ROUNDING_DB else None


def _measured_sidelobe_db(correlation_db: np.ndarray, period: int) -> float | None:
    """Largest value between the peaks, under the mean peak; None where there is none."""
    at_peak = np.arange(len(correlation_db)) % period == 0
    return _none_below(float(np.max(correlation_db[~at_peak]) - np.mean(correlation_db[at_peak])))


def _peak_spacing_s(correlation_db: np.ndarray) -> float:
    """Mean distance of the lags that come within 1 dB of the largest."""
    near = np.flatnonzero(correlation_db > np.max(correlation_db) - 1.0)
    return float(np.mean(np.diff(near))) / SAMPLE_RATE_HZ


def compare(seed: int = 1) -> list[dict]:
    """One row per code: `name`, `published` (in the paper), `length`, `peak_spacing_s`, sidelobes in dB, and curves.

    `periodic_sidelobe_db` is the closed form from the autocorrelation, `alone_sidelobe_db` and `link_sidelobe_db` are read
    off the correlated signal without and through the 30 dB link. Ga + Gb adds the correlations of the two sequences.
    """
    random = np.random.default_rng(seed)
    samples = int(round(DURATION_S * SAMPLE_RATE_HZ))
    rows = []
    for name in PAPER_CODES + FAIR_CODES:
        parts = [waveform_from_spec(spec_from_text(part)).samples for part in name.split("+")]
        period = len(parts[0])
        autocorrelation = sum(periodic_autocorrelation(part) for part in parts) / len(parts)
        # One period more than shown, so that every lag shown sees a whole one. Complementary codes add their correlations.
        sent = [np.resize(part, samples + period - 1) for part in parts]
        alone = sum(_correlation(x, part) for x, part in zip(sent, parts, strict=True)) / len(parts)
        link = sum(_correlation(_through_link(x, random), part) for x, part in zip(sent, parts, strict=True)) / len(parts)
        alone_db, link_db = (db_from_amplitude(np.maximum(np.abs(c), FLOOR)) for c in (alone, link))
        rows.append(
            {
                "name": name,
                "published": name in PAPER_CODES,
                "length": period,
                "time_us": np.arange(samples) / SAMPLE_RATE_HZ * 1e6,
                "alone_db": alone_db,
                "link_db": link_db,
                "peak_spacing_s": _peak_spacing_s(alone_db),
                "periodic_sidelobe_db": _sidelobe_db(autocorrelation),
                "alone_sidelobe_db": _measured_sidelobe_db(alone_db, period),
                "link_sidelobe_db": _measured_sidelobe_db(link_db, period),
            }
        )
    return rows
