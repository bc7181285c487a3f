# SPDX-License-Identifier: GPL-3.0-or-later
"""What a peer sends that is no sample: NaN and infinities, counted and taken as 0."""

import numpy as np


class FiniteSamples:
    """Counts, over the chunks of one stream, the samples that were not finite; `first` is the number of the first."""

    def __init__(self):
        self.count, self.first = 0, None

    def of(self, samples: np.ndarray, number: int) -> np.ndarray:
        """The samples (n,) complex64, the first of them the stream's `number`th, with 0 for what is none."""
        with np.errstate(all="ignore"):
            if np.isfinite(np.sum(samples.view(np.float32))):  # one that is not would make the sum none
                return samples
        bad = ~np.isfinite(samples)
        if bad.any() and self.first is None:
            self.first = number + int(np.argmax(bad))
        self.count += int(bad.sum())
        return np.where(bad, np.complex64(0), samples)
