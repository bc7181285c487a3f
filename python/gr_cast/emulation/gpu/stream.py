# SPDX-License-Identifier: GPL-3.0-or-later
"""Chunk after chunk from memory of the processor through a network on a card and back, transfers and work side by side."""

import numpy as np

from .network import DeviceNetwork

_DEPTH = 4  # chunks under way: one comes, one is computed, one goes, one waits


class Stream:
    """`take()` is where the samples of the next chunk are put, `push()` sends them off, `wait()` gives the oldest's result.

    At most `depth` chunks are under way. Samples are (nodes, chunk) as the network takes and gives them: complex64, or int16
    (nodes, chunk, 2).
    """

    depth = _DEPTH

    def __init__(self, network: DeviceNetwork, chunk: int):
        self.network, form, ends = network, network.form, network.ends
        if chunk < form.n_taps - 1:
            raise ValueError(f"chunk: got {chunk} samples, needs {form.n_taps - 1} or more")
        shapes = [(form.n_inputs, chunk, 2), (form.n_outputs, chunk, 2)]
        kinds = [ends.int16_in, ends.int16_out]
        dtypes = [np.int16 if is_int16 else np.complex64 for is_int16 in kinds]
        shapes = [shape if is_int16 else shape[:2] for shape, is_int16 in zip(shapes, kinds, strict=True)]
        ops = network.ops
        self._sent = [ops.pinned(shapes[0], dtypes[0]) for _ in range(_DEPTH)]
        self._heard = [ops.pinned(shapes[1], dtypes[1]) for _ in range(_DEPTH)]
        # One more on the card: the chunk before is still read for what of it is heard late.
        self._inputs = [ops.empty(shapes[0], dtypes[0]) for _ in range(_DEPTH + 1)]
        self._outputs = [ops.empty(shapes[1], dtypes[1]) for _ in range(_DEPTH)]
        for array in self._inputs:
            array[...] = 0
        self._ways = ops.ways(_DEPTH)
        self._pushed = self._waited = 0

    @property
    def under_way(self) -> int:
        return self._pushed - self._waited

    def take(self) -> np.ndarray:
        """Where the next chunk's samples go; free as soon as fewer than `depth` are under way."""
        if self.under_way == _DEPTH:
            raise RuntimeError(f"{_DEPTH} chunks are under way: wait() for one first")
        return self._sent[self._pushed % _DEPTH]

    def push(self) -> None:
        """Send what was put into take() off."""
        self.take()  # room
        k = self._pushed
        now, before = self._inputs[k % (_DEPTH + 1)], self._inputs[(k - 1) % (_DEPTH + 1)]
        out = self._outputs[k % _DEPTH]
        self._ways.up(k, now, self._sent[k % _DEPTH])
        with self._ways.computing(k):
            self.network.run(before, now, out)
        self._ways.down(k, self._heard[k % _DEPTH], out)
        self._pushed += 1

    def wait(self) -> np.ndarray:
        """The oldest chunk under way, as its receivers hear it; it holds until the next chunk is pushed."""
        k = self._waited
        self._ways.wait(k)
        self._waited += 1
        return self._heard[k % _DEPTH]

    def took_s(self) -> float:
        """Seconds from the first byte of the chunk that was last waited for to the last byte of its result."""
        return self._ways.took_s(self._waited - 1)
