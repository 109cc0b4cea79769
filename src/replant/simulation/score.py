r"""Score: the fit of a model to a record on any clock, batch by batch, from the input alone and one step ahead.

The initial state is fitted over the first 2^18 samples, the offset over all of them, so that a record of any length
needs one pass.  The autoregression D(q) e = w of the residual e and the sum of w^2 follow from the sums of the products
:math:`e_{k-i} e_{k-j}`: the fit one step ahead needs no second pass either.
"""

from __future__ import annotations

import math

import numpy as np

from replant.arguments import BoolArray, FloatArray
from replant.model.transfer_function import TransferFunction
from replant.simulation.fitted_run import FittedRun
from replant.statistics.autoregression import places_on_grid
from replant.statistics.residuals import ErrorSums, OutputSums

FITTED = 1 << 18  # samples over which the initial state is fitted [samples]


class Score:
    """Runs a model from the input alone, and keeps the sums that its fits to the measured output are made from.

    >>> g = TransferFunction([2.0], [1.0, 1.0])
    >>> u = np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    >>> score = Score(g, dt=0.1)
    >>> output = score.take(u, g.simulate(u, 0.1) + 5.0)
    >>> round(score.simulated, 6), output[:2].round(6) + score.shift
    (100.0, array([5., 5.]))
    """

    def __init__(self, model: TransferFunction, dt: float, input_hold: str = "zoh") -> None:
        self._run = FittedRun(model, dt, input_hold)
        self._dt, self._last = dt, math.nan
        self._batches, self._failed = 0, False
        self._error, self._output = ErrorSums(), OutputSums()

    def take(self, u: FloatArray, y: FloatArray, t: FloatArray | None = None) -> FloatArray:
        """Take the next samples (K,); return the model's output, `shift` not yet added.

        The first batch must hold `FITTED` samples, or all if there are fewer.  NaN in ``u`` is replaced by the last
        input, NaN in ``y`` is left out, and so are the outputs that answer to inputs from before the record.  ``t`` are
        time stamps (K,) in s, of an irregular clock.
        """
        if u.size == 0:
            return np.zeros(0)
        intervals = self._intervals(t)
        with np.errstate(over="ignore", invalid="ignore"):
            modelled, y = self._run.take(u, y, t)
            self._batches += 1
            self._failed = self._failed or not bool(np.isfinite(modelled).all())
            if not self._failed:
                known = np.asarray(np.isfinite(y))
                self._output.take(y[known])
                self._error.take(*_spread(np.where(known, y - modelled, 0.0), known, intervals, self._dt))
        return modelled

    def _intervals(self, t: FloatArray | None) -> FloatArray | None:
        """Return the time (K,) since the sample before each stamp (K,), in s; None for a regular clock."""
        if t is None:
            return None
        intervals = np.diff(t, prepend=t[0] - self._dt if math.isnan(self._last) else self._last)
        self._last = float(t[-1])
        return intervals

    @property
    def usable(self) -> bool:
        """Whether there is something to compare: a modelled output within float64, and a measured output."""
        return not self._failed and self._output.count > 0

    @property
    def shift(self) -> float:
        """Offset of the whole record minus that of the first batch; NaN where the score is not usable."""
        if not self.usable:
            return math.nan
        return self._error.mean if self._batches > 1 else 0.0  # of one batch the offset is the least-squares solution

    @property
    def offset(self) -> float:
        """The estimated constant between measured and simulated output."""
        return self._run.offset + self.shift if self.usable else 0.0

    @property
    def simulated(self) -> float:
        """Fit in percent, from the input alone."""
        return self._fit(self._error.power(self.shift)) if self.usable else -math.inf

    @property
    def one_step(self) -> float:
        """Fit in percent, one step ahead: each residual predicted from the residuals before it."""
        return self._fit(self._error.innovation(self.shift)) if self.usable else math.nan

    def _fit(self, power: float) -> float:
        spread = self._output.spread
        if spread == 0.0:
            return math.nan
        with np.errstate(over="ignore", invalid="ignore"):
            return float(100.0 * (1.0 - np.sqrt(max(power, 0.0)) / np.sqrt(spread)))


def _spread(
    error: FloatArray, known: BoolArray, intervals: FloatArray | None, dt: float
) -> tuple[FloatArray, BoolArray]:
    """Return residuals (K,), and which are known, with one unknown residual for each sample that was lost."""
    if intervals is None:
        return error, known
    places = places_on_grid(intervals, dt)
    size = int(places[-1]) + 1
    spread, there = np.zeros(size), np.zeros(size, bool)
    spread[places], there[places] = error, known
    return spread, there
