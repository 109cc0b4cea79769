r"""Measures of an online estimate over a record, for each coefficient, by comparison with the true values.

index
    :math:`J_p = \sum_k (\hat p(t_k) - p)^2`, (21), of the estimate before each sample's own update.
error
    Error of the last estimate, in percent of the true value.
settled
    Time in s from which on the estimate stays within 10 % of the true value; None if it ends outside.
roughness
    Standard deviation over the last tenth of the record about the straight line that fits best, in percent of the
    true value: the scatter of the estimate, without its remaining drift.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.online.trace import Trace

BAND = 0.1  # distance within which an estimate counts as settled [part of the true value]


@dataclass(frozen=True, eq=False)
class Course:
    """An estimate over a record of K samples, complete or thinned; between rows it is taken as constant.

    Attributes
    ----------
    start : (P,) array
        The estimate before the first sample.
    samples : (H,) array of int
        After how many samples each row was taken, ascending.
    parameters : (H, P) array
    length : int
        K.
    """

    start: FloatArray
    samples: npt.NDArray[np.int64]
    parameters: FloatArray
    length: int

    @classmethod
    def of(cls, trace: Trace) -> Course:
        """Return the course of a trace, with every sample."""
        return cls(trace.start, np.arange(1, len(trace) + 1), trace.parameters, len(trace))


@dataclass(frozen=True)
class Measures:
    """The measures by coefficient, see the description of the module."""

    index: Mapping[str, float]
    error: Mapping[str, float]
    settled: Mapping[str, float | None]
    roughness: Mapping[str, float]

    @property
    def index_sum(self) -> float:
        """The article's J_sum."""
        return sum(self.index.values())

    @property
    def all_settled(self) -> float | None:
        """Time in s from which on every coefficient stays within 10 %; None if one does not."""
        times = [time for time in self.settled.values() if time is not None]
        return max(times) if len(times) == len(self.settled) else None

    @property
    def roughest(self) -> float:
        """The largest roughness of a coefficient, in percent."""
        return max(self.roughness.values())


def measure(course: Course, true: Mapping[str, float], dt: float) -> Measures:
    """Return the measures of the first ``len(true)`` parameters of a course.

    >>> course = Course(np.zeros(1), np.arange(1, 5), np.array([[1.0], [3.0], [2.1], [2.0]]), length=4)
    >>> found = measure(course, {"a0": 2.0}, dt=0.5)
    >>> found.index, found.error, found.settled      # J = 2^2 + 1^2 + 1^2 + 0.1^2
    ({'a0': 6.01}, {'a0': 0.0}, {'a0': 1.5})
    """
    values = course.parameters[:, : len(true)]
    target = np.array(list(true.values()))
    held = np.diff(
        np.concatenate([[0], course.samples, [course.length]])
    )  # samples for which each estimate, from the start on, held
    squares = (np.vstack([course.start[None, : len(true)], values]) - target) ** 2
    relative = (values - target) / np.abs(target)
    tail = course.samples > 0.9 * course.length
    roughness = _scatter(course.samples[tail] / course.length, relative[tail])
    return Measures(
        dict(zip(true, (held @ squares).tolist(), strict=True)),
        dict(zip(true, (100.0 * relative[-1]).tolist(), strict=True)),
        {
            name: _settled(column, np.asarray(course.samples * dt, np.float64))
            for name, column in zip(true, relative.T, strict=True)
        },
        dict(zip(true, (100.0 * roughness).tolist(), strict=True)),
    )


def _settled(relative: FloatArray, t: FloatArray) -> float | None:
    outside = np.flatnonzero(~(np.abs(relative) <= BAND))
    if outside.size == 0:
        return float(t[0])
    return None if outside[-1] == relative.size - 1 else float(t[outside[-1] + 1])


def _scatter(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the standard deviation of each column of ``values`` about its own straight line over ``t``."""
    if t.size < 3:
        return np.full(values.shape[1], np.nan)
    line = np.column_stack([np.ones_like(t), t - t.mean()])
    weights, *_ = np.linalg.lstsq(line, values, rcond=None)
    return np.asarray((values - line @ weights).std(axis=0))
