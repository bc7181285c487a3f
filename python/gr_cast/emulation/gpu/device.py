# SPDX-License-Identifier: GPL-3.0-or-later
"""The card, or one clear line why there is none."""

import functools

import numpy as np

from .arrays import ArrayOps
from .cuda import CardOps
from .faults import DeviceFault, first_line, told

DEVICES = ("cpu", "cuda", "auto", "numpy")  # numpy: the steps of the card's arithmetic on the processor, slow


@functools.cache
def open_device(device: str) -> ArrayOps:
    """The steps on `device`: cuda or numpy. Raises DeviceFault where there is no card that works."""
    if device == "numpy":
        return ArrayOps(np)
    try:
        import cupy
    except ModuleNotFoundError as error:
        if error.name != "cupy":
            raise DeviceFault(f"--device cuda: CuPy lacks {error.name}") from None
        raise DeviceFault(
            "--device cuda: CuPy is not in this Python: pip install cupy-cuda12x, or cupy-cuda13x for drivers of CUDA 13"
        ) from None
    except ImportError as error:
        raise DeviceFault(f"--device cuda: CuPy does not load: {first_line(error)}") from None
    with told():
        if cupy.cuda.runtime.getDeviceCount() < 1:
            raise DeviceFault("--device cuda: no card")
        ops = CardOps(cupy)
        ops.upload(np.zeros(1))  # the first touch is what fails where driver and CUDA do not fit
        ops.synchronize()
        return ops
