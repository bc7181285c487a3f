# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare two runs: the similarity ρ of the paper, and beside it what ρ does not see.

ρ is the largest normalised cross-correlation over a few lags, means removed, the shorter series padded with zeros
("Colosseum as a Digital Twin", IEEE TMC 2024). Being a correlation it is blind to gain and offset.
"""

from dataclasses import dataclass, replace

import numpy as np

from .. import __version__
from ..core.errors import CastError
from .series import Series, resampled

MAX_LAG = 10
CONFIDENCE = 0.95
FEW_SAMPLES = 10  # independent ones; with fewer an interval says little


@dataclass(frozen=True, kw_only=True)
class SeriesComparison:
    """What `compare` finds. Differences are B − A in the series' own unit, over the samples that both have, at lag 0.

    `lag` (samples) is how much later B is than A where ρ is largest; `slope` is B over A there. None where undefined.
    """

    a: Series
    b: Series
    step_s: float
    rho: float | None
    rho_interval: tuple[float, float] | None
    rho_at_lag: np.ndarray  # (2·max_lag + 1,) from −max_lag on; NaN where undefined
    lag: int | None
    bias: float
    rmse: float
    slope: float | None
    independent_samples: float | None
    block_samples: int | None
    blind_spots: tuple[str, ...]

    @property
    def max_lag(self) -> int:
        return len(self.rho_at_lag) // 2


def centred(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both series without their means, the shorter padded with zeros at its end."""
    size = max(len(a), len(b))
    return tuple(np.pad(x - np.mean(x), (0, size - len(x))) for x in (a, b))


def similarity(a: np.ndarray, b: np.ndarray, max_lag: int = MAX_LAG) -> tuple[float, int, np.ndarray]:
    """ρ, its lag and the normalised cross-correlation at lags −max_lag … max_lag, (2·max_lag + 1,).

    a (n,), b (m,) finite. ρ(k) = Σ_i a'[i]·b'[i + k] / √(Σ a'²·Σ b'²); NaN where a series is constant.
    """
    # A constant whose mean rounds is still constant.
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return np.nan, 0, np.full(2 * max_lag + 1, np.nan)
    a, b = centred(a, b)
    scale = np.sqrt(np.sum(a**2) * np.sum(b**2))
    lags = np.arange(-max_lag, max_lag + 1)
    rho = np.array([np.sum(a[max(0, -k) : len(a) - max(0, k)] * b[max(0, k) : len(b) - max(0, -k)]) for k in lags]) / scale
    # Among equals the smallest lag: a shift that buys nothing is none.
    best = min(np.flatnonzero(rho >= np.max(rho) - 1e-12), key=lambda index: abs(lags[index]))
    return float(rho[best]), int(lags[best]), rho


def _shifted_pairs(a: np.ndarray, b: np.ndarray, lag: int) -> tuple[np.ndarray, np.ndarray]:
    """The samples that both have when b is taken `lag` samples later."""
    a, b = a[max(0, -lag) :], b[max(0, lag) :]
    size = min(len(a), len(b))
    return a[:size], b[:size]


def _autocorrelation(x: np.ndarray) -> np.ndarray:
    """ρ_x(k) for k = 0 … n − 1 (biased)."""
    x = x - np.mean(x)
    spectrum = np.fft.rfft(x, 2 * len(x))
    power = np.fft.irfft(np.abs(spectrum) ** 2)[: len(x)]
    return power / power[0] if power[0] > 0 else np.eye(1, len(x)).ravel()


def _memory(correlation: np.ndarray) -> int:
    """Lag from which a correlogram stays within chance (Politis and White 2004, section 3.2)."""
    n = len(correlation)
    chance = 2 * np.sqrt(np.log10(max(n, 10)) / n)
    run = max(5, int(np.sqrt(np.log10(n))))
    small = np.abs(correlation[1:]) < chance
    for lag in range(len(small)):
        if small[lag : lag + run].all():
            return lag
    return n // 4


def independent_samples(a: np.ndarray, b: np.ndarray) -> float:
    """How many independent pairs say as much about a correlation as these n, n at most: n / Σ_k ρ_a(k)·ρ_b(k) (Bartlett 1946)."""
    n = len(a)
    ra, rb = _autocorrelation(a), _autocorrelation(b)
    reach = min(2 * max(_memory(ra), _memory(rb)), n // 2)
    taper = 1 - np.arange(1, reach + 1) / n
    total = 1 + 2 * np.sum(taper * ra[1 : reach + 1] * rb[1 : reach + 1])
    return float(n / max(total, 1.0))


def block_length(x: np.ndarray) -> int:
    """Best block length, samples, of a circular block bootstrap of the mean of x (Politis and White 2004, Patton et al. 2009)."""
    n = len(x)
    correlation = _autocorrelation(x)
    reach = min(2 * max(_memory(correlation), 1), n - 1)
    lag = np.arange(1, reach + 1)
    window = np.clip(2 * (1 - lag / reach), 0, 1)
    g = 2 * np.sum(window * lag * correlation[1 : reach + 1])
    d = 4 / 3 * (1 + 2 * np.sum(window * correlation[1 : reach + 1])) ** 2
    best = (2 * g**2 / d) ** (1 / 3) * n ** (1 / 3) if d > 0 else 1.0
    return int(np.clip(np.ceil(best), 1, max(1, min(3 * np.sqrt(n), n / 3))))


def rho_interval(
    a: np.ndarray, b: np.ndarray, rng: np.random.Generator, resamples: int = 2000
) -> tuple[tuple[float, float], int]:
    """95 % interval of the correlation of pairs a, b (n,) by circular block bootstrap, and the block length in samples.

    Blocks keep the pairs' memory (Politis and Romano 1992); the interval is that of the percentiles.
    """
    n = len(a)
    x, y = (a - np.mean(a)) / np.std(a), (b - np.mean(b)) / np.std(b)
    rho = np.mean(x * y)
    block = block_length(x * y - rho * (x**2 + y**2) / 2)  # what each pair adds to the estimate
    starts = rng.integers(0, n, (resamples, -(-n // block)))
    rows = ((starts[:, :, None] + np.arange(block)) % n).reshape(resamples, -1)[:, :n]
    u, v = x[rows], y[rows]
    u, v = u - u.mean(axis=1, keepdims=True), v - v.mean(axis=1, keepdims=True)
    power = np.sum(u**2, axis=1) * np.sum(v**2, axis=1)
    drawn = np.sum(u * v, axis=1)[power > 0] / np.sqrt(power[power > 0])
    low, high = np.quantile(drawn, [(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2])
    return (float(low), float(high)), block


def _prepared(series: Series, step_s: float | None) -> Series:
    if step_s is not None:
        return resampled(series, step_s)
    missing = int(np.isnan(series.value).sum())
    if missing:
        first = series.time_s[np.argmax(np.isnan(series.value))]
        raise CastError(
            f"{series.name}: {missing} of {series.value.size} values are missing, the first at {first:g} s; "
            "--step SECONDS averages over steps and interpolates"
        )
    if not series.is_uniform:
        steps = np.diff(series.time_s)
        raise CastError(
            f"{series.name}: time_s: steps from {steps.min():g} to {steps.max():g} s, needs equal ones; --step SECONDS resamples"
        )
    return series


def compare(a: Series, b: Series, *, max_lag: int = MAX_LAG, step_s: float | None = None, seed: int = 0) -> SeriesComparison:
    """Compare two series, each counted from its own first sample.

    Raises CastError for missing values, unequal steps (within a series, or between them by over 1 %) and bad lags,
    unless `step_s` has both resampled first.
    """
    if max_lag < 0:
        raise CastError(f"max lag: got {max_lag} samples, needs 0 or more")
    a, b = _prepared(a, step_s), _prepared(b, step_s)
    if abs(a.step_s - b.step_s) > 0.01 * min(a.step_s, b.step_s):
        raise CastError(
            f"{a.name} has a sample every {a.step_s:g} s, {b.name} every {b.step_s:g} s: needs one step; --step SECONDS resamples"
        )
    if max_lag >= min(a.value.size, b.value.size):
        raise CastError(f"max lag: got {max_lag} samples, the shorter series has {min(a.value.size, b.value.size)}")
    rho, lag, rho_at_lag = similarity(a.value, b.value, max_lag)
    both_a, both_b = _shifted_pairs(a.value, b.value, 0)
    bias, rmse = float(np.mean(both_b - both_a)), float(np.sqrt(np.mean((both_b - both_a) ** 2)))
    found = dict(rho=None, lag=None, slope=None, independent_samples=None, rho_interval=None, block_samples=None)
    if np.isfinite(rho):
        found.update(rho=rho, lag=lag)
        x, y = _shifted_pairs(a.value, b.value, lag)
        if np.ptp(x) > 0:
            found["slope"] = float(np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2))
        pairs = _shifted_pairs(*centred(a.value, b.value), lag)
        if np.ptp(pairs[0]) > 0 and np.ptp(pairs[1]) > 0:
            found["independent_samples"] = independent_samples(*pairs)
            interval, found["block_samples"] = rho_interval(*pairs, np.random.default_rng(seed))
            found["rho_interval"] = interval
    comparison = SeriesComparison(a=a, b=b, step_s=a.step_s, rho_at_lag=rho_at_lag, bias=bias, rmse=rmse, blind_spots=(), **found)
    return replace(comparison, blind_spots=tuple(_blind_spots(comparison)))


def _blind_spots(c: SeriesComparison):
    """A sentence for everything that ρ leaves out here and that is too large for chance."""
    if c.rho is None:
        yield "a series is constant: ρ is not defined; bias and RMSE still are"
        return
    x, y = _shifted_pairs(c.a.value, c.b.value, 0)
    error = y - x
    chance = 2 * np.std(error) / np.sqrt(independent_samples(error, error)) if np.ptp(error) > 0 else 0.0
    if abs(c.bias) > max(chance, 1e-9 * np.max(np.abs(x))):
        yield f"bias: B lies {c.bias:+.4g} from A on the average; ρ would be the same without it"
    if c.slope is not None and abs(c.slope - 1) > 0.1:
        yield f"slope: B moves {c.slope:.3g} times as much as A; ρ does not see gain"
    if c.lag:
        side = "later" if c.lag > 0 else "earlier"
        yield f"lag: B is {abs(c.lag)} samples ({abs(c.lag) * c.step_s:g} s) {side} than A where ρ is largest"
    if len(c.a.value) != len(c.b.value):
        yield f"length: {len(c.a.value)} and {len(c.b.value)} samples; the shorter is padded with its mean, which lowers ρ"
    if c.independent_samples is not None and c.independent_samples < FEW_SAMPLES:
        yield f"memory: the series are worth {c.independent_samples:.1f} independent samples, too few to trust an interval"
    inside = _rho_without_means_of_parts(c)
    if inside is not None and inside < c.rho - 0.1:
        yield f"levels: ρ is carried by a change of level; within the parts before and after it, it is {inside:.3f}"


def _rho_without_means_of_parts(c: SeriesComparison) -> float | None:
    """ρ after the mean of each half-level of A (below and above its middle) is taken out of both series."""
    x, y = _shifted_pairs(c.a.value, c.b.value, c.lag)
    high = x > (x.min() + x.max()) / 2
    x, y = x.copy(), y.copy()
    for part in (high, ~high):
        if part.sum() < FEW_SAMPLES:
            return None
        x[part] -= x[part].mean()
        y[part] -= y[part].mean()
    power = np.sum(x**2) * np.sum(y**2)
    return float(np.sum(x * y) / np.sqrt(power)) if power > 0 else None


def as_document(c: SeriesComparison) -> dict:
    """The content of comparison.json; null where a number is not defined."""
    return {
        "cast_comparison": 1,
        "software": f"gr-cast {__version__}",
        "kind": "series",
        "a": c.a.name,
        "b": c.b.name,
        "samples": [c.a.value.size, c.b.value.size],
        "step_s": c.step_s,
        "rho": c.rho,
        "rho_interval": c.rho_interval,
        "lag": c.lag,
        "lag_s": None if c.lag is None else c.lag * c.step_s,
        "max_lag": c.max_lag,
        "rho_at_lag_0": None if c.rho is None else float(c.rho_at_lag[c.max_lag]),
        "bias": c.bias,
        "rmse": c.rmse,
        "slope": c.slope,
        "independent_samples": c.independent_samples,
        "block_samples": c.block_samples,
        "blind_spots": list(c.blind_spots),
    }


def as_table(document: dict) -> str:
    """The comparison of two series for the screen."""

    def show(label, key, form=".4g", after=""):
        value = document[key]
        return f"{label:<24}{'–' if value is None else format(value, form)}{after if value is not None else ''}"

    interval = document["rho_interval"]
    lines = [
        show("similarity ρ", "rho", ".4f", f"   95 %: {interval[0]:.4f} to {interval[1]:.4f}" if interval else ""),
        show("best lag", "lag", "d", f" samples ({document['lag_s'] or 0:g} s): B later than A"),
        show("ρ at lag 0", "rho_at_lag_0", ".4f"),
        show("bias B − A", "bias"),
        show("RMSE", "rmse"),
        show("slope B over A", "slope"),
        show("independent samples", "independent_samples", ".1f", f" of {min(document['samples'])}"),
    ]
    return "\n".join(lines + [f"blind spot: {line}" for line in document["blind_spots"]])
