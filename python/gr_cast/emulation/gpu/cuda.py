# SPDX-License-Identifier: GPL-3.0-or-later
"""The steps of the network as CUDA kernels and products of cuBLAS, compiled at run time by CuPy."""

import contextlib
import functools
import hashlib
from pathlib import Path

import numpy as np

from .arrays import ArrayOps
from .form import Ends, Form

_SOURCE = Path(__file__).with_name("kernels.cu")
_STORED = {"fp32": 0, "tf32": 0, "fp16": 1, "split": 2}
_DENSE_FROM = 48  # taps of a link, from which on a transform makes its spectrum sooner than phasors do
_BINS_PER_THREAD = 32  # bins_per_thread in kernels.cu
_WIDE, _SAMPLES_EACH = 256, 4  # wide and samples_each there
_MOST_SMALLS = 256
_UPLOADS = 8  # tables that may be on their way at once
_PINNED = 1  # cudaMemoryTypeHost
_ALIGNED = 256  # bytes that a table begins at a multiple of


def defines(form: Form, int16_in: bool, int16_out: bool) -> tuple[str, ...]:
    """What kernels.cu is compiled with."""
    values = {
        "BINS": form.n_bins, "TILE": form.tile, "PAST": form.n_taps - 1, "STORED": _STORED[form.precision],
        "INT16_IN": int(int16_in), "INT16_OUT": int(int16_out),
    }  # fmt: skip
    return tuple(f"-D{name}={value}" for name, value in values.items())


def compile_with_cupy(options: tuple[str, ...]):
    """Kernels by name, for the card at hand."""
    import cupy

    module = cupy.RawModule(code=_SOURCE.read_text(), options=("-std=c++17", *options), backend="nvrtc")
    return module.get_function


class CudaOps(ArrayOps):
    """The steps on a card; `compile(options)` gives kernels by name, `product` multiplies by cuBLAS."""

    name = "CUDA"
    tiles = (4, 8)
    runs_at_once = 4

    def __init__(self, xp, compile=compile_with_cupy):
        super().__init__(xp)
        self._compile = compile
        self._modules, self._functions, self._twiddles, self._smalls = {}, {}, {}, {}

    def _launch(self, name, form: Form, ends: Ends, grid, block, arguments, shared=0):
        key = (form, ends.int16_in, ends.int16_out, name)
        if key not in self._functions:
            options = defines(form, ends.int16_in, ends.int16_out)
            if options not in self._modules:
                self._modules[options] = self._compile(options)
            function = self._modules[options](name)
            if shared > 48 << 10:  # more than every card grants unasked
                function.max_dynamic_shared_size_bytes = shared
            self._functions[key] = function
        self._functions[key](grid, block, arguments, shared_mem=shared)

    def _twiddle(self, n_bins: int):
        if n_bins not in self._twiddles:
            self._twiddles[n_bins] = self.upload(np.exp(-2j * np.pi * np.arange(n_bins) / n_bins).astype(np.complex64))
        return self._twiddles[n_bins]

    def _small(self, array: np.ndarray):
        """A small table on the device; the next chunk often has the same."""
        key = (array.dtype.char, array.tobytes())
        if key not in self._smalls:
            if len(self._smalls) >= _MOST_SMALLS:
                self._smalls.clear()
            self._smalls[key] = self.upload(array)
        return self._smalls[key]

    def filters(self, delays, gains, form: Form):
        xp = self.xp
        n_segments, n_outputs, n_inputs, n_taps = gains.shape
        n_links = n_outputs * n_inputs
        ends = Ends()
        if form.is_half:
            scale = xp.empty((n_segments, n_outputs), xp.float32)
            arguments = (gains, np.int32(n_inputs), np.int32(n_taps), scale)
            self._launch("scales", form, ends, (n_segments * n_outputs, 1, 1), (128, 1, 1), arguments, 128 * 8)
        else:
            scale = xp.ones((n_segments, n_outputs), xp.float32)
        made = self._spectra((n_segments, form.n_bins, n_outputs, n_inputs), form)
        arguments = (
            delays, gains, scale, np.int32(n_inputs), np.int32(n_links), np.int32(n_taps), self._twiddle(form.n_bins),
            made[0], made[-1],
        )  # fmt: skip
        if n_taps < _DENSE_FROM:
            grid = (-(-n_links // 128), form.n_bins // _BINS_PER_THREAD, n_segments)
            self._launch("sparse_filters", form, ends, grid, (128, 1, 1), arguments)
        else:
            grid = (-(-n_links // form.tile), n_segments, 1)
            self._launch("dense_filters", form, ends, grid, *_team(form, arguments))
        return made, scale

    def forward(self, before, now, segments, n_blocks: int, form: Form, ends: Ends):
        rows = 2 * form.n_inputs if form.is_half else form.n_inputs
        columns = 2 * n_blocks if form.is_half else n_blocks
        shape = (len(segments), form.n_bins, rows, columns)
        made = tuple(
            self.xp.empty(shape, np.float16 if form.is_half else np.complex64)
            for _ in range(2 if form.precision == "split" else 1)
        )
        arguments = (
            *self._inputs(before, now, ends), np.int32(form.n_inputs), self._small(segments), np.int32(n_blocks),
            self._twiddle(form.n_bins), made[0], made[-1],
        )  # fmt: skip
        grid = (n_blocks // form.tile, form.n_inputs, len(segments))
        self._launch("forward", form, ends, grid, *_team(form, arguments))
        return made

    def inverse(self, product, scale, segments, form: Form, ends: Ends, first_sample, out, partial, is_first, is_last, clipped):
        n_blocks = product.shape[-1]
        arguments = (
            product, scale, self._small(segments), np.int32(n_blocks), np.int32(form.n_outputs), self._twiddle(form.n_bins),
            *self._outputs(ends, first_sample, out, partial, is_first, is_last, clipped),
        )  # fmt: skip
        grid = (n_blocks // form.tile, form.n_outputs, len(segments))
        self._launch("inverse", form, ends, grid, *_team(form, arguments))

    def direct(
        self, before, now, delays, gains, segments, form: Form, ends: Ends, first_sample, out, partial, is_first, is_last, clipped
    ):
        longest = int(max(segments[:, 1] - segments[:, 0]))
        arguments = (
            *self._inputs(before, now, ends), delays, gains, np.int32(form.n_inputs), np.int32(gains.shape[-1]),
            self._small(segments), np.int32(form.n_outputs),
            *self._outputs(ends, first_sample, out, partial, is_first, is_last, clipped),
        )  # fmt: skip
        grid = (-(-longest // (_WIDE * _SAMPLES_EACH)), form.n_outputs, len(segments))
        self._launch("direct", form, ends, grid, (_WIDE, 1, 1), arguments, _WIDE * 16)

    def _spectra(self, shape, form: Form):
        if not form.is_half:
            return (self.xp.empty(shape, np.complex64),)
        return tuple(self.xp.empty((*shape, 2), np.float16) for _ in range(2 if form.precision == "split" else 1))

    def _inputs(self, before, now, ends: Ends):
        if now.dtype != (np.int16 if ends.int16_in else np.complex64):
            raise TypeError(f"samples in: got {now.dtype}")
        size = 4 if ends.int16_in else 8
        return (
            before, np.int64(before.strides[0] // size), np.int32(before.shape[1]), now, np.int64(now.strides[0] // size),
            np.int32(now.shape[1]), np.float32(ends.gain_in), np.float32(ends.levels_in),
        )  # fmt: skip

    def _outputs(self, ends: Ends, first_sample, out, partial, is_first, is_last, clipped):
        powers = ends.noise_power
        noisy = powers is not None and bool(powers.any())
        noise = self._small(np.sqrt(powers).astype(np.float32)) if noisy else self._null()
        size = 4 if ends.int16_out else 8
        return (
            out, self._null() if partial is None else partial, np.int64(out.strides[0] // size), np.int32(is_first),
            np.int32(is_last), np.float32(ends.gain_back), np.float32(ends.levels_out), np.float32(ends.scale_out), noise,
            np.uint32(ends.seed & 0xFFFFFFFF), np.uint32(ends.seed >> 32), np.uint64(first_sample), clipped,
        )  # fmt: skip

    def _null(self):
        return np.uintp(0)


def _team(form: Form, arguments):
    """Threads, arguments and shared memory of a block that transforms `tile` rows at once."""
    row = form.n_bins + form.n_bins // 16 + 4
    return (form.tile * form.n_bins // 16, 1, 1), arguments, form.tile * row * 8


class CardOps(CudaOps):
    """On a card by CuPy."""

    def __init__(self, cupy):
        super().__init__(cupy)
        self._pinned, self._turn = [None] * _UPLOADS, 0
        self._lent, self._lent_turn = [None] * _UPLOADS, 0
        self.upload_stream = None  # for tables of taps; None: the current one
        properties = cupy.cuda.runtime.getDeviceProperties(cupy.cuda.runtime.getDevice())
        self.name = properties["name"].decode()

    def identity(self) -> str:
        runtime = self.xp.cuda.runtime
        source = hashlib.sha256(_SOURCE.read_bytes()).hexdigest()[:12]
        return f"{self.name} {runtime.driverGetVersion()} {runtime.runtimeGetVersion()} {source}"

    @functools.cached_property
    def _blas(self):
        from cupy_backends.cuda.libs import cublas

        return cublas

    def upload(self, array: np.ndarray):
        """A copy on the card; through pinned memory, so that nobody waits for what the card does at the moment."""
        cupy = self.xp
        array = np.ascontiguousarray(array)
        slot, self._turn = self._turn, (self._turn + 1) % _UPLOADS
        memory, size, event = self._pinned[slot] or (None, 0, None)
        if event:
            event.synchronize()
        if size < array.nbytes:
            size = max(array.nbytes, 1 << 16)
            memory = cupy.cuda.alloc_pinned_memory(size)
        staged = np.frombuffer(memory, array.dtype, array.size).reshape(array.shape)
        staged[...] = array
        made = cupy.empty(array.shape, array.dtype)
        stream = cupy.cuda.get_current_stream()
        made.data.copy_from_host_async(staged.ctypes.data, array.nbytes, stream)
        event = event or cupy.cuda.Event(disable_timing=True)
        event.record(stream)
        self._pinned[slot] = memory, size, event
        return made

    def pinned(self, shape, dtype) -> np.ndarray:
        count = int(np.prod(shape))
        memory = self.xp.cuda.alloc_pinned_memory(count * np.dtype(dtype).itemsize)
        made = np.frombuffer(memory, dtype, count).reshape(shape)
        made[...] = 0
        return made

    def ways(self, depth: int):
        return _Ways(self, depth)

    def lend(self, *kinds: list[np.ndarray]):
        # Into a ring of buffers on the card: what a run still reads is not written over by the next one's tables. From where
        # they lie if that is pinned; else by one transfer through pinned memory.
        cupy = self.xp
        begins = [0, *np.cumsum([-(-sum(table.nbytes for table in tables) // _ALIGNED) * _ALIGNED for tables in kinds]).tolist()]
        n_bytes = begins[-1]
        compute = cupy.cuda.get_current_stream()
        carrier = self.upload_stream or compute
        turn, self._lent_turn = self._lent_turn, (self._lent_turn + 1) % _UPLOADS
        slot = self._lent[turn]
        if slot is None or slot.n_bytes < n_bytes:
            if slot:
                self.synchronize()
            slot = self._lent[turn] = _Lent(cupy, max(n_bytes, 1 << 16))
        slot.copied.synchronize()
        slot.sources = kinds  # they stay until they are copied
        if slot.in_use:  # this very run has come round
            slot.used.record(compute)
        carrier.wait_event(slot.used)
        in_place = all(self._is_pinned(table) for tables in kinds for table in tables)
        made = []
        for begin, tables in zip(begins, kinds, strict=False):
            shape, dtype = (len(tables), *tables[0].shape), tables[0].dtype
            made.append(cupy.ndarray(shape, dtype, slot.memory + begin))
            if in_place:
                for k, table in enumerate(tables):
                    (slot.memory + begin + k * table.nbytes).copy_from_host_async(table.ctypes.data, table.nbytes, carrier)
            else:
                np.stack(tables, out=np.frombuffer(slot.pinned, dtype, int(np.prod(shape)), begin).reshape(shape))
        if not in_place:
            slot.memory.copy_from_host_async(slot.address, n_bytes, carrier)
        slot.copied.record(carrier)
        compute.wait_event(slot.copied)
        slot.in_use = True
        return made

    def _is_pinned(self, array: np.ndarray) -> bool:
        attributes = self.xp.cuda.runtime.pointerGetAttributes(array.ctypes.data)
        return attributes.type == _PINNED and array.flags.c_contiguous

    def end_of_run(self) -> None:
        stream = self.xp.cuda.get_current_stream()
        for slot in self._lent:
            if slot and slot.in_use:
                slot.used.record(stream)
                slot.in_use = False

    def free_bytes(self) -> int:
        return self.xp.cuda.runtime.memGetInfo()[0] + self.xp.get_default_memory_pool().free_bytes()

    def synchronize(self) -> None:
        self.xp.cuda.get_current_stream().synchronize()

    def product(self, filters, spectra, form: Form):
        # cuBLAS counts rows where we count columns: the product is X^T H^T.
        n_segments, n_bins = spectra[0].shape[:2]
        n_blocks = spectra[0].shape[-1] // (2 if form.is_half else 1)
        made = self.xp.empty((n_segments, n_bins, form.n_outputs, n_blocks), np.complex64)
        blas = self._blas
        if not form.is_half:
            kind = blas.CUBLAS_COMPUTE_32F_FAST_TF32 if form.precision == "tf32" else blas.CUBLAS_COMPUTE_32F
            one, zero = np.ones(1, np.complex64), np.zeros(1, np.complex64)
            sizes = (n_blocks, form.n_outputs, form.n_inputs)
            self._multiply(sizes, spectra[0], filters[0], made, n_segments * n_bins, one, zero, (4, 4), kind)
            return made
        one, zero = np.ones(1, np.float32), np.zeros(1, np.float32)
        sizes = (2 * n_blocks, form.n_outputs, 2 * form.n_inputs)
        pairs = [(0, 0)] if form.precision == "fp16" else [(0, 0), (1, 0), (0, 1)]
        for k, (x, h) in enumerate(pairs):
            self._multiply(
                sizes, spectra[x], filters[h], made, n_segments * n_bins, one, one if k else zero, (2, 0), blas.CUBLAS_COMPUTE_32F
            )
        return made

    def _multiply(self, sizes, x, h, made, batch, one, other, types, kind):
        m, n, k = sizes
        in_type, out_type = types  # cudaDataType_t: 0 float, 2 half, 4 complex
        self._blas.gemmStridedBatchedEx(
            self.xp.cuda.device.get_cublas_handle(), 0, 0, m, n, k, one.ctypes.data, x.data.ptr, in_type, m, m * k,
            h.data.ptr, in_type, k, k * n, other.ctypes.data, made.data.ptr, out_type, m, m * n, batch, kind, -1,
        )  # fmt: skip


class _Lent:
    """One place of the ring of tables: pinned and on the card, when it was copied and when it was last read."""

    def __init__(self, cupy, n_bytes: int):
        self.n_bytes, self.in_use, self.sources = n_bytes, False, ()
        self.pinned = cupy.cuda.alloc_pinned_memory(n_bytes)
        self.address = np.frombuffer(self.pinned, np.uint8).ctypes.data
        self.memory = cupy.cuda.alloc(n_bytes)
        self.copied, self.used = (cupy.cuda.Event(disable_timing=True) for _ in range(2))
        for event in (self.copied, self.used):
            event.record()


class _Ways:
    """Chunks up, through the card and down on three streams, each step of a chunk behind the one before. A place is taken again
    only when the chunk that had it was waited for."""

    def __init__(self, ops: CardOps, depth: int):
        cuda = ops.xp.cuda
        self._ops, self._depth = ops, depth
        self._up, self._work, self._down = (cuda.Stream(non_blocking=True) for _ in range(3))
        self._begun, self._came, self._made, self._gone = ([cuda.Event() for _ in range(depth)] for _ in range(4))
        self._elapsed_ms = cuda.get_elapsed_time
        ops.synchronize()  # what the buffers were filled with, on another stream

    def up(self, k, device, host):
        slot = k % self._depth
        self._begun[slot].record(self._up)
        device.data.copy_from_host_async(host.ctypes.data, host.nbytes, self._up)
        self._came[slot].record(self._up)

    @contextlib.contextmanager
    def computing(self, k):
        slot = k % self._depth
        self._work.wait_event(self._came[slot])
        self._ops.upload_stream = self._up
        try:
            with self._work:
                yield
        finally:
            self._ops.upload_stream = None
        self._made[slot].record(self._work)

    def down(self, k, host, device):
        slot = k % self._depth
        self._down.wait_event(self._made[slot])
        device.data.copy_to_host_async(host.ctypes.data, host.nbytes, self._down)
        self._gone[slot].record(self._down)

    def wait(self, k):
        self._gone[k % self._depth].synchronize()

    def took_s(self, k) -> float:
        slot = k % self._depth
        return self._elapsed_ms(self._begun[slot], self._gone[slot]) * 1e-3
