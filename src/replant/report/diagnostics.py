"""Diagnostics of a result: residual correlations with their confidence limits, and excitation over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record_regressors import regressors
from replant.regressor.filters import StateVariableFilter
from replant.regressor.preprocess import Preprocess, screen
from replant.runs.result import Result

IntArray = np.ndarray[tuple[int], np.dtype[np.int64]]

WINDOWS = 100  # windows in a record, unless they become too short for the parameters [count]
STRIDES = 4  # steps in which a window moves by its length [count]


@dataclass(frozen=True, eq=False)
class Excitation:
    """How well the samples of each window of a record determine the parameters."""

    # (W,): the sample after which each window ends
    samples: IntArray
    window: int  # samples in a window
    # (W,): smallest eigenvalue of the window's scaled information matrix: 1 at best, 0 where a combination of
    # parameters is undetermined
    smallest: FloatArray
    # (W,): condition number of the window's scaled regressors, as in the verdict on the whole record
    condition: FloatArray


def excitation(phi: FloatArray) -> Excitation | None:
    r"""Return the excitation along regressors phi (K, P), each entry scaled by its root mean square over the record.

    The information matrix of a window is :math:`\frac{1}{N} \sum_k \varphi_k \varphi_k^T`, over its N finite rows.

    Examples
    --------
    >>> phi = np.random.default_rng(0).standard_normal((8000, 2))
    >>> phi[4000:, 1] = phi[4000:, 0]                  # two equal columns
    >>> found = excitation(phi)
    >>> found.smallest[[0, -1]].round(1)
    array([0.8, 0. ])
    """
    count, size = phi.shape
    finite = np.asarray(np.isfinite(phi).all(axis=1))
    if not finite.any():
        return None
    rows = np.where(finite[:, None], phi, 0.0)
    largest = np.abs(rows).max(axis=0)
    largest[largest == 0.0] = 1.0
    rows = rows / largest
    scale = np.sqrt((rows**2).sum(axis=0) / finite.sum())
    rows = rows / np.where(scale > 0.0, scale, 1.0)
    stride = max(1, -(-max(20 * size, count // WINDOWS) // STRIDES))
    blocks = max(1, count // stride)
    ends = count - stride * np.arange(blocks - 1, -1, -1)
    matrices, totals = _blocks(rows, ends), np.diff(np.cumsum(finite)[ends - 1], prepend=0)
    span = min(STRIDES, blocks)
    windows, weights = _moving_sum(matrices, span), _moving_sum(totals, span)
    values = np.linalg.eigvalsh(windows / np.maximum(weights, 1)[:, None, None])
    least, most = np.maximum(values[:, 0], 0.0), values[:, -1]
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(most > 0.0, np.sqrt(most / least), np.inf)
    return Excitation(ends[span - 1 :], min(span * stride, count), least, condition)


def _blocks(rows: FloatArray, ends: IntArray) -> FloatArray:
    """Return sum phi phi' over each block of rows, (B, P, P); a block ends before each of ``ends``."""
    begins = [0, *ends[:-1].tolist()]
    parts = [rows[begin:end] for begin, end in zip(begins, ends.tolist(), strict=True)]
    return np.stack([part.T @ part for part in parts])


def _moving_sum(values: FloatArray, span: int) -> FloatArray:
    """Return the sums of ``span`` consecutive entries along the first axis."""
    return np.asarray(sum(values[i : values.shape[0] - span + 1 + i] for i in range(span)))


def regressors_of(
    result: Result,
    state_filter: StateVariableFilter,
    preprocess: Preprocess,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    t: FloatArray | None = None,
) -> FloatArray:
    """Return the regressors (K, P) of a result's record; rejected samples are rows of NaN."""
    accepted, _ = screen(preprocess.map_input(u), y)
    return regressors(result.structure, dt, state_filter, preprocess, u, np.where(accepted, y, np.nan), t)[0]
