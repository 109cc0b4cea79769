r"""Recognise an input that a controller computed from the output: no more than its rounding is left to explain.

In a loop that only disturbances move, the output acts on the input as a plant's input acts on its output, and the
recorded input adds nothing to the output's own past.  Both records differ in one respect: a controller computes each
value from the past alone,

.. math:: u_k = \sum_{i \ge 1} a_i u_{k-i} + \sum_{i \ge 0} b_i y_{k-i},

and what a plant's sensor measures has noise.  A value that is rounded to steps q is off by q / 2 at most, so that of
independent roundings at most :math:`q^2 (1 + \sum a_i^2) / 4` is left.
"""

from __future__ import annotations

import math

import numpy as np

from replant.logs.columns import describe
from replant.numerics.arguments import BoolArray, FloatArray

LAGS = 8  # past values of both signals: those of a controller and of the filter before it [samples]
EXACT = math.exp(-10.0)  # part of the input's power that is the rounding of the recorded output [part]


def is_computed(u: FloatArray, y: FloatArray) -> bool:
    """Return whether ``u`` (K,) follows from its own past and from ``y`` (K,) but for rounding, as of a controller."""
    known = np.isfinite(u) & np.isfinite(y)
    if not known.any():
        return False
    (v, power), (w, _) = (_standard(signal, known) for signal in (u, y))
    past = [_before(v, lag) for lag in range(1, LAGS + 1)]
    columns = np.column_stack([np.ones(u.size), *past, *(_before(w, lag) for lag in range(LAGS + 1))])
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(v)
    if int(rows.sum()) <= 2 * columns.shape[1]:  # nearly any values would follow
        return False
    solution = np.linalg.lstsq(columns[rows], v[rows], rcond=1e-10)[0]
    left = float(np.mean((v[rows] - columns[rows] @ solution) ** 2))
    about = describe(0, "", u)
    step = about.step / power if about.quantised and power > 0.0 else 0.0
    rounding = 0.25 * step**2 * (1.0 + float(np.sum(solution[1 : LAGS + 1] ** 2)))
    return left <= EXACT + rounding


def _standard(signal: FloatArray, known: BoolArray) -> tuple[FloatArray, float]:
    """Return a signal (K,) with mean 0 and deviation 1 over the ``known`` samples, and its deviation before."""
    centred = signal - signal[known].mean()
    deviation = float(centred[known].std())
    return np.asarray(centred / deviation if deviation > 0.0 else centred), deviation


def _before(signal: FloatArray, lag: int) -> FloatArray:
    """Return a signal (K,) delayed by ``lag`` samples; NaN before its begin."""
    return np.concatenate([np.full(lag, np.nan), signal[: signal.size - lag]])
