# SPDX-License-Identifier: GPL-3.0-or-later
"""As much of CuPy as gr_cast asks for, on the processor: arrays of NumPy, kernels compiled by g++, cuBLAS's product as its manual
defines it. A fault can be planted in any call."""

import contextlib
import ctypes
import functools
import hashlib
import subprocess
import sys
import tempfile
import types
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent / "host_cuda"
KERNELS = Path(__file__).resolve().parents[2] / "python" / "gr_cast" / "emulation" / "gpu"


@functools.cache
def compile_for_host(options):
    """kernels.cu, compiled with these options, as functions by name that are called as CuPy's are."""
    path = Path(_folder().name) / f"{hashlib.sha256(repr(options).encode()).hexdigest()}.so"
    command = ["g++", "-std=c++17", "-O1", "-shared", "-fPIC", "-w", f"-I{HERE}", f"-I{KERNELS}", *options]
    subprocess.run([*command, HERE / "host_kernels.cc", "-o", path], check=True)
    library = ctypes.CDLL(str(path))
    return lambda name: _Kernel(library[f"launch_{name}"])


@functools.cache
def _folder():
    return tempfile.TemporaryDirectory()


class _Kernel:
    """As cupy.RawKernel: grid, block, arguments, by the types that NumPy gives them."""

    def __init__(self, launch):
        self._launch = launch
        self.max_dynamic_shared_size_bytes = 48 << 10

    def __call__(self, grid, block, arguments, shared_mem=0):
        assert shared_mem <= self.max_dynamic_shared_size_bytes <= 227 << 10
        assert block[0] <= 1024 and max(grid[1:]) < 1 << 16
        assert all(isinstance(a, np.ndarray | np.generic) for a in arguments)
        holders = [np.array(a.ctypes.data if isinstance(a, np.ndarray) else a) for a in arguments]
        pointers = (ctypes.c_void_p * len(holders))(*(held.ctypes.data for held in holders))
        self._launch((ctypes.c_uint * 3)(*grid), ctypes.c_uint(block[0]), ctypes.c_size_t(shared_mem), pointers)


class _Array(np.ndarray):
    @property
    def data(self):
        return _Memory(self)


class _Memory:
    def __init__(self, array):
        self.ptr = array.ctypes.data

    def copy_from_host_async(self, address, n_bytes, stream):
        ctypes.memmove(self.ptr, address, n_bytes)

    def copy_to_host_async(self, address, n_bytes, stream):
        ctypes.memmove(address, self.ptr, n_bytes)


class _Pointer:
    """As cupy.cuda.MemoryPointer."""

    def __init__(self, memory):
        self.memory = memory

    def __add__(self, n_bytes):
        return _Pointer(self.memory[n_bytes:])

    def copy_from_host_async(self, address, n_bytes, stream):
        ctypes.memmove(self.memory.ctypes.data, address, n_bytes)


class CUDARuntimeError(RuntimeError):
    """Of cupy_backends.cuda.api.runtime."""


class OutOfMemoryError(MemoryError):
    """Of cupy.cuda.memory."""


CUDARuntimeError.__module__ = "cupy_backends.cuda.api.runtime"
OutOfMemoryError.__module__ = "cupy.cuda.memory"
_TYPES = {0: np.float32, 2: np.float16, 4: np.complex64}


def _matrices(address, kind, rows, columns, stride, batch):
    """Column-major matrices, densely packed: an array (batch, rows, columns)."""
    assert stride == rows * columns
    dtype = np.dtype(_TYPES[kind])
    size = batch * stride * dtype.itemsize
    flat = np.frombuffer((ctypes.c_char * size).from_address(address), dtype)
    return flat.reshape(batch, columns, rows).swapaxes(1, 2)


def _gemm(handle, ta, tb, m, n, k, alpha, a, a_type, lda, a_stride, b, b_type, ldb, b_stride, beta, c, c_type, ldc, c_stride,
          batch, compute, algorithm):  # fmt: skip
    """C = alpha A B + beta C of a batch of column-major matrices."""
    assert (ta, tb, lda, ldb, ldc) == (0, 0, m, k, m)
    one, other = (np.frombuffer((ctypes.c_char * 8).from_address(address), _TYPES[c_type])[0] for address in (alpha, beta))
    left, right = _matrices(a, a_type, m, k, a_stride, batch), _matrices(b, b_type, k, n, b_stride, batch)
    result = _matrices(c, c_type, m, n, c_stride, batch)
    if other == 0:
        result[...] = 0
    result[...] = other * result + one * (left.astype(_TYPES[c_type]) @ right.astype(_TYPES[c_type]))


def install(monkeypatch, faults=None):
    """Have `import cupy` find this; `faults` maps a call (getDeviceCount, empty, launch) to what it raises after how many."""
    faults = dict(faults or {})
    counts = {}

    def asked(call):
        error, after = faults.get(call, (None, 0))
        counts[call] = counts.get(call, 0) + 1
        if error and counts[call] > after:
            raise error

    def empty(shape, dtype=float):
        asked("empty")
        made = np.empty(shape, dtype).view(_Array)
        made.view(np.uint8).fill(0xFF)  # what nobody wrote is NaN
        return made

    def device_count():
        asked("getDeviceCount")
        return 1

    class Module:
        def __init__(self, code, options, backend):
            assert "extern" in code and options[0] == "-std=c++17" and backend == "nvrtc"
            self._compiled = compile_for_host(options[1:])

        def get_function(self, name):
            kernel = self._compiled(name)

            def launch(*arguments, **more):
                asked("launch")
                kernel(*arguments, **more)

            return kernel if not faults else _Faulty(kernel, launch)

    event = types.SimpleNamespace(record=lambda stream=None: None, synchronize=lambda: None)
    pinned = []

    def alloc_pinned_memory(n_bytes):
        pinned.append(bytearray(n_bytes))
        return pinned[-1]

    def attributes(address):
        begins = [np.frombuffer(memory, np.uint8).ctypes.data for memory in pinned]
        is_pinned = any(begin <= address < begin + len(memory) for begin, memory in zip(begins, pinned, strict=True))
        return types.SimpleNamespace(type=int(is_pinned))

    runtime = types.SimpleNamespace(
        getDeviceCount=device_count, getDevice=lambda: 0, getDeviceProperties=lambda n: {"name": b"a card that is none"},
        driverGetVersion=lambda: 13000, runtimeGetVersion=lambda: 13000, memGetInfo=lambda: (1 << 26, 1 << 27),
        pointerGetAttributes=attributes,
    )  # fmt: skip
    cupy = types.ModuleType("cupy")
    cupy.__getattr__ = lambda name: getattr(np, name)
    cupy.ndarray = lambda shape, dtype, pointer: np.ndarray(shape, dtype, pointer.memory).view(_Array)
    cupy.empty, cupy.RawModule, cupy.asnumpy = empty, Module, np.asarray
    cupy.get_default_memory_pool = lambda: types.SimpleNamespace(free_bytes=lambda: 0)
    cupy.cuda = types.SimpleNamespace(
        runtime=runtime, Event=lambda disable_timing=False: event, Stream=_Stream, get_current_stream=_Stream,
        alloc=lambda n: _Pointer(np.full(n, 0xFF, np.uint8)), alloc_pinned_memory=alloc_pinned_memory,
        get_elapsed_time=lambda begin, end: 1.0, device=types.SimpleNamespace(get_cublas_handle=lambda: 1),
    )  # fmt: skip
    cublas = types.SimpleNamespace(gemmStridedBatchedEx=_gemm, CUBLAS_COMPUTE_32F=68, CUBLAS_COMPUTE_32F_FAST_TF32=77)
    libs = types.ModuleType("cupy_backends.cuda.libs")
    libs.cublas = cublas
    for name in ("cupy_backends", "cupy_backends.cuda"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, "cupy", cupy)
    monkeypatch.setitem(sys.modules, "cupy_backends.cuda.libs", libs)


class _Faulty:
    def __init__(self, kernel, launch):
        self.__dict__["_kernel"], self.__dict__["_call"] = kernel, launch

    def __setattr__(self, name, value):
        setattr(self._kernel, name, value)

    def __call__(self, *arguments, **more):
        self._call(*arguments, **more)


class _Stream(contextlib.nullcontext):
    """As cupy.cuda.Stream, where everything has happened when it was asked for."""

    def __init__(self, non_blocking=False):
        super().__init__()

    def synchronize(self):
        pass

    def wait_event(self, event):
        pass
