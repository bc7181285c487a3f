# SPDX-License-Identifier: GPL-3.0-or-later
"""Correlation of received samples with the known waveform, on delays of any fraction of a sample."""

import numpy as np
from scipy.fft import fft, fftfreq, ifft, next_fast_len
from scipy.ndimage import uniform_filter1d

OVERSAMPLING = 4  # delays per sample that a search visits: at most 0.2 dB below a peak between them

_IN_BAND = 0.1  # of the spectrum's largest density


class Template:
    """A known waveform s, delayed at will by band-limited interpolation, as seen through a window of samples.

    `samples` (n,): one period where `circular`, and then the window is one period; otherwise the waveform sent once,
    NaN counted as zero, and `window` samples are observed, of which delay 0 puts sample `skip` at the window's first. Of a
    circular one only the share `band` of its band counts, in the middle: least squares with what is limited so heed no more.
    """

    def __init__(
        self, samples: np.ndarray, *, circular: bool = True, window: int | None = None, skip: int = 0, band: float = 1.0
    ):
        self.circular = circular
        self.window = len(samples) if circular else window
        self.grid = len(samples) if circular else next_fast_len(len(samples) + window + skip)
        self._seen = slice(skip, skip + self.window)
        self.spectrum = fft(np.nan_to_num(np.asarray(samples, np.complex128)), self.grid)
        self.frequency = fftfreq(self.grid)  # cycles per sample
        if band < 1:
            self.spectrum[np.abs(self.frequency) > band / 2] = 0
        power = np.abs(self.spectrum) ** 2
        self.energy = float(power.sum() / self.grid)
        mean = np.sum(power * self.frequency) / power.sum()
        self.rms_bandwidth_rad = 2 * np.pi * float(np.sqrt(np.sum(power * (self.frequency - mean) ** 2) / power.sum()))

    def _turns(self, delays):
        turns = np.exp(-2j * np.pi * np.multiply.outer(self.frequency, delays))
        if self.grid % 2 == 0:  # the Nyquist line of a delayed waveform keeps its real part alone
            turns[self.grid // 2] = turns[self.grid // 2].real
        return turns

    def columns(self, delays) -> np.ndarray:
        """s(n − delay) for each delay (samples): (window, len(delays)) complex128."""
        return ifft(self.spectrum[:, None] * self._turns(delays), axis=0)[self._seen]

    def slopes(self, delays) -> np.ndarray:
        """d/d(delay) of `columns`, per sample."""
        turns = -2j * np.pi * self.frequency[:, None] * self._turns(delays)
        if self.grid % 2 == 0:
            turns[self.grid // 2] = -np.pi * np.sin(np.pi * np.asarray(delays))
        return ifft(self.spectrum[:, None] * turns, axis=0)[self._seen]

    def gram(self, delays) -> np.ndarray:
        """Inner products of two unit echoes over the waveform's band, taken as flat: (k, k) complex128, 1 on the diagonal."""
        power = uniform_filter1d(np.abs(self.spectrum) ** 2, max(3, self.grid // 50), mode="wrap")  # across single nulls
        turns = self._turns(delays)[power > _IN_BAND * power.max()]
        return turns.conj().T @ turns / len(turns)

    def matched_filter(self, samples: np.ndarray, oversampling: int = 1) -> np.ndarray:
        """Σ_n r[n]·s*(n − τ) for τ = 0, 1/oversampling, … < grid; input (window, …), output (grid·oversampling, …)."""
        shape = (-1,) + (1,) * (samples.ndim - 1)
        placed = np.zeros((self.grid, *samples.shape[1:]), complex)
        placed[self._seen] = samples
        spectrum = fft(placed, axis=0) * np.conj(self.spectrum).reshape(shape)
        if oversampling == 1:
            return ifft(spectrum, axis=0)
        padded = np.zeros((self.grid * oversampling, *samples.shape[1:]), complex)
        half = (self.grid + 1) // 2
        padded[:half] = spectrum[:half]
        padded[-(self.grid - half) :] = spectrum[half:]
        return ifft(padded, axis=0) * oversampling


def circular_cir(periods: np.ndarray, code: np.ndarray) -> np.ndarray:
    """The paper's estimator h = (r ⊗ s)/sᵀs of each period: (…, n) in, (…, n) complex128 out."""
    spectrum = np.conj(fft(np.asarray(code, np.complex128)))
    return ifft(fft(periods, axis=-1) * spectrum, axis=-1) / np.sum(np.abs(code) ** 2)
