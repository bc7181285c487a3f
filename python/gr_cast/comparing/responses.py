# SPDX-License-Identifier: GPL-3.0-or-later
"""Compare two channel impulse responses: tap by tap, and by delay spread, K-factor and path gain."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from .. import __version__
from ..core.documents import json_file
from ..core.errors import CastError
from ..core.units import amplitude_from_db, db_from_power, power_from_db

MAX_DELAY_S, MAX_GAIN_DB = 1e6, 1e3  # beyond any radio, and powers are still numbers


@dataclass(frozen=True, kw_only=True)
class Response:
    """Taps of one link: delay_s (P,) and gain_db (P,), P of 1 or more. Raises CastError otherwise."""

    name: str
    delay_s: np.ndarray
    gain_db: np.ndarray

    def __post_init__(self):
        for field in ("delay_s", "gain_db"):
            object.__setattr__(self, field, np.array(getattr(self, field), float))
        if self.delay_s.ndim != 1 or self.delay_s.shape != self.gain_db.shape or not self.delay_s.size:
            raise CastError(f"{self.name}: got {self.delay_s.size} delays and {self.gain_db.size} gains, needs one tap or more")
        if not (np.isfinite(self.delay_s).all() and np.isfinite(self.gain_db).all()):
            raise CastError(f"{self.name}: taps: delays and gains must be finite")

    @property
    def path_gain_db(self) -> float:
        return float(db_from_power(np.sum(power_from_db(self.gain_db))))

    @property
    def delay_spread_s(self) -> float:
        """rms: square root of the second central moment of the power-delay profile."""
        share = power_from_db(self.gain_db - self.path_gain_db)
        return float(np.sqrt(np.sum(share * (self.delay_s - np.sum(share * self.delay_s)) ** 2)))

    @property
    def k_factor_db(self) -> float | None:
        """Strongest tap over the sum of all others; None for one tap alone."""
        power = power_from_db(self.gain_db)
        rest = np.sum(np.delete(power, np.argmax(power)))
        return float(db_from_power(np.max(power) / rest)) if rest > 0 else None


@dataclass(frozen=True, kw_only=True)
class ResponseComparison:
    """`pairs` (k, 2) are indices of a tap of A and its own of B; `only_a`, `only_b` those that have none."""

    a: Response
    b: Response
    tolerance_s: float
    pairs: np.ndarray
    only_a: tuple[int, ...]
    only_b: tuple[int, ...]


def from_sounding(path: Path) -> Response | None:
    """The taps of a sounder's result (its folder or result.json); None where `path` is neither."""
    path = path / "result.json" if path.is_dir() else path
    if path.suffix != ".json":
        return None
    try:
        get = json_file(path)
    except CastError:
        return None  # a series perhaps, which says what is wrong with it
    if "cast_sounding" not in get.document:
        return None
    get.version("cast_sounding", 1)
    taps = get.sequence(get.document.get("taps"), "taps")
    taps = [get.mapping(tap, f"taps[{k}]") for k, tap in enumerate(taps)]
    columns = {
        key: [get.number(tap.get(key), f"taps[{k}].{key}", unit, -limit, limit) for k, tap in enumerate(taps)]
        for key, unit, limit in (("delay_s", "s", MAX_DELAY_S), ("gain_db", "dB", MAX_GAIN_DB))
    }
    get.faults.raise_if_any()
    return Response(name=str(path), **columns)


def compare_responses(a: Response, b: Response, tolerance_s: float) -> ResponseComparison:
    """Pair the taps that lie nearest in delay, within `tolerance_s` (s), each once; gain breaks ties."""
    if not 0 < tolerance_s < np.inf:
        raise CastError(f"tolerance: got {tolerance_s} s, needs a finite number above 0")
    apart = np.abs(a.delay_s[:, None] - b.delay_s) / tolerance_s
    unlike = np.abs(amplitude_from_db(a.gain_db)[:, None] - amplitude_from_db(b.gain_db))
    near = apart <= 1 + 1e-9
    # One pair too far apart costs more than any number of near ones.
    cost = np.where(near, apart + 1e-3 * unlike / max(unlike.max(), 1e-300), 10.0 * sum(apart.shape))
    pairs = np.stack(linear_sum_assignment(cost), axis=1)
    pairs = pairs[near[pairs[:, 0], pairs[:, 1]]]
    only = [tuple(int(k) for k in np.setdiff1d(np.arange(r.delay_s.size), pairs[:, i])) for i, r in enumerate((a, b))]
    return ResponseComparison(a=a, b=b, tolerance_s=tolerance_s, pairs=pairs, only_a=only[0], only_b=only[1])


def as_document(c: ResponseComparison) -> dict:
    """The content of comparison.json."""

    def tap(response, k):
        return {"delay_s": float(response.delay_s[k]), "gain_db": float(response.gain_db[k])}

    def both(figure):
        return {"a": getattr(c.a, figure), "b": getattr(c.b, figure)}

    pairs = [
        {
            "a": tap(c.a, i),
            "b": tap(c.b, j),
            "delay_error_s": float(c.b.delay_s[j] - c.a.delay_s[i]),
            "gain_error_db": float(c.b.gain_db[j] - c.a.gain_db[i]),
        }
        for i, j in c.pairs
    ]
    return {
        "cast_comparison": 1,
        "software": f"gr-cast {__version__}",
        "kind": "cir",
        "a": c.a.name,
        "b": c.b.name,
        "tolerance_s": c.tolerance_s,
        "taps": pairs,
        "only_a": [tap(c.a, k) for k in c.only_a],
        "only_b": [tap(c.b, k) for k in c.only_b],
        "delay_spread_s": both("delay_spread_s"),
        "k_factor_db": both("k_factor_db"),
        "path_loss_db": {"a": -c.a.path_gain_db, "b": -c.b.path_gain_db, "error": c.a.path_gain_db - c.b.path_gain_db},
    }


def as_table(document: dict) -> str:
    """The comparison of two responses for the screen."""
    lines = ["   A: delay (µs)  gain (dB)    B − A: delay (ns)  gain (dB)"]
    for tap in document["taps"]:
        lines.append(
            f"{tap['a']['delay_s'] * 1e6:16.4f}{tap['a']['gain_db']:11.2f}"
            f"{tap['delay_error_s'] * 1e9:+z21.1f}{tap['gain_error_db']:+z11.2f}"
        )
    for side in ("a", "b"):
        lines += [
            f"only in {side.upper()}: {tap['delay_s'] * 1e6:.4f} µs, {tap['gain_db']:.2f} dB" for tap in document[f"only_{side}"]
        ]

    def row(label, values, scale, unit):
        cells = ["–" if v is None else f"{v * scale:.2f}" for v in (values["a"], values["b"])]
        return f"{label:<16}A {cells[0]:>9}   B {cells[1]:>9} {unit}"

    return "\n".join(
        [
            *lines,
            row("delay spread", document["delay_spread_s"], 1e9, "ns"),
            row("K-factor", document["k_factor_db"], 1.0, "dB"),
            row("loss, Σ|tap|²", document["path_loss_db"], 1.0, "dB"),
        ]
    )
