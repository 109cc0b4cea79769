"""The kernels as plain Python: an index outside of an array is an error there.

Compiled, an index is not checked; and of one that is negative NumPy makes one that counts from the end.  Here both are
refused.  A thousand times as slow.
"""

from __future__ import annotations

import operator
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


def make_plain() -> None:
    """Let this process interpret its kernels, with checked arrays."""
    from replant.estimation.engine import state
    from replant.kernels import native
    from replant.online import begin_recursion, lifecycle, startup

    native._interpreted = True
    step_kernels = state.step_kernels

    def checked_step_kernels(*args: Any, **how: Any) -> Any:
        return tuple(map(checked, step_kernels(*args, **how)))

    for user in (state, startup, begin_recursion, lifecycle):
        user.step_kernels = checked_step_kernels  # type: ignore[attr-defined]


def checked(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return a kernel that gets checked arrays."""
    return lambda *args: kernel(*(arg.view(Checked) if isinstance(arg, np.ndarray) else arg for arg in args))
