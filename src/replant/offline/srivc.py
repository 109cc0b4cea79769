r"""Refined instrumental variables for continuous-time models (SRIVC) on a record: offline fit and online start-up.

The regression :math:`s^n/A\, y = \varphi^T \theta` is prefiltered by 1/A of the current model.  It is solved with the
instruments :math:`\zeta`, the same regressor built from the model's noise-free output, and the solution is the next
model, until it no longer changes:

.. math:: \theta \leftarrow \Big(\sum \zeta \varphi^T\Big)^{-1} \sum \zeta\, s^n/A\, y

At that fixed point the equation error is exactly the output error of the model, y - B/A u: the estimate has no
discretisation error, whatever y does between samples.  The offset and the initial state are nuisance regressors, 1/A
and s^i/A of an impulse; of these only the bias is reported, if the structure has one.

The iteration may not converge.  Damped Gauss-Newton steps on the output error, which follow it, do.

Where the residual e is coloured, D(q) e = w, regressor, instruments and target are filtered by D(q), and iteration
goes on from the best models so far.  Filter and model are found in turn.  In feedback the instruments, made of past
inputs, are then independent of the innovation w, though not of e.

With a reference the instruments are made of what it explains of input and output.  They are independent of all noise,
so that the estimate is consistent whatever D(q) is, and the starts behind state-variable filters are as well.  Steps
and starts are compared by the part of w that the reference explains,

.. math:: J = w^T L (L^T L)^{-1} L^T w.

A plant need not be stable: the filters are 1/D and the residual is A/D y - B/D u, see `replant.kernels.filters.bank`.
Without a reference models are then compared by the error of the predicted output, as likelihood asks: a fast reflected
pole makes the residual of any model small.

Source: Young and Jakeman (1980), "Refined instrumental variable methods of recursive time-series analysis, part III",
International Journal of Control 31; Garnier and Wang (2008), "Identification of Continuous-time Models from Sampled
Data", chapter 4; Gilson, Garnier, Young and Van den Hof (2008), "Instrumental variable methods for closed-loop
continuous-time model identification", chapter 5 of the same book.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from replant.arguments import FloatArray
from replant.engine.record import Record
from replant.kernels.schema import LAGS
from replant.model.structure import Structure
from replant.offline.coloured_residual import is_noise
from replant.offline.projection import Projection
from replant.offline.refined import Refined, Root, conclude
from replant.simulation.auxiliary_model import AuxiliaryModel, Pass
from replant.statistics.autoregression import LEAST, Autoregression, sums_of
from replant.statistics.linear_algebra import quiet, roots, solve
from replant.statistics.projections import orthogonal, products

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

AGREE = 1e-2
"""Difference of two costs up to which their models are the same root [part of the cost].
Origin: roots that differ do so by more in the loops of the benchmark.
Sensitivity: not measured.
"""

RENEWALS = (0, 2, 4, 7, 10)
"""Whitened steps at which the noise model is renewed [count].
Origin: model and filter settle within ten steps in the loops of the benchmark.
Sensitivity: not measured.
"""

WHITENED = 25
"""Whitened steps at the most [count].
Origin: after the last renewal a step takes off nine tenths of the distance or more.
Sensitivity: not measured.
"""

SHORTENED = 7
"""Times that a whitened step is tried, each time half as long [count].
Origin: as HALVINGS.
Sensitivity: not measured.
"""

SLACK = {False: 1e-3, True: 0.02}
"""Growth of the cost that a whitened step may bring, without and with a reference [part of the cost].
Derivation: the root of the instruments' equations lies beside the least cost, and J is chi-squared at it.
Sensitivity: not measured.
"""

LOUD = 3.0
"""Variance of the residual up to which a root is considered [least variance of the roots].
Origin: the innovation alone prefers a model without a numerator, which leaves the whole output to the autoregression:
in half of the runs of the PI and PID loops under a load.
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
    projection : Projection or None
        What the record's reference explains.
    known : (K,) array of int
        Residuals before each that are one sampling time apart, up to LAGS.
    noise : Autoregression
        D(q) of the residual; it begins as one.
    """

    def __init__(self, structure: Structure, record: Record) -> None:
        self.structure, self.record = structure, record
        self.slowest, self.fastest = SLOWEST / record.span, FASTEST / record.dt
        self.projection = None if record.r is None else Projection.of(record)
        referenced = self.projection is not None
        self._model = AuxiliaryModel(
            structure, record.dt, record.input_hold, margin=self.slowest, reference=referenced
        )  # fmt: skip
        self.known = _known(record)
        self.noise = Autoregression.white(1.0, record.u.size)

    def run(self, model: FloatArray) -> Pass:
        """Return the pass of a model (T,) over the record: parameters, then nuisances."""
        return self._model.run(model, self.record, None if self.projection is None else self.projection.parts)

    def is_usable(self, model: FloatArray) -> bool:
        """Return whether the denominator of ``model`` (T,) can be a filter: finite, and not too fast."""
        a = model[self.structure.denominator]
        if not np.isfinite(a).all():
            return False
        magnitudes = np.abs(a) ** (1.0 / np.arange(1, a.size + 1))
        return bool(magnitudes.max() < a.size * self.fastest)

    def bounded(self, model: FloatArray) -> FloatArray:
        """Return ``model`` (T,) with no pole faster than the bound.

        The numerator and the nuisances stay as they are.
        """
        if self.is_usable(model):
            return model
        n = self.structure.poles
        poles = roots(np.concatenate([[1.0], model[:n]]))
        if np.isfinite(poles).all():
            poles = poles * np.minimum(1.0, self.fastest / np.maximum(np.abs(poles), 1e-300))
            a = np.poly(poles).real[1:]
        else:
            a = np.poly(np.full(n, -math.sqrt(self.slowest * self.fastest)))[1:]
        return np.concatenate([np.asarray(a, np.float64), model[n:]])

    def from_cutoff(self, cutoff: float) -> FloatArray | None:
        """Return the estimate behind (s + cutoff)^n, cutoff in rad/s; None if singular.

        By least squares, or where there is a reference by its instruments.
        """
        n = self.structure.poles
        a = np.asarray(np.poly(np.full(n, -cutoff))[1:], np.float64)
        done = self.run(np.concatenate([a, np.zeros(self._model.entries - n)]))
        zeta = done.phi if self.projection is None else done.zeta
        found = solve(zeta.T @ done.phi, zeta.T @ done.target)
        return None if found is None else self.bounded(found)

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return D(q) x of ``signals`` (K, ...), weighted where the past is not known."""
        return self.noise.whiten_known(signals, self.known)

    def is_rounding(self, done: Pass) -> bool:
        """Return whether only rounding is left of the residual."""
        return done.cost <= ROUNDING * float(np.mean(self.record.y**2))

    def renew_noise(self, done: Pass) -> None:
        """Model the residual of a pass; what only rounding is left of counts as white."""
        error = done.error
        sums, count = sums_of(error, self.known)
        if count >= LEAST and np.isfinite(sums).all() and not self.is_rounding(done):
            self.noise = Autoregression.of_sums(sums, count)
        else:
            self.noise = Autoregression.white(float(error @ error), error.size)

    def misfit(self, done: Pass) -> float:
        """Return J, the part of a pass's whitened residual that the reference explains.

        Without a reference the whole power of the whitened error of the predicted output.
        """
        white = self.whiten(done.ahead if self.projection is None else done.error)
        if not np.isfinite(white).all():
            return math.inf
        if self.projection is None:
            return float(white @ white)
        functions = self.whiten(self.projection.functions)
        amounts = orthogonal(products(functions, functions)).T @ products(functions, white[:, None])
        return float(np.sum(amounts**2))

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
            current = self.bounded(found)
            if change.max() <= STILL * math.sqrt(done.cost) or stalls >= patience:
                break
        return best, best_model, current

    def polish(self, model: FloatArray) -> tuple[FloatArray, Pass, bool]:
        """Take damped Gauss-Newton steps on the output error; return the model, its pass, whether it converged."""
        done = self.run(model)
        for _ in range(POLISH):
            gradient = done.zeta.T @ done.error
            direction = solve(done.zeta.T @ done.zeta, gradient)
            if direction is None:
                return model, done, False
            gain = float(direction @ gradient) / self.record.u.size
            samples = self.record.u.size
            # converged: the step is a thousandth of a standard deviation, or the error is rounding
            if gain * samples <= DONE * done.cost or self.is_rounding(done):
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

    def descend(self, model: FloatArray, steps: int, renewals: Sequence[int] = ()) -> Root | None:
        """Take damped steps on the whitened residual; None where the first pass fails.

        Parameters
        ----------
        model : (T,) array
        steps : int
            At the most.
        renewals : sequence of int
            Steps at which the noise model is renewed.
        """
        done = self.run(model)
        if not math.isfinite(done.cost):
            return None
        slack, moved = 1.0 + SLACK[self.projection is not None], math.inf
        for step in range(steps):
            if self.is_rounding(done):
                moved = 0.0
                break
            if step in renewals:
                self.renew_noise(done)
            zeta, white = self.whiten(done.zeta), self.whiten(done.error)
            variance, limit, better = max(float(white @ white) / white.size, 1e-300), self.misfit(done) * slack, None
            # the instrumental-variable step finds its way from far; that of Gauss and Newton lowers the cost for sure
            # where that is the innovation's power, but J has the noise of the instruments in it
            companions = [self.whiten(done.phi), zeta]
            if self.projection is None:
                companions.reverse()
            for companion in companions:
                direction = solve(zeta.T @ companion, zeta.T @ white)
                if direction is None:
                    continue
                moved = float(np.sum((zeta @ direction) ** 2)) / variance
                better = self._shortened(model, direction, limit)
                if better is not None:
                    break
            if better is None:
                break
            model, done = better
            if moved < STILL and step >= max(renewals, default=0):
                break
        white = self.whiten(done.error if self.projection is not None else done.ahead)
        variance = float(white @ white) / white.size
        return Root(model, done, self.noise, variance, self.misfit(done), moved <= NEARLY_DONE)

    def _shortened(self, model: FloatArray, direction: FloatArray, limit: float) -> tuple[FloatArray, Pass] | None:
        """Return the model after the longest of `SHORTENED` halved steps whose cost is within the limit, or None."""
        for halvings in range(SHORTENED):
            tried = model + direction * 0.5**halvings
            if self.is_usable(tried):
                done = self.run(tried)
                if math.isfinite(done.cost) and self.misfit(done) <= limit:
                    return tried, done
        return None


def _known(record: Record) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return how many residuals before each of a record are one sampling time apart, up to LAGS."""
    from replant.kernels.filters.whitening import IRREGULAR

    index = np.arange(record.u.size)
    if record.intervals.size == 1:
        return np.minimum(index, LAGS)
    nominal = float(np.median(record.intervals[1:]))
    broken = np.abs(record.intervals - nominal) > IRREGULAR * nominal
    broken[0] = True
    last = np.maximum.accumulate(np.where(broken, index, 0))
    return np.minimum(index - last, LAGS)


@quiet
def refine(
    structure: Structure,
    record: Record,
    given: Sequence[FloatArray] = (),
    *,
    afresh: bool = False,
    filtered: bool = True,
) -> Refined | None:
    """Return the refined instrumental-variable estimate of a record; None where no start leads to a model.

    Every start is improved by a few steps, the most promising ones by more.  Then the noise model is found, and the
    best models are improved with it.

    Parameters
    ----------
    structure : Structure
    record : Record
        Usable samples, a few more than there are parameters and nuisances.
    given : sequence of (T,) arrays
        Estimates to start from; without any, estimates behind `CUTOFFS` state-variable filters.
    afresh : bool
        Start from these filters as well.
    filtered : bool
        False where the residual is known to be no noise: the noise model then filters nothing.

    Examples
    --------
    >>> from replant.model.transfer_function import TransferFunction
    >>> u = np.where(np.arange(400) // 50 % 2 == 0, 1.0, -1.0)
    >>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, 0.1)
    >>> refine(Structure(1), Record(u, y, np.array([0.1]))).theta[:2].round(6)
    array([0.5, 2. ])
    """
    problem = Problem(structure, record)
    starts: list[FloatArray | None] = [problem.bounded(np.asarray(theta, np.float64)) for theta in given]
    if not starts or afresh:
        cutoffs = np.geomspace(SLOWEST_CUTOFF / record.span, 1.0 / record.dt, CUTOFFS)
        starts += [problem.from_cutoff(float(cutoff)) for cutoff in cutoffs]
    usable = [start for start in starts if start is not None]
    if problem.projection is None:
        return _by_output_error(problem, usable, filtered=filtered)
    root = _by_reference(problem, usable)
    return None if root is None else conclude(problem.structure, record, problem.known, root, problem.projection)


def _by_output_error(problem: Problem, starts: Sequence[FloatArray], *, filtered: bool) -> Refined | None:
    """Return the estimate of the least output error, or where that is coloured noise of the least innovation."""
    tried = [problem.improve(start, SHORT, SHORT) for start in starts]
    tried.sort(key=lambda outcome: outcome[0])
    for _, _, last in list(tried[:PROMISING]):
        if last is not None:
            tried.append(problem.improve(last, LONG, STALLS))
    tried = sorted((outcome for outcome in tried if math.isfinite(outcome[0])), key=lambda outcome: outcome[0])
    if not tried:
        return None
    model, done, converged = problem.polish(tried[0][1])
    problem.renew_noise(done)
    power = done.cost * done.error.size
    plain = Root(model, done, problem.noise, done.cost, power, converged, filters=False)
    estimate = conclude(problem.structure, problem.record, problem.known, plain)
    if converged and (problem.noise.order == 0 or not filtered):
        return estimate
    others = [model for _, model in _distinct([(cost, model) for cost, model, _ in tried[1:]], tried[0][0])]
    root = _best([problem.descend(start, WHITENED, RENEWALS) for start in [model, *others[: PROMISING - 1]]])
    other = None if root is None else conclude(problem.structure, problem.record, problem.known, root)
    if estimate is None or other is None:
        return estimate or other
    return other if is_noise(problem.structure, problem.record, estimate, other) else estimate


def _by_reference(problem: Problem, starts: Sequence[FloatArray]) -> Root | None:
    """Return the root of which the reference explains least."""
    found = [problem.descend(start, SHORT) for start in starts]
    tried = sorted(((root.misfit, root.model) for root in found if root is not None), key=lambda outcome: outcome[0])
    ends = []
    for _, model in list(_distinct(tried))[:PROMISING]:
        problem.noise = Autoregression.white(1.0, problem.record.u.size)
        ends.append(problem.descend(model, WHITENED, RENEWALS))
    return _best(ends, referenced=True)


def _distinct(tried: Sequence[tuple[float, FloatArray]], known: float = math.nan) -> Iterator[tuple[float, FloatArray]]:
    """Yield the models whose cost differs from that of every one before, and from ``known``."""
    costs = [known]
    for cost, model in tried:
        if not any(abs(cost - one) <= AGREE * abs(one) for one in costs):
            costs.append(cost)
            yield cost, model


def _best(ends: Sequence[Root | None], *, referenced: bool = False) -> Root | None:
    """Return the root with the least innovation among those that are not too loud, or with a reference the least J.

    J tells a model that leaves the output to the autoregression from a right one, however loud its residual is: that of
    an integrator under a load of its input wanders far.
    """
    found = [end for end in ends if end is not None and math.isfinite(end.innovation)]
    if not found:
        return None
    if referenced:
        return min(found, key=lambda end: end.misfit / max(end.innovation, 1e-300))
    limit = LOUD * min(end.done.cost for end in found)
    return min((end for end in found if end.done.cost <= limit), key=lambda end: end.innovation)


def first_model(structure: Structure, record: Record) -> Refined | None:
    """Return the refined estimate of a record; None where it is too short, or input or reference constant."""
    least = 2 * structure.poles + structure.zeros + 3
    if record.u.size <= least or float(np.ptp(record.u)) == 0.0:
        return None
    if record.r is not None and float(np.ptp(record.r)) == 0.0:
        return None
    return refine(structure, record)
