r"""Refined instrumental variables for continuous-time models (SRIVC) on a record: offline fit and online start-up.

The regression :math:`s^n/A\, y = \varphi^T \theta` is prefiltered by 1/A of the current model.  It is solved with the
instruments :math:`\zeta`, the same regressor built from the model's noise-free output, and the solution is the next
model, until it no longer changes:

.. math:: \theta \leftarrow \Big(\sum \zeta \varphi^T\Big)^{-1} \sum \zeta\, s^n/A\, y

At that fixed point the equation error is exactly the output error of the model, y - B/A u: the estimate has no
discretisation error, for any y between samples.  The offset and the initial state are nuisance regressors, 1/A
and s^i/A of an impulse; of these only the bias is reported, if the structure has one.

The iteration may not converge.  Damped Gauss-Newton steps on the output error follow, which do.

If the residual e is coloured, D(q) e = w, then regressor, instruments and target are filtered by D(q), and the
iteration continues from the best models so far.  Filter and model are found in turn.  In feedback the instruments, made
of past inputs, are then independent of the innovation w, though not of e.

With a reference the instruments are the parts of input and output that it explains.  They are independent of all noise,
so that the estimate is consistent for any D(q), as are the starts with state-variable filters.  If none of these leads
to a model with a J within chance, starts by least squares are tried.  Steps and starts are compared by the part of w
that the reference explains,

.. math:: J = w^T L (L^T L)^{-1} L^T w.

A plant need not be stable: the filters are 1/D and the residual is A/D y - B/D u, see `replant.kernels.filters.bank`.
Without a reference such models are compared by the prediction error, as in the likelihood: a fast reflected pole makes
the residual of any model small.

Source: Young and Jakeman (1980), "Refined instrumental variable methods of recursive time-series analysis, part III",
International Journal of Control 31; Garnier and Wang (2008), "Identification of Continuous-time Models from Sampled
Data", chapter 4; Gilson, Garnier, Young and Van den Hof (2008), "Instrumental variable methods for closed-loop
continuous-time model identification", chapter 5 of the same book.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.fitted_run import simulate
from replant.estimation.simulation.model_run import runs_away
from replant.estimation.solver.refined_estimate import Refined, Root, no_surer, without_nuisances
from replant.estimation.solver.specification_test import (
    FALSE_ALARM,
    answer_of,
    chance_of,
    chance_of_dynamics,
    disagreement,
)
from replant.estimation.solver.srivc_steps import STALLS, Problem, is_long_enough
from replant.estimation.solver.undetermined_poles import INFINITE, grown, with_poles
from replant.kernels.schema import LAGUERRE
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression, duration_of
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import chi2_quantile, quiet, roots

CUTOFFS = 8  # state-variable filters tried for a start, evenly spaced in the logarithm [count]
SLOWEST_CUTOFF = 5.0  # slowest of them: five time constants are the record; the fastest is 1 / dt [1 / duration]
SHORT = 4  # iterations of each start [count]
LONG = 20  # iterations of the most promising starts [count]
PROMISING = 3  # starts that are iterated further [count]

AGREE = 1e-2
"""Difference of two costs up to which their models are the same root [part of the cost].
Origin: in the loops of the benchmark, different roots differ by more.
Sensitivity: halved or doubled, nothing changes on these records.
"""

RENEWALS = (0, 2, 4, 7, 10)
"""Whitened steps at which the noise model is renewed [count].
Origin: model and filter settle within ten steps in the loops of the benchmark.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

WHITENED = 60
"""Most whitened steps [count].
Origin: in 100 loops with an integrator and a load, the best root had not converged after 25 steps in 4, after 60 in
none.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LOUD = 3.0
"""Variance of the residual up to which a root is considered if the input responds to it [least of the roots].
Origin: by the innovation alone, a model without a numerator, which leaves the whole output to the autoregression, wins
in half of the runs of the PI and PID loops with a load.
Sensitivity: halved or doubled, nothing changes on these records.
"""

# the root of float64's precision: no measurement determines the initial state better
MOST_GROWN = 18.0  # growth within the record beyond which an unstable model's simulation is meaningless [exponent]

# one right root in a thousand is searched for twice
LIKELY = 0.999  # probability of a lower J at the right model, beyond which other starts are tried [probability]


@quiet
def refine(
    structure: Structure, record: Record, given: Sequence[FloatArray] = (), *, afresh: bool = False,
    filtered: bool = True, nested: bool = False,
) -> Refined | None:  # fmt: skip
    """Return the refined estimate of a record, a ``nested`` one no worse than with fewer poles; None without one."""
    if not is_long_enough(structure, record):
        return None
    problem = Problem(structure, record)
    starts = [problem.bounded(np.asarray(theta, np.float64), INFINITE / record.dt) for theta in given]
    if not starts or afresh:
        starts += _from_cutoffs(problem)
    if problem.projection is None:
        if nested:
            starts += _with_fewer_poles(structure, record)
        return _by_output_error(problem, starts, filtered=filtered, afresh=not given or afresh)
    root = _by_reference(problem, starts)
    if root is None or root.relative_misfit > chi2_quantile(LIKELY, LAGUERRE + 1):
        # with a strong load every start by instruments is bad; least squares is biased, but scatters less
        others = _from_cutoffs(problem, by_reference=False) if not given or afresh else []
        root = _best([root, _by_reference(problem, others)])
    return None if root is None else problem.conclude(root)


def _from_cutoffs(
    problem: Problem, noise: Autoregression | None = None, *, by_reference: bool = True
) -> list[FloatArray]:
    """Return the starts with state-variable filters, also filtered by a noise model if there is one."""
    record = problem.whole
    problem.noise = Autoregression.white(1.0, problem.record.u.size) if noise is None else noise
    cutoffs = np.geomspace(SLOWEST_CUTOFF / record.span, 1.0 / record.dt, CUTOFFS)
    found = (problem.from_cutoff(float(cutoff), by_reference=by_reference) for cutoff in cutoffs)
    return [start for start in found if start is not None]


def _with_fewer_poles(structure: Structure, record: Record) -> list[FloatArray]:
    """Return the stable model of least output error with one pole fewer, in the structure's form; [] without one."""
    if structure.poles == 1:
        return []
    less = with_poles(structure, structure.poles - 1)
    problem = Problem(less, record)
    starts = _with_fewer_poles(less, record) or _from_cutoffs(problem)
    starts = _promising(problem, [problem.stabilized(start) for start in starts], stable=True)
    if not starts:
        return []
    theta = grown(less, _plain(problem, starts, stable=True).model, structure, record.dt / INFINITE)
    return [Problem(structure, record).with_nuisances(without_nuisances(structure, theta))]


def _by_output_error(problem: Problem, starts: Sequence[FloatArray], *, filtered: bool, afresh: bool) -> Refined | None:
    """Return the estimate of the least output error, or that of the least innovation if its noise model is right."""
    distinct = _promising(problem, starts)
    if not distinct:
        return None
    plain = _plain(problem, distinct)
    if not (problem.is_stable(plain.model) or answer_of(problem.record, plain.noise, plain.done.error).found):
        stable = _promising(problem, [problem.stabilized(start) for start in starts], stable=True)
        rival = _plain(problem, stable, stable=True) if stable else plain
        plain = plain if _runs_away_surely(problem, plain.model, rival.innovation) else rival
    if plain.converged and (plain.noise.order == 0 or not filtered):
        return problem.conclude(plain)
    starts = [plain.model, *distinct[1:], *(_whitened_start(problem, plain.noise) if afresh else ())]
    ends = [problem.descend(start, WHITENED, RENEWALS) for start in starts]
    root = _best(ends, problem.record)
    if root is None:
        return problem.conclude(plain)
    alone = problem.is_stable(plain.model) and not problem.is_stable(root.model)
    if alone and not answer_of(problem.record, root.noise, root.done.error).found:
        # an unstable plant is recorded in feedback only: without it, an unstable model has fitted the drift
        starts = [problem.stabilized(end.model) for end in ends if end is not None]
        ends = [problem.descend(start, WHITENED, RENEWALS, stable=True) for start in starts]
        root = _best([end for end in ends if end is not None and end.converged], problem.record)
        if root is None:
            return problem.conclude(plain)
    if not root.converged:  # a cost with a kink at the axis takes longer
        root = _best([root, problem.descend(root.model, WHITENED, RENEWALS)], problem.record) or root
    if not (plain.converged and problem.is_stable(plain.model)):  # also from the other root
        plain = _plain(problem, [plain.model, root.model], stable=problem.is_stable(plain.model))
    estimate, other = problem.conclude(plain), problem.conclude(root)
    if estimate is None or other is None:
        return estimate or other
    if not (root.converged or root.at_kink) and plain.converged and problem.is_stable(plain.model):
        return estimate
    chance = chance_of(problem.structure, problem.whole, estimate, other)
    if chance < FALSE_ALARM and (near := _likelier_near(problem, root, plain)) is not None:
        estimate = near
        chance = chance_of(problem.structure, problem.whole, estimate, other)
    if chance >= FALSE_ALARM:
        return other
    if chance >= ALPHA:  # not enough by itself to reject the structure
        chance = chance_of_dynamics(problem.structure, problem.whole, other)
        return other if chance >= FALSE_ALARM else no_surer(estimate, other)
    return replace(estimate, disagreement=disagreement(problem.structure, problem.whole, estimate, other))


def _whitened_start(problem: Problem, noise: Autoregression) -> list[FloatArray]:
    """Return the likeliest start with state-variable filters and a noise model; [] without one."""
    # the output error ranks starts by how well they follow a drift, if that is larger than the response to u
    return sorted(_from_cutoffs(problem, noise), key=lambda start: problem.misfit(problem.run(start)))[:1]


def _likelier_near(problem: Problem, root: Root, plain: Root) -> Refined | None:
    """Return the estimate of least output error near a filtered root; None unless it is likelier than the plain one."""
    # the specification test is about one root; another root, chosen among all, may simulate better by following a drift
    near = problem.polished(root.model, stable=problem.is_stable(plain.model))
    costs = []
    for end in (near, plain):
        problem.noise = end.noise
        costs.append(problem.misfit(end.done))
    if not 0.0 < costs[0] < math.inf or 0.5 * problem.record.count * math.log(costs[1] / costs[0]) <= -math.log(ALPHA):
        return None
    return problem.conclude(near)


def _promising(problem: Problem, starts: Sequence[FloatArray], *, stable: bool = False) -> list[FloatArray]:
    """Return up to `PROMISING` distinct models of least output error, iterated from the starts."""
    tried = sorted((problem.improve(start, SHORT, SHORT, stable=stable) for start in starts), key=itemgetter(0))
    lasts = [last for _, _, last in tried[:PROMISING] if last is not None]
    tried = sorted([*tried, *(problem.improve(last, LONG, STALLS, stable=stable) for last in lasts)], key=itemgetter(0))
    return _distinct([(cost, model) for cost, model, _ in tried if math.isfinite(cost)])


def _plain(problem: Problem, starts: Sequence[FloatArray], *, stable: bool = False) -> Root:
    """Return the root of the least output error, among stable models or all."""
    starts = [problem.stabilized(start) for start in starts] if stable else starts
    return _likeliest([problem.polished(start, stable=stable) for start in starts])


def _runs_away_surely(problem: Problem, model: FloatArray, power: float) -> bool:
    """Return whether an unstable model, simulated, explains surely more than a stable one with error ``power``."""
    # a fitted drift leaves slow noise, with few independent samples
    record, plant = problem.whole, problem.structure.transfer_function(model[: problem.structure.size])
    if float(roots(plant.den).real.max()) * record.span > MOST_GROWN:
        return False
    y = np.where(record.is_measured, record.y, np.nan)
    error = y.copy()
    for rows in record.records:
        dt, t = record.clock(rows)
        error[rows] -= simulate(plant, record.u[rows], y[rows], dt, input_hold=record.input_hold, t=t).output
    square = float(np.nanmean(error**2))
    if not 0.0 < square < power:
        return square < power
    if not runs_away(plant.den, record.span):  # as with the estimate of an integrator
        return True
    noise = Autoregression.of_residual(np.nan_to_num(error), record.predecessors, record.count)
    return 0.5 * record.count / duration_of(noise.coefficients) * math.log(power / square) > -math.log(ALPHA)


def _by_reference(problem: Problem, starts: Sequence[FloatArray]) -> Root | None:
    """Return the root whose residual the reference explains least."""
    # whitened from the first step on: with a drifting load, the reference explains so little of an unfiltered residual
    # that a model without a numerator seems the best
    tried = []
    for start in starts:
        problem.noise = Autoregression.white(1.0, problem.record.u.size)
        root = problem.descend(start, SHORT, RENEWALS[:2])
        if root is not None:
            tried.append((root.relative_misfit, root.model))
    ends = []
    for model in _distinct(sorted(tried, key=itemgetter(0))):
        problem.noise = Autoregression.white(1.0, problem.record.u.size)
        ends.append(problem.descend(model, WHITENED, RENEWALS))
    return _best(ends)


def _distinct(tried: Sequence[tuple[float, FloatArray]]) -> list[FloatArray]:
    """Return the first `PROMISING` models whose cost differs from that of every earlier one."""
    found: list[tuple[float, FloatArray]] = []
    for cost, model in tried:
        if not any(abs(cost - one) <= AGREE * abs(one) for one, _ in found):
            found.append((cost, model))
    return [model for _, model in found[:PROMISING]]


def _best(ends: Sequence[Root | None], record: Record | None = None) -> Root | None:
    """Return the root of least innovation in a record, among those not too loud; without ``record``, of least J."""
    found = [end for end in ends if end is not None and math.isfinite(end.innovation)]
    if not found:
        return None
    # J distinguishes a right model from one that leaves the output to the autoregression, however large the residual
    # is: with a load at the input of an integrator it wanders far
    if record is None:
        return min(found, key=lambda end: end.relative_misfit)
    limit, likeliest = LOUD * min(end.done.cost for end in found), _likeliest(found)
    # in feedback a loud root leaves the output to the autoregression; in open loop a large residual is a drift
    if likeliest.done.cost <= limit or not answer_of(record, likeliest.noise, likeliest.done.error).found:
        return likeliest
    return _likeliest([end for end in found if end.done.cost <= limit])


def _likeliest(ends: Sequence[Root]) -> Root:
    """Return the root of least innovation, a converged one among equals."""
    least = min(end.innovation for end in ends)
    alike = [end for end in ends if end.innovation <= (1.0 + AGREE) * least]
    return min(alike, key=lambda end: (not end.converged, end.innovation))
