# SPDX-License-Identifier: GPL-3.0-or-later
"""How a network is computed on a device: method, precision, sizes; and what a receiver does to its samples."""

from dataclasses import dataclass

import numpy as np

from ...core.errors import CastError

# How spectra are stored and multiplied. fp16 and tf32 both have 11 significant bits, fp32 has 24, split 22 in two halves.
PRECISIONS = ("tf32", "fp16", "fp32", "split")
METHODS = ("direct", "overlap-save")
BINS = (512, 1024, 2048, 4096)
DELAY_TYPE = np.uint16  # of delays in tables: they go to the card every time that taps change
MOST_TAPS = 1 << 16


@dataclass(frozen=True, kw_only=True)
class Form:
    """One way to compute a network of n_inputs × n_outputs links of n_taps taps."""

    n_inputs: int
    n_outputs: int
    n_taps: int
    method: str = "overlap-save"
    precision: str = "fp32"
    n_bins: int = 2048
    tile: int = 4  # blocks that one thread block transforms together

    def __post_init__(self):
        for name, got, limit in (("method", self.method, METHODS), ("precision", self.precision, PRECISIONS)):
            if got not in limit:
                raise CastError(f"{name}: got {got!r}, needs one of {', '.join(limit)}")
        if min(self.n_inputs, self.n_outputs, self.n_taps) < 1:
            raise CastError(
                f"network: got {self.n_inputs}x{self.n_outputs} nodes and {self.n_taps} taps, needs 1 or more of each"
            )
        if self.n_taps > MOST_TAPS:
            raise CastError(f"taps: got {self.n_taps} of a link, needs {MOST_TAPS} or less")
        if self.method == "overlap-save" and (self.n_bins not in BINS or self.step < 1):
            raise CastError(f"bins: got {self.n_bins} for {self.n_taps} taps, needs one of {BINS} that is more than the taps")

    @property
    def step(self) -> int:
        """Samples that one block brings forth."""
        return self.n_bins - (self.n_taps - 1)

    @property
    def is_half(self) -> bool:
        return self.precision in ("fp16", "split")

    def blocks(self, n_samples: int) -> int:
        """Blocks of a segment, in whole tiles."""
        return -(-n_samples // (self.step * self.tile)) * self.tile

    def segment_bytes(self, n_blocks: int) -> int:
        """Memory that the spectra of one segment take."""
        links, halves = self.n_inputs * self.n_outputs, 2 if self.precision == "split" else 1
        taps, sent = (4 * halves, 8 * halves) if self.is_half else (8, 8)
        return self.n_bins * (links * taps + n_blocks * (self.n_inputs * sent + self.n_outputs * 8))

    def words(self) -> str:
        """The form as a plan says it."""
        if self.method == "direct":
            return "direct form in fp32"
        return f"overlap-save in {self.n_bins} bins, {self.precision}"


@dataclass(frozen=True, kw_only=True)
class Ends:
    """What comes before and after the links: full scales, rounding, noise.

    Samples are integers of 16 bits or floats; `levels_in` and `levels_out` (0: none) are half the number of steps that floats are
    rounded to.
    """

    scale_in: float = 1.0
    levels_in: int = 0
    scale_out: float = 1.0
    levels_out: int = 0
    int16_in: bool = False
    int16_out: bool = False
    noise_power: np.ndarray | None = None  # per receiver
    seed: int = 0

    @property
    def gain_in(self) -> float:
        """What a sample is multiplied by so that full scale becomes 1; floats that nobody rounds stay as they are."""
        if self.int16_in:
            return 1 / 32768
        return 1 / self.scale_in if self.levels_in else 1.0

    @property
    def gain_back(self) -> float:
        """What undoes it behind the links."""
        return self.scale_in if self.int16_in or self.levels_in else 1.0
