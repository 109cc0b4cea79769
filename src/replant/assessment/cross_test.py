r"""The cross test: how much of a model's residual past inputs, or the states they drive, could still explain.

The residual of a correct model is independent of the input.  The test regresses the residual on columns that stand for
the usual faults of a model: the states s^i/A u and the input at several delays, the derivatives of the simulated output
with respect to the coefficients, and powers of the simulated output.  Both sides are first filtered by the
autoregression that whitens the residual.  The explained part, over the residual's variance, is then :math:`\chi^2` with
as many degrees of freedom as there are independent columns.  Under feedback the input answers the residual of a correct
model, too, at once and later: the column of a sample holds only what was known before it, where the model lets it (a
model with a direct path needs the input of the same sample; where the loop is closed its columns are one sample late).
Where the past residual tells the next one, in colour that the autoregression does not take, past inputs do so, too.
What a reference explains of the residual is a fault of the model whatever the noise is: `unexplained_by_reference`.

Sources: Ljung (1999), "System Identification: Theory for the User", sections 16.5 and 16.6; Soderstrom and Stoica
(1989), "System Identification", section 11.2.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.simulation.model_run import ModelRun
from replant.statistics.autoregression import Autoregression
from replant.statistics.chi2 import chi2_quantile
from replant.statistics.linear_algebra import roots
from replant.statistics.projections import TAKEN_AWAY, lengths_of, orthogonal, products, widening

FALSE_ALARM = 1e-4
"""Chance that a test finds something where there is nothing [probability].
Level: 0.01 %: the verdict is asked for many times in a run.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

CORE_STATE_DELAYS = (0, 2)
"""Delays of the states in the small set of columns, which finds most faults with the least to pay for chance [steps of
FAST_STEP].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

CORE_INPUT_DELAYS = (1, 2, 5, 13)
"""Delays of the input in the small set of columns [samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

STATE_DELAYS = (1, 4, 8)
"""Further delays of the states, in the large set [steps of FAST_STEP].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

INPUT_DELAYS = (1, 3, 8)
"""Further delays of the input, in the large set [samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

SLOW_DELAYS = (0.5, 1.0, 2.0)
"""Long delays of the input, in the large set [slowest time constants].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

FAST_STEP = 0.5
"""Step of the states' delays [fastest time constants].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

FARTHEST = 0.02
"""Longest step of the states' delays [part of the record].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, nothing changes on these records.
"""

PER_COLUMN = 8
"""Samples that each column of the regression needs [samples].
Origin: not recorded; kept, see sensitivity.
Sensitivity: halved, nothing changes on these records; doubled, no verdict changes, and no error by a quarter.
"""


@dataclass(frozen=True)
class Unexplained:
    """The part of a residual that the input could still explain.

    Attributes
    ----------
    power : float
        Mean square of that part, less its expected value under noise alone; in the output's unit squared.
    std : float
        Standard deviation of ``power``.
    statistic : float
        The test statistic over its limit: above 1 the part is statistically significant.
    """

    power: float
    std: float
    statistic: float


def unexplained(run: ModelRun, rows: slice, dt: float, surplus: float = 0.0, *, feedback: bool = False) -> Unexplained:
    """Return the part of a run's residual over ``rows`` that the input could still explain.

    Parameters
    ----------
    run : ModelRun
    rows : slice
        The samples tested.
    dt : float
        Sampling time in s.
    surplus : float
        Relative increase of the statistic by the error of the estimate itself: samples tested over samples learned; 0
        for samples that the estimate was made from.
    feedback : bool
        Whether the input answers the residual.
    """
    columns, few = _columns(run, rows, dt, feedback)
    return _explained(run.error[rows], columns, few, surplus * run.zeta.shape[1])


def unexplained_by_reference(
    run: ModelRun, rows: slice, columns: FloatArray, surplus: float = 0.0, spent: int = 0
) -> Unexplained:
    """Return the part of a run's residual over ``rows`` that a reference could still explain.

    Parameters
    ----------
    run : ModelRun
    rows : slice
        The samples tested.
    columns : (K, C) array
        Made from the reference, see `Reference.columns`.
    surplus : float
        See `unexplained`.
    spent : int
        Degrees of freedom that the estimate has used up: its coefficients, where it was made from these samples with
        instruments from this reference; else 0.
    """
    found = _explained(run.error[rows], columns[rows], 0, surplus * run.zeta.shape[1], spent)
    return dataclasses.replace(found, statistic=found.statistic / _colour_left(run.error[rows], columns[rows]))


def _colour_left(error: FloatArray, columns: FloatArray) -> float:
    """Return by how much the colour that the noise model leaves in an error (K,) widens its regression on columns."""
    error, columns = error - error.mean(), columns - columns.mean(axis=0)
    noise = Autoregression.of(error)
    w, z = noise.whiten(error), noise.whiten(columns)
    z = z / lengths_of(z)
    basis = z @ orthogonal(products(z, z))
    return widening(basis, w - basis @ products(basis, w[:, None])[:, 0])


def _explained(error: FloatArray, columns: FloatArray, few: int, learned: float, spent: int = 0) -> Unexplained:
    """Regress an error (K,) on columns (K, C), both whitened; the first ``few`` columns make a test of their own."""
    error, columns = error - error.mean(), columns - columns.mean(axis=0)
    noise = Autoregression.of(error)
    e, z = noise.whiten(error), noise.whiten(columns)
    lengths = lengths_of(z)
    left = lengths > TAKEN_AWAY * lengths_of(columns)
    if not left.any() or not float(e @ e) > 0.0:
        return Unexplained(0.0, 0.0, 0.0)
    z, few = z[:, left] / lengths[left], int(left[:few].sum())
    # the first rows have no past of full length: the filter drops them, so they are dropped here as well
    whole = columns[noise.coefficients.size - 1 :, left] / lengths[left]
    filtered, unfiltered, along = products(z, z), products(whole, whole), products(z, e[:, None])[:, 0]
    sizes = sorted({few, along.size} - {0})
    tried = [_regression(filtered[:k, :k], unfiltered[:k, :k], along[:k], e, learned, spent) for k in sizes]
    # the core columns give the more powerful test, all columns the better figure: columns that do not span the
    # unexplained part underestimate it
    return Unexplained(tried[-1].power, tried[-1].std, max(found.statistic for found in tried))


def _regression(
    filtered: FloatArray, unfiltered: FloatArray, along: FloatArray, white: FloatArray, learned: float, spent: int
) -> Unexplained:
    """Regress the white error (K,) on columns, given by their products: filtered, unfiltered, and with the error."""
    basis = orthogonal(filtered)
    amounts = basis.T @ along
    count, part = len(amounts), float(amounts @ amounts)
    if count == 0:
        return Unexplained(0.0, 0.0, 0.0)
    variance = max(float(white @ white) - part, 0.0) / max(white.size - count, 1)
    # power of the weighted columns in the output, less its expected value under noise alone
    gram = basis.T @ unfiltered @ basis
    output = gram @ amounts
    power = (float(amounts @ output) - variance * float(np.trace(gram))) / white.size
    std = math.sqrt(variance * (2.0 * variance * float(np.sum(gram**2)) + 4.0 * float(output @ output))) / white.size
    degrees = max(count - spent, 1)
    limit = float(chi2_quantile(1.0 - FALSE_ALARM / 2.0, degrees)) * (1.0 + learned / count)
    return Unexplained(max(power, 0.0), std, part / variance / limit if variance > 0.0 else math.inf)


def linear_columns(run: ModelRun, rows: slice, dt: float) -> FloatArray:
    """Return the columns (K, C) of the small set that stand for linear faults: delayed states and inputs, slopes."""
    return np.hstack(_Delayed.of(run, rows, dt).linear)


@dataclass(frozen=True, eq=False)
class _Delayed:
    """The signals of a run over some rows, delayed.

    Attributes
    ----------
    run : ModelRun
    index : (K,) array of int
        The rows, one sample earlier where they must be late.
    step : int
        Step of the states' delays in samples.
    """

    run: ModelRun
    index: npt.NDArray[np.int64]
    step: int

    @classmethod
    def of(cls, run: ModelRun, rows: slice, dt: float, *, feedback: bool = False) -> _Delayed:
        """Return those of a run; under feedback a sample late where the output depends on the input of the same one."""
        samples = len(run.error)
        begin, end, _ = rows.indices(samples)
        late = 1 if run.is_direct and feedback else 0
        _, fastest = _time_constants(run.parameters[: run.structure.poles], samples * dt)
        step = min(max(1, round(FAST_STEP * fastest / dt)), max(1, int(FARTHEST * samples)))
        return cls(run, np.arange(begin, end) - late, step)

    def __call__(self, signal: FloatArray, delay: int) -> FloatArray:
        """Return a signal of the run, so many samples late."""
        return np.asarray(signal[np.clip(self.index - delay, 0, len(self.run.error) - 1)])

    def inputs(self, delays: Iterable[int]) -> FloatArray:
        """Return the input at several delays, a column each."""
        return np.column_stack([self(self.run.u, delay) for delay in delays])

    @property
    def core_delays(self) -> tuple[int, ...]:
        """Delays of the input in the small set."""
        return (0, *CORE_INPUT_DELAYS) if self.run.is_direct else CORE_INPUT_DELAYS

    @property
    def linear(self) -> list[FloatArray]:
        """The small set without the powers of the output."""
        states = [self(self.run.states, delay * self.step) for delay in CORE_STATE_DELAYS]
        return [*states, self(self.run.zeta[:, : self.run.structure.poles], 0), self.inputs(self.core_delays)]


def _columns(run: ModelRun, rows: slice, dt: float, feedback: bool) -> tuple[FloatArray, int]:
    """Return the columns that the residual is regressed on, core columns first, and how many of them are core."""
    samples, n = len(run.error), run.structure.poles
    delayed = _Delayed.of(run, rows, dt, feedback=feedback)
    slowest, _ = _time_constants(run.parameters[:n], samples * dt)
    far = [max(1, min(round(part * slowest / dt), samples // 4)) for part in SLOW_DELAYS]
    room = delayed.index.size // PER_COLUMN
    states = (room - 5 * n - len(INPUT_DELAYS) - len(far)) // run.states.shape[1]
    output = run.forced - run.forced[rows].mean()
    parts = [*delayed.linear, delayed(np.column_stack([output**2, output**3]), 0)]
    few = sum(part.shape[1] for part in parts)
    if states > 0:  # enough samples for more than the core columns
        parts += [delayed(run.states, delay * delayed.step) for delay in STATE_DELAYS[:states]]
        parts.append(delayed.inputs(sorted({*INPUT_DELAYS, *far} - set(delayed.core_delays))))
    return np.hstack(parts), few


def _time_constants(a: FloatArray, longest: float) -> tuple[float, float]:
    """Return the slowest and the fastest time constant of a denominator, in s, at most ``longest``."""
    poles = roots(np.concatenate([[1.0], a]))
    slowest, fastest = float(np.abs(poles.real).min()), float(np.abs(poles).max())
    return 1.0 / max(slowest, 1.0 / longest), 1.0 / max(fastest, 1.0 / longest)
