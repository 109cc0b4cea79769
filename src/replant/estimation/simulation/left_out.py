"""Stretches of samples that are left out, as rows [begin, end): bridged, rejected, or before an interruption."""

from __future__ import annotations

import numpy as np

from replant.numerics.arguments import BoolArray, IntArray

NONE: IntArray = np.zeros((0, 2), np.int64)


def stretches_of(flags: BoolArray, first: int = 0) -> IntArray:
    """Return where flags (K,) are set, as rows [begin, end), (R, 2); ``first`` is the sample of the first flag."""
    edges = np.flatnonzero(np.diff(flags.astype(np.int8), prepend=0, append=0))
    return np.asarray(first + edges.reshape(-1, 2), np.int64)


def flags_of(stretches: IntArray, first: int, samples: int) -> BoolArray:
    """Return which samples (K,) of a range lie in stretches."""
    begin, end = np.searchsorted(stretches[:, 1], first, "right"), np.searchsorted(stretches[:, 0], first + samples)
    flags = np.zeros(samples, bool)
    for low, high in np.clip(stretches[begin:end] - first, 0, samples).tolist():
        flags[low:high] = True
    return flags


def joined(stretches: IntArray, apart: int) -> IntArray:
    """Return ascending stretches (R, 2) with those joined that are at most ``apart`` samples apart, for a plot."""
    if not len(stretches):
        return NONE
    new = np.flatnonzero(stretches[1:, 0] - np.maximum.accumulate(stretches[:-1, 1]) > apart)
    begins = stretches[np.concatenate([[0], new + 1]), 0]
    ends = np.maximum.accumulate(stretches[:, 1])[np.concatenate([new, [len(stretches) - 1]])]
    return np.column_stack([begins, ends])
