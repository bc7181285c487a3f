# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of the network against the array interface: on NumPy the law that the CUDA kernels are held against, on CuPy what
stands in where they cannot be had.

A chunk is `before` (transmitters, n_taps - 1 and more) and `now` (transmitters, n), complex64 or int16 (…, 2). Its segments are
rows (begin, end, weight, slope) of a table. Spectra lie [segment][bin][node][block], those of links
[segment][bin][receiver][transmitter].
"""

import contextlib
import platform
import time

import numpy as np

from .form import Ends, Form

LARGEST_HALF = 4096.0  # of a filter's spectrum; leaves 156 dB of full precision below, and room above


class ArrayOps:
    """The steps on `xp`: numpy or cupy."""

    name = "NumPy"
    tiles = (4,)  # that are worth trying
    runs_at_once = 1  # that a measurement waits for together

    def __init__(self, xp=np):
        self.xp = xp

    # --- what a device must have besides the steps
    def empty(self, shape, dtype):
        return self.xp.empty(shape, dtype)

    def upload(self, array: np.ndarray):
        return self.xp.asarray(array)

    def lend(self, *kinds: list[np.ndarray]):
        """Tables, of each kind those of one shape, stacked on the device until the run is over."""
        return tuple(self.upload(np.stack(tables)) for tables in kinds)

    def end_of_run(self) -> None:
        """All that a run asks for has been asked for."""

    def download(self, array) -> np.ndarray:
        return array if self.xp is np else self.xp.asnumpy(array)

    def identity(self) -> str:
        """What measurements on this device hold for."""
        return f"{self.name} {platform.processor() or platform.machine()}"

    def pinned(self, shape, dtype) -> np.ndarray:
        """Memory of the processor that transfers run to and from."""
        return np.zeros(shape, dtype)

    def ways(self, depth: int):
        """How chunks come and go."""
        return _OneAfterTheOther()

    def clock(self):
        """A function that tells the seconds since it was last called."""
        before = time.perf_counter()

        def lap() -> float:
            nonlocal before
            self.synchronize()
            now = time.perf_counter()
            took, before = now - before, now
            return took

        self.synchronize()
        return lap

    def free_bytes(self) -> int:
        return 1 << 28

    def synchronize(self) -> None:
        pass

    # --- the steps
    def filters(self, delays, gains, form: Form):
        """Spectra of the links from their taps (segments, receivers, transmitters, P), and what a receiver's samples are then
        multiplied by, (segments, receivers). Source: H[k] = Σ_p g_p exp(-2πi k d_p / L)."""
        xp = self.xp
        scale = xp.ones(gains.shape[:2], xp.float32)
        if form.is_half:
            loudest = xp.abs(gains).sum(axis=-1).max(axis=-1)
            power = xp.where(loudest > 0, xp.ceil(xp.log2(xp.where(loudest > 0, loudest, 1))), 0)
            scale = xp.exp2(xp.clip(power, -100, 100) - np.log2(LARGEST_HALF)).astype(xp.float32)
            gains = gains / scale[:, :, None, None]
        taps = xp.zeros((*gains.shape[:3], form.n_bins), xp.complex64)
        where = tuple(xp.indices(gains.shape)[:3])
        xp.add.at(taps, (*where, delays), gains)
        spectra = xp.moveaxis(xp.fft.fft(taps, axis=-1).astype(xp.complex64), -1, 1)
        return self._stored(spectra, form), scale

    def forward(self, before, now, segments, n_blocks: int, form: Form, ends: Ends):
        """Spectra of the blocks of all segments."""
        xp = self.xp
        past = form.n_taps - 1
        reach = max(int(b) for b in segments[:, 0]) + n_blocks * form.step + form.n_bins
        u = self._unit(before[:, before.shape[1] - past :], ends), self._unit(now, ends)
        u = xp.concatenate([*u, xp.zeros((form.n_inputs, max(0, reach - past - now.shape[1])), xp.complex64)], axis=1)
        starts = segments[:, 0].astype(int)[:, None] + form.step * np.arange(n_blocks)  # (S, B)
        at = xp.asarray(starts[..., None] + np.arange(form.n_bins))  # (S, B, L)
        spectra = xp.fft.fft(u[:, at], axis=-1).astype(xp.complex64)  # (in, S, B, L)
        spectra = xp.ascontiguousarray(xp.transpose(spectra, (1, 3, 0, 2)))
        if not form.is_half:
            return (spectra,)
        return tuple(map(self._turned, self._stored(spectra, form)))

    def product(self, filters, spectra, form: Form):
        """Y[receiver, block] = Σ H[receiver, transmitter] · X[transmitter, block] in every bin of every segment."""
        xp = self.xp
        if not form.is_half:
            h, x = filters[0], spectra[0]
            if form.precision == "tf32":
                h, x = self._tf32(h), self._tf32(x)
            return xp.matmul(h, x)

        def times(h, x):  # (…, out, in, 2) and (…, 2 in, 2 B) as real matrices
            return xp.matmul(h.reshape(*h.shape[:-2], -1).astype(xp.float32), x.astype(xp.float32))

        total = times(filters[0], spectra[0])
        if form.precision == "split":
            total += times(filters[0], spectra[1]) + times(filters[1], spectra[0])
        return total.view(xp.complex64)

    def inverse(self, product, scale, segments, form: Form, ends: Ends, first_sample, out, partial, is_first, is_last, clipped):
        """Blocks back to samples, weighted and added to what `partial` holds of earlier layers; the last layer ends in `out`."""
        xp = self.xp
        blocks = xp.fft.ifft(product, axis=1)[:, form.n_taps - 1 :]  # (S, step, out, B)
        samples = xp.transpose(blocks, (0, 2, 3, 1)).reshape(blocks.shape[0], form.n_outputs, -1)
        for s, (begin, end, weight, slope) in enumerate(segments.tolist()):
            piece = samples[s, :, : int(end - begin)] * scale[s][:, None]
            self._put(piece, int(begin), weight, slope, ends, first_sample, out, partial, is_first, is_last, clipped)

    def direct(
        self, before, now, delays, gains, segments, form: Form, ends: Ends, first_sample, out, partial, is_first, is_last, clipped
    ):
        """The same by the definition: y_j[n] = Σ_i Σ_p g_ijp x_i[n - d_ijp]."""
        xp = self.xp
        past = form.n_taps - 1
        u = xp.concatenate([self._unit(before[:, before.shape[1] - past :], ends), self._unit(now, ends)], axis=1)
        for s, (begin, end, weight, slope) in enumerate(segments.tolist()):
            at = past + xp.arange(int(begin), int(end))
            piece = xp.zeros((form.n_outputs, len(at)), xp.complex64)
            for i in range(form.n_inputs):
                for p in range(gains.shape[-1]):
                    piece += gains[s, :, i, p][:, None] * u[i][at[None] - delays[s, :, i, p][:, None]]
            self._put(piece, int(begin), weight, slope, ends, first_sample, out, partial, is_first, is_last, clipped)

    def levels(self, samples, gain: float):
        """Power summed and the largest of it, per node, of (nodes, n) samples times `gain`."""
        xp = self.xp
        if samples.dtype == xp.int16:
            power = (samples.astype(xp.float32) ** 2).sum(axis=-1) * (gain / 32768) ** 2
        else:
            power = xp.abs(samples) ** 2 * gain**2
        return power.sum(axis=1, dtype=xp.float64), power.max(axis=1)

    # --- their parts
    def _unit(self, x, ends: Ends):
        xp = self.xp
        if x.dtype == xp.int16:
            return (x[..., 0] + 1j * x[..., 1].astype(xp.float32)).astype(xp.complex64) * xp.float32(1 / 32768)
        if not ends.levels_in:
            return x
        return self._round(x, ends.scale_in, ends.levels_in)[0] / xp.float32(ends.levels_in)

    def _round(self, x, scale, levels):
        """Steps of full scale / levels, and how many samples were beyond."""
        xp = self.xp
        parts = xp.rint(xp.stack([x.real, x.imag]) * xp.float32(levels / scale))
        beyond = (~(parts >= -levels) | (parts > levels - 1)).any(axis=0)
        real, imag = xp.where(xp.isnan(parts), xp.float32(0), xp.clip(parts, -levels, levels - 1))
        return (real + 1j * imag).astype(xp.complex64), beyond.sum()

    def count_clipped(self, now, ends: Ends, clipped) -> None:
        """Adds the samples that are beyond the inputs' full scale; integers are not."""
        if ends.levels_in and now.dtype != self.xp.int16:
            clipped += self._round(now, ends.scale_in, ends.levels_in)[1]

    def _put(self, piece, begin, weight, slope, ends, first_sample, out, partial, is_first, is_last, clipped):
        xp = self.xp
        n = piece.shape[1]
        piece = piece * xp.float32(ends.gain_back)
        piece = piece * (weight + slope * xp.arange(n)).astype(xp.float32)
        part = slice(begin, begin + n)
        if not is_first:
            piece = piece + partial[:, part]
        if not is_last:
            partial[:, part] = piece
            return
        for rx, power in enumerate(() if ends.noise_power is None else ends.noise_power.tolist()):
            if power > 0:
                piece[rx] += xp.float32(np.sqrt(power)) * noise(xp, ends.seed, rx, first_sample + begin, n)
        if ends.levels_out:
            steps, beyond = self._round(piece, ends.scale_out, ends.levels_out)
            clipped += beyond
            if ends.int16_out:
                out[:, part, 0], out[:, part, 1] = steps.real, steps.imag
                return
            piece = steps * xp.float32(ends.scale_out / ends.levels_out)
        out[:, part] = piece

    def _stored(self, spectra, form: Form):
        """As complex64, or as halves (…, 2): what rounding leaves makes the second array of `split`."""
        xp = self.xp
        if not form.is_half:
            return (xp.ascontiguousarray(spectra),)
        parts = xp.stack([spectra.real, spectra.imag], axis=-1)
        high = parts.astype(xp.float16)
        return (high,) if form.precision == "fp16" else (high, (parts - high.astype(xp.float32)).astype(xp.float16))

    def _turned(self, halves):
        """(…, node, block, 2) as real matrices (…, 2 node, 2 block): a row (re, im) and the same times i, (-im, re)."""
        xp = self.xp
        turned = xp.stack([-halves[..., 1], halves[..., 0]], axis=-1)
        pair = xp.stack([halves, turned], axis=-3)
        return xp.ascontiguousarray(pair.reshape(*halves.shape[:-3], 2 * halves.shape[-3], 2 * halves.shape[-2]))

    def _tf32(self, values):
        """Both parts rounded to the ten fractional bits that tensor cores read of a float."""
        xp = self.xp
        bits = xp.ascontiguousarray(values).view(xp.uint32)
        return ((bits + xp.uint32(0x1000)) & xp.uint32(0xFFFFE000)).view(xp.complex64).reshape(values.shape)


class _OneAfterTheOther:
    """Ways of chunks where nothing runs beside anything else."""

    def up(self, k, device, host):
        self._begun = time.perf_counter()
        device[...] = host

    def computing(self, k):
        return contextlib.nullcontext()

    def down(self, k, host, device):
        host[...] = device
        self._took_s = time.perf_counter() - self._begun

    def wait(self, k):
        pass

    def took_s(self, k) -> float:
        return self._took_s


def noise(xp, seed: int, receiver: int, first_sample: int, n: int):
    """Circular Gaussian noise of unit power, complex64 (n,): `reference.receiver_noise` in single precision.

    Philox4x32-10 (Salmon et al., SC11) keyed by the seed and counted by pairs of samples, then Box-Muller.
    """
    begin = first_sample // 2
    pair = xp.arange(begin, (first_sample + n + 1) // 2, dtype=xp.uint64)
    low, half = xp.uint64(0xFFFFFFFF), xp.uint64(32)
    c = [pair & low, pair >> half, xp.full_like(pair, receiver), xp.zeros_like(pair)]
    key = [seed & 0xFFFFFFFF, seed >> 32]
    for _ in range(10):
        a, b = xp.uint64(0xD2511F53) * c[0], xp.uint64(0xCD9E8D57) * c[2]
        c = [(b >> half) ^ c[1] ^ xp.uint64(key[0]), b & low, (a >> half) ^ c[3] ^ xp.uint64(key[1]), a & low]
        key = [(key[0] + 0x9E3779B9) & 0xFFFFFFFF, (key[1] + 0xBB67AE85) & 0xFFFFFFFF]
    radius = [xp.sqrt(-xp.log(((word >> xp.uint64(8)).astype(xp.float32) + xp.float32(0.5)) / 2**24)) for word in (c[0], c[2])]
    turn = [word.astype(xp.int64).astype(xp.float64) * (2 * np.pi / 2**32) for word in (c[1], c[3])]
    pairs = xp.stack([r * xp.exp(1j * t) for r, t in zip(radius, turn, strict=True)], axis=1)
    return pairs.ravel()[first_sample - 2 * begin :][:n].astype(xp.complex64)
