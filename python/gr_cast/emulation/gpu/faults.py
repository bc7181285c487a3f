# SPDX-License-Identifier: GPL-3.0-or-later
"""What can go wrong with a card, in one line."""

import contextlib

from ...core.errors import CastError


class DeviceFault(CastError):
    """The card cannot do it, or no longer; a processor can."""


@contextlib.contextmanager
def told():
    """Faults of CUDA and CuPy become one DeviceFault of one line."""
    try:
        yield
    except MemoryError as error:
        raise DeviceFault(f"--device cuda: the card's memory is full: {first_line(error)}") from None
    except ImportError as error:
        raise DeviceFault(
            f"--device cuda: {first_line(error)}: a library of CUDA is missing, or not the one CuPy is made for"
        ) from None
    except Exception as error:
        # What CuPy cannot load is an error of Python's own, and names a library.
        is_library = isinstance(error, RuntimeError | OSError) and ("libnv" in str(error) or "libcu" in str(error))
        if not (is_library or type(error).__module__.startswith(("cupy", "cuda."))):
            raise
        raise DeviceFault(f"--device cuda: {_meaning(error)}: {first_line(error)}") from None


def first_line(error: Exception) -> str:
    """What an error says first, or its name."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def _meaning(error: Exception) -> str:
    text = f"{type(error).__name__} {error}"
    for word, meaning in (
        ("OutOfMemory", "the card's memory is full"),
        ("MemoryAllocation", "the card's memory is full"),
        ("InsufficientDriver", "no driver of NVIDIA, or one older than this CuPy's CUDA"),
        ("NoDevice", "no card"),
        ("NVRTC", "kernels do not compile with this CUDA"),
        ("Compile", "kernels do not compile with this CUDA"),
        ("InvalidSource", "kernels are not for this card"),
        ("NoKernelImage", "kernels are not for this card"),
        ("SystemDriverMismatch", "driver and CUDA do not fit"),
        ("libnv", "a library of CUDA is missing, or not the one CuPy is made for"),
        ("libcu", "a library of CUDA is missing, or not the one CuPy is made for"),
    ):
        if word in text:
            return meaning
    return "the card has failed or is gone"
