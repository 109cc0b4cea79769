"""The kernels as plain Python, in a process with NUMBA_DISABLE_JIT: an index outside of an array is an error there.

Compiled, an index is not checked; and of one that is negative NumPy makes one that counts from the end.  Here both are
refused.  A thousand times as slow.
"""

from __future__ import annotations

import importlib
import operator
import pkgutil
from collections.abc import Callable
from typing import Any

import numpy as np


class Checked(np.ndarray):
    """An array whose single indices must lie inside of it."""

    def __getitem__(self, index: Any) -> Any:
        _check(self, index)
        return super().__getitem__(index)

    def __setitem__(self, index: Any, value: Any) -> None:
        _check(self, index)
        super().__setitem__(index, value)


def _check(array: np.ndarray, index: Any) -> None:
    places = index if isinstance(index, tuple) else (index,)
    for place, size in zip(places, array.shape, strict=False):
        if isinstance(place, slice):
            bad = any(end is not None and not 0 <= end <= size for end in (place.start, place.stop))
        elif isinstance(place, int | np.integer):
            bad = not 0 <= operator.index(place) < size
        else:
            continue
        if bad:
            raise IndexError(f"{place} in an array of {size}")


class Pointer:
    """What `replant.kernels.codegen.pointer` makes of an array: it must stay inside of the one that it points into."""

    def __init__(self, array: Any, start: int) -> None:
        flat, before = (array.flat_, array.start) if isinstance(array, Pointer) else (array.reshape(-1), 0)
        self.flat_, self.start = flat, before + int(start)

    def __getitem__(self, index: Any) -> Any:
        return self.flat_[self.start + int(index)]

    def __setitem__(self, index: Any, value: Any) -> None:
        self.flat_[self.start + int(index)] = value


def into_matrix(array: Any, start: int) -> Pointer:
    """Return a pointer into the whole matrix that an array is the first row of."""
    whole = getattr(array, "base", None)
    first = isinstance(whole, np.ndarray) and whole.ndim == 2 and whole.ctypes.data == array.ctypes.data
    return Pointer(np.asarray(whole).view(Checked) if first else array, start)


def make_plain() -> None:
    """Put the checked pointer and arrays in the place of those of the kernels."""
    import replant.kernels
    from replant.engine import dispatch
    from replant.kernels.optimizers import gradient
    from replant.online import identifier, startup

    for info in pkgutil.walk_packages(replant.kernels.__path__, "replant.kernels."):
        name = info.name.rpartition(".")[2]
        if name in ("simd", "by_address", "pointer") or name.startswith("ensemble"):
            continue
        module: Any = importlib.import_module(info.name)
        if hasattr(module, "pointer"):
            module.pointer = Pointer
        if hasattr(module, "prefetch"):
            module.prefetch = lambda *_: None
    # there a pointer to the first row of the buffer reaches the others
    gradient.pointer = into_matrix  # type: ignore[assignment]
    gradient.row_of = lambda buffer, k: Pointer(buffer, k * buffer.shape[1])  # type: ignore[assignment]
    step_kernels = dispatch.step_kernels

    def checked_step_kernels(*args: Any, **how: Any) -> Any:
        return tuple(map(checked, step_kernels(*args, **how)))

    for user in (dispatch, startup, identifier):
        user.step_kernels = checked_step_kernels  # type: ignore[attr-defined]


def checked(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return a kernel that gets checked arrays."""
    return lambda *args: kernel(*(arg.view(Checked) if isinstance(arg, np.ndarray) else arg for arg in args))
