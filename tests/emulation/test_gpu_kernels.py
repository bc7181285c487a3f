# SPDX-License-Identifier: GPL-3.0-or-later
"""The CUDA kernels, compiled for the processor with CUDA stood in for, make what NumPy makes of the same steps."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from gr_cast.emulation.gpu.arrays import ArrayOps
from gr_cast.emulation.gpu.cuda import _SOURCE, CudaOps, defines
from gr_cast.emulation.gpu.form import DELAY_TYPE, Ends, Form

sys.path.append(str(Path(__file__).resolve().parent))
from fake_cupy import compile_for_host


@pytest.fixture(scope="module")
def kernels():
    if shutil.which("g++") is None:
        pytest.skip("NO G++: the CUDA kernels are not run on the processor")
    return CudaOps(np, compile_for_host)


def close(got, wanted, within):
    """No element is further off than so many times the largest."""
    got, wanted = np.asarray(got, complex), np.asarray(wanted, complex)
    assert got.shape == wanted.shape
    assert np.abs(got - wanted).max() <= within * np.abs(wanted).max()


def random_samples(rng, shape, int16):
    if int16:
        return rng.integers(-20000, 20000, (*shape, 2), dtype=np.int16)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)


def random_links(rng, form, n_segments, n_taps):
    delays = np.argsort(rng.random((n_segments, form.n_outputs, form.n_inputs, form.n_taps)), axis=-1)[..., :n_taps]
    gains = random_samples(rng, delays.shape, False) * 10.0 ** rng.integers(-4, 3, delays.shape[:3])[..., None]
    gains[0, 0, 0] = 0
    delays[..., 1] = delays[..., 0]  # two taps of one delay add
    return np.ascontiguousarray(delays, DELAY_TYPE), gains.astype(np.complex64)


SEGMENTS = np.array([[0, 1337, 1, 0], [1337, 1500, 1, 0], [1500, 2750, 1, 0.0]])
FORMS = [
    dict(precision="fp32", n_bins=512, tile=4),
    dict(precision="fp16", n_bins=1024, tile=8),
    dict(precision="split", n_bins=2048, tile=4),
    dict(precision="tf32", n_bins=4096, tile=4),
]
ERROR = {"fp32": 1e-6, "tf32": 1e-6, "fp16": 1e-3, "split": 1e-6}  # a half may round the other way


def joined(arrays):
    """Halves and what they leave, as numbers."""
    return sum(np.asarray(a, np.float64) for a in arrays) if arrays[0].dtype == np.float16 else arrays[0]


@pytest.mark.parametrize("shape", FORMS, ids=lambda shape: shape["precision"])
@pytest.mark.parametrize("n_taps", [5, 60])
def test_spectra_of_links_are_those_of_numpy(kernels, shape, n_taps):
    form = Form(n_inputs=3, n_outputs=2, n_taps=100, **shape)
    delays, gains = random_links(np.random.default_rng(1), form, 2, n_taps)
    (got, scale), (wanted, law) = (ops.filters(delays, gains, form) for ops in (kernels, ArrayOps()))
    np.testing.assert_array_equal(scale, law)
    for row in np.ndindex(2, 2):  # a receiver's own loudest link is what its spectra are measured against
        close(joined(got)[row[0], :, row[1]], joined(wanted)[row[0], :, row[1]], ERROR[form.precision])


@pytest.mark.parametrize("shape", FORMS, ids=lambda shape: shape["precision"])
@pytest.mark.parametrize("int16", [False, True])
def test_spectra_of_blocks_are_those_of_numpy(kernels, shape, int16):
    form = Form(n_inputs=2, n_outputs=2, n_taps=100, **shape)
    x = random_samples(np.random.default_rng(2), (2, 130 + 2750), int16)
    ends = Ends(int16_in=int16)
    n_blocks = form.blocks(1337)
    got, wanted = (ops.forward(x[:, :130], x[:, 130:], SEGMENTS, n_blocks, form, ends) for ops in (kernels, ArrayOps()))
    got, wanted = joined(got), joined(wanted)
    for s, (begin, end) in enumerate(SEGMENTS[:, :2].astype(int)):
        used = -(-(end - begin) // form.step) * (2 if form.is_half else 1)
        close(got[s, ..., :used], wanted[s, ..., :used], ERROR[form.precision])


@pytest.mark.parametrize("shape", FORMS[:2], ids=lambda shape: shape["precision"])
@pytest.mark.parametrize("ends", [dict(), dict(levels_out=2048, scale_out=0.7), dict(levels_out=32768, int16_out=True)], ids=str)
@pytest.mark.parametrize("method", ["inverse", "direct"])
def test_samples_out_are_those_of_numpy_with_noise_rounding_and_layers(kernels, shape, ends, method):
    form = Form(n_inputs=2, n_outputs=3, n_taps=100, **shape)
    rng = np.random.default_rng(3)
    ends = Ends(noise_power=np.array([0, 1e-2, 0]), seed=(7 << 32) + 5, **ends)
    x = random_samples(rng, (2, 99 + 2750), False) * np.complex64(0.3)
    delays, gains = random_links(rng, form, 3, 4)
    gains /= np.abs(gains).max()
    results = []
    for ops in (kernels, ArrayOps()):
        clipped = np.zeros(1, np.int64)
        shape_out = (3, 2750, 2) if ends.int16_out else (3, 2750)
        out, partial = np.zeros(shape_out, np.int16 if ends.int16_out else np.complex64), np.zeros((3, 2750), np.complex64)
        for layer, slope in enumerate((0, 1e-4)):
            table = SEGMENTS + np.array([0, 0, -0.5 * layer, slope])
            end = (12345, out, partial, layer == 0, layer == 1, clipped)
            if method == "direct":
                ops.direct(x[:, :99], x[:, 99:], delays, gains, table, form, ends, *end)
                continue
            spectra = ArrayOps().forward(x[:, :99], x[:, 99:], table, form.blocks(1337), form, ends)
            filters, scale = ArrayOps().filters(delays, gains, form)
            ops.inverse(ArrayOps().product(filters, spectra, form), scale, table, form, ends, *end)
        results.append((out, int(clipped[0])))
    (got, clipped), (wanted, law) = results
    if ends.int16_out:
        got, wanted = got.astype(float), wanted.astype(float)
        assert np.abs(got - wanted).max() <= 1  # a step, where the two round another way
        assert np.mean(got != wanted) < 1e-2
    elif ends.levels_out:
        assert np.abs(got - wanted).max() <= 1.01 * np.sqrt(2) * ends.scale_out / ends.levels_out
        assert np.mean(np.abs(got - wanted) > 1e-6) < 1e-2
    else:
        close(got, wanted, 1e-5)
    assert abs(clipped - law) <= 2


@pytest.mark.parametrize("card", ["sm_80", "sm_90"])
@pytest.mark.parametrize("shape", FORMS, ids=lambda shape: shape["precision"])
def test_kernels_compile_for_cards_by_nvrtc(card, shape):
    """To machine code, with no card: NVRTC alone does it."""
    nvrtc = pytest.importorskip("cupy_backends.cuda.libs.nvrtc", reason="NO CUPY: the CUDA kernels are not compiled by NVRTC")
    form = Form(n_inputs=2, n_outputs=2, n_taps=200, **shape)
    for int16 in (False, True):
        program = nvrtc.createProgram(_SOURCE.read_text(), "kernels.cu", (), ())
        nvrtc.compileProgram(program, ("-std=c++17", f"--gpu-architecture={card}", *defines(form, int16, not int16)))
        assert len(nvrtc.getCUBIN(program)) > 10_000
