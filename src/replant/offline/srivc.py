r"""Refined instrumental variables for continuous-time models (SRIVC) on a record: offline fit and online start-up.

The regression :math:`s^n/A\, y = \varphi^T \theta` is prefiltered by 1/A of the current model.  It is solved with the
instruments :math:`\zeta`, the same regressor built from the model's noise-free output, and the solution is the next
model, until it no longer changes:

.. math:: \theta \leftarrow \Big(\sum \zeta \varphi^T\Big)^{-1} \sum \zeta\, s^n/A\, y

At that fixed point the equation error is exactly the output error of the model, y - B/A u: the estimate has no
discretisation error, whatever y does between samples.  The offset and the initial state are nuisance regressors, 1/A
and s^i/A of an impulse; of these only the bias is reported, if the structure has one.

The iteration may not converge.  Damped Gauss-Newton steps on the output error, which follow it, do.

Source: Young and Jakeman (1980), "Refined instrumental variable methods of recursive time-series analysis, part III",
International Journal of Control 31; Garnier and Wang (2008), "Identification of Continuous-time Models from Sampled
Data", chapter 4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.refined import Refined, conclude
from replant.simulation.auxiliary_model import AuxiliaryModel, Pass
from replant.statistics.linear_algebra import quiet, roots, solve

CUTOFFS = 8
"""State-variable filters tried for a start, evenly spaced in the logarithm [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

SHORT = 4
"""Iterations of each start [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

LONG = 20
"""Iterations of the most promising starts [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

SLOWEST_CUTOFF = 5.0
"""Slowest of their cutoffs; the fastest is 1 / dt [1 / duration of the record].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

PROMISING = 3
"""Starts that are iterated further [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

STALLED = 1e-6
"""Decrease of the cost below which an iteration stalls [part of the cost].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

STALLS = 6
"""Iterations that may stall [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

STILL = 1e-3
"""Movement of the estimate below which the iteration has converged [standard deviations of what a regressor's entry
tells].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

DONE = 1e-6
"""Gain of a Gauss-Newton step below which the fit is done [variances of the residual].
Derivation: a thousandth of a standard deviation.
Sensitivity: not measured.
"""

NEARLY_DONE = 0.1
"""The same where no shorter step gains anything either [variances of the residual].
Derivation: a third of a standard deviation: where poles are as fast as the sampling the instruments' root lies a
little beside the least cost.
Sensitivity: not measured.
"""

ROUNDING = 1e-18
"""Power of the residual below which only rounding is left [part of the output's power].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

HALVINGS = 10
"""Halvings of a Gauss-Newton step at the most [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

POLISH = 30
"""Gauss-Newton steps at the most [count].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

SLOWEST = 0.01
"""Margin of stability [1 / duration of the record].
Origin: not recorded; kept, see sensitivity.
Sensitivity: not measured.
"""

FASTEST = 3.0
"""Bound of a pole's magnitude [1 / sampling time].
Derivation: beyond pi / dt a pole lies above half the sampling rate.
Sensitivity: not measured.
"""


class Problem:
    """The fit of one structure to one record: passes of models over it, and the steps from model to model.

    Parameters
    ----------
    structure : Structure
    record : Record

    Attributes
    ----------
    slowest, fastest : float
        Bounds of a filter's poles in rad/s: they lie left of -slowest, and their magnitudes are at most fastest.
    """

    def __init__(self, structure: Structure, record: Record) -> None:
        self.structure, self.record = structure, record
        self._model = AuxiliaryModel(structure, record.dt, record.input_hold)
        self.slowest, self.fastest = SLOWEST / record.span, FASTEST / record.dt

    def run(self, model: FloatArray) -> Pass:
        """Return the pass of a model (T,) over the record: parameters, then nuisances."""
        return self._model.run(model, self.record)

    def is_usable(self, model: FloatArray) -> bool:
        """Return whether the denominator of ``model`` (T,) can be a filter: finite, with poles within the bounds."""
        a = model[self.structure.denominator]
        if not np.isfinite(a).all():
            return False
        magnitudes = np.abs(a) ** (1.0 / np.arange(1, a.size + 1))
        if magnitudes.max() >= a.size * self.fastest:
            return False
        return bool(roots(np.concatenate([[1.0], a])).real.max() < -self.slowest)

    def project(self, model: FloatArray) -> FloatArray:
        """Return ``model`` (T,) with unstable poles reflected in the imaginary axis, and every pole within the bounds.

        The numerator and the nuisances stay as they are.
        """
        if self.is_usable(model):
            return model
        n = self.structure.poles
        poles = roots(np.concatenate([[1.0], model[:n]]))
        if np.isfinite(poles).all():
            poles = np.minimum(-np.abs(poles.real), -self.slowest) + 1j * poles.imag
            poles *= np.minimum(1.0, self.fastest / np.abs(poles))
            a = np.poly(poles).real[1:]
        else:
            a = np.poly(np.full(n, -math.sqrt(self.slowest * self.fastest)))[1:]
        return np.concatenate([np.asarray(a, np.float64), model[n:]])

    def from_cutoff(self, cutoff: float) -> FloatArray | None:
        """Return the projected least-squares estimate behind (s + cutoff)^n, cutoff in rad/s; None if singular."""
        n = self.structure.poles
        a = np.asarray(np.poly(np.full(n, -cutoff))[1:], np.float64)
        done = self.run(np.concatenate([a, np.zeros(self._model.entries - n)]))
        found = solve(done.phi.T @ done.phi, done.phi.T @ done.target)
        return None if found is None else self.project(found)

    def improve(self, theta: FloatArray, iterations: int, patience: int) -> tuple[float, FloatArray, FloatArray | None]:
        """Iterate the instrumental-variable step.

        Parameters
        ----------
        theta : (T,) array
            The model to begin with.
        iterations : int
            Most steps taken.
        patience : int
            Steps that may fail to lower the cost before the iteration ends.

        Returns
        -------
        cost : float
            The least mean square of the output error.
        model : (T,) array
            The model with that cost.
        last : (T,) array or None
            The last model; None where the step's equations were singular.
        """
        best, best_model, stalls = math.inf, theta, 0
        current = theta
        for _ in range(iterations):
            model = current
            done = self.run(model)
            stalls += not done.cost < best * (1.0 - STALLED)
            if done.cost < best:
                best, best_model = done.cost, model
            found = solve(done.zeta.T @ done.phi, done.zeta.T @ done.target)
            if found is None:
                return best, best_model, None
            change = np.abs(found - model) * np.linalg.norm(done.zeta, axis=0)
            current = self.project(found)
            if change.max() <= STILL * math.sqrt(done.cost) or stalls >= patience:
                break
        return best, best_model, current

    def polish(self, model: FloatArray) -> tuple[FloatArray, Pass, bool]:
        """Take damped Gauss-Newton steps on the output error; return the model, its pass, whether it converged."""
        done = self.run(model)
        power = float(np.mean(self.record.y**2))
        for _ in range(POLISH):
            gradient = done.zeta.T @ done.error
            direction = solve(done.zeta.T @ done.zeta, gradient)
            if direction is None:
                return model, done, False
            gain = float(direction @ gradient) / self.record.u.size
            samples = self.record.u.size
            # converged: the step is a thousandth of a standard deviation, or the error is rounding
            if gain * samples <= DONE * done.cost or done.cost <= ROUNDING * power:
                return model, done, True
            better = self._line_search(model, direction, done.cost)
            if better is None:
                # no step lowers the cost: the instruments join the model's output by straight lines between samples, so
                # that with poles as fast as the sampling the gradient vanishes a little beside the least cost
                return model, done, gain * samples <= NEARLY_DONE * done.cost
            model, done = better
        return model, done, False

    def _line_search(self, model: FloatArray, direction: FloatArray, cost: float) -> tuple[FloatArray, Pass] | None:
        """Return the model after the longest of `HALVINGS` halved steps that lowers the cost; None if none does."""
        for halvings in range(HALVINGS):
            tried = model + direction * 0.5**halvings
            if self.is_usable(tried):
                done = self.run(tried)
                if done.cost < cost:
                    return tried, done
        return None


@quiet
def refine(structure: Structure, record: Record, given: Sequence[FloatArray] = ()) -> Refined | None:
    """Return the refined instrumental-variable estimate of a record; None where no start leads to a model.

    Every start is improved by a few steps, the most promising ones by more; the best is polished.

    Parameters
    ----------
    structure : Structure
    record : Record
        Usable samples, a few more than there are parameters and nuisances.
    given : sequence of (T,) arrays
        Estimates to start from; without any, least squares behind `CUTOFFS` state-variable filters.

    Examples
    --------
    >>> from replant.model.transfer_function import TransferFunction
    >>> u = np.where(np.arange(400) // 50 % 2 == 0, 1.0, -1.0)
    >>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, 0.1)
    >>> refine(Structure(1), Record(u, y, np.array([0.1]))).theta[:2].round(6)
    array([0.5, 2. ])
    """
    problem = Problem(structure, record)
    starts: list[FloatArray | None] = [problem.project(np.asarray(theta, np.float64)) for theta in given]
    if not starts:
        cutoffs = np.geomspace(SLOWEST_CUTOFF / record.span, 1.0 / record.dt, CUTOFFS)
        starts = [problem.from_cutoff(float(cutoff)) for cutoff in cutoffs]
    tried = [problem.improve(start, SHORT, SHORT) for start in starts if start is not None]
    tried.sort(key=lambda outcome: outcome[0])
    for _, _, last in list(tried[:PROMISING]):
        if last is not None:
            tried.append(problem.improve(last, LONG, STALLS))
    if not tried:
        return None
    best, model, _ = min(tried, key=lambda outcome: outcome[0])
    if not math.isfinite(best):
        return None
    return conclude(structure, record, problem.slowest, *problem.polish(model))


def first_model(structure: Structure, record: Record) -> Refined | None:
    """Return the refined estimate of a record; None where it has too few samples or a constant input."""
    least = 2 * structure.poles + structure.zeros + 3
    if record.u.size <= least or float(np.ptp(record.u)) == 0.0:
        return None
    return refine(structure, record)
