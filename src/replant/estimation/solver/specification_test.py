r"""The choice between two estimates of a record by a specification test.

PLAIN, the least output error, is consistent in open loop for any noise.  FILTERED, found with the noise model as a
filter, is efficient if that is right, nearly consistent in feedback, and far off if the structure is wrong.  Hausman's
test decides: if FILTERED is right, its residual :math:`e_f` is noise v independent of the input, and the smaller
residual of PLAIN is chance,

.. math:: q = |e_f|^2 - |e_p|^2 = s^T G^{-1} s, \quad s = Z^T e_f = W^T v, \quad
          W = Z - D^T D X (X^T D^T D X)^{-1} X^T Z, \quad G = Z^T Z

with X = [Z, nuisances], Z the derivatives of the simulated output with the nuisances projected out, and D the noise
model as a filter.  The covariance of s is the mean over frequency of :math:`W W^* |V|^2`; :math:`|V|^2` is the
periodogram of :math:`e_p` over 1 - leverage, which corrects for the fit.  It needs no model of v, no bandwidth and no
batches.  With :math:`\Lambda = G^{-1/2} \mathrm{cov}(s) G^{-1/2}`

.. math:: q / \mathrm{tr} \Lambda \sim F(h, \nu), \qquad h = (\mathrm{tr} \Lambda)^2 / \mathrm{tr} \Lambda^2,

:math:`\nu` the effective number of periodogram ordinates in the mean (Satterthwaite on both sides).

Feedback makes s large as well.  The input is split into the part that responds to the whitened residual and the rest
:math:`u_r`.  With :math:`\delta = (G_p - G_f) u` and :math:`\delta_r` of :math:`u_r`,
:math:`\varphi = \delta_r^T e_f / \delta^T e_f` is 0 for a right model in feedback and 1 in open loop; q is multiplied
by :math:`\varphi^2`.  If the two estimates hardly differ, :math:`\varphi` is a ratio of two noises: it is used only if
:math:`\delta_r^T e_f` is significant.  The variance of this product is the mean over frequency of
:math:`|\Delta_r|^2 |V|^2`; as the data choose the direction of :math:`\delta`, its square over the variance is
compared with :math:`\chi^2_h` (Scheffe).

If q casts doubt on FILTERED without rejecting it, the whitened residual of FILTERED is tested as well: with a wrong
structure, other dynamics explain part of it (F test); in open loop these include the input of the same sample.
Drifting noise hides a wrong structure from this test no more than from q, but makes PLAIN up to ten times less certain.

A controller opposes a disturbance.  If the correlation of input and residual at the same sample has instead the sign
of the plant's response, the plant has faster dynamics than the model, and :math:`\varphi = 1`.  If the residual of a
stable PLAIN is so correlated, an unstable FILTERED is rejected.

Sources: Hausman (1978), "Specification tests in econometrics", Econometrica 46; Robinson (1998), "Inference without
smoothing in the presence of nonparametric autocorrelation", Econometrica 66; MacKinnon and White (1985), "Some
heteroskedasticity-consistent covariance matrix estimators", Journal of Econometrics 29 (HC2); Scheffe (1953), "A
method for judging all contrasts in the analysis of variance", Biometrika 40.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import ModelRun, run_model, runs_away
from replant.estimation.solver.feedback_test import Feedback, answering, part_answering
from replant.estimation.solver.refined_estimate import Refined
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import combined, inner, products, pseudo_inverse, quiet, sum_of_squares
from replant.numerics.projections import lengths_of, orthogonal, without
from replant.numerics.score_test import Residual

# on 70 field records of `make campaign` the noise-free fit does not depend on it from 0.01 to 0.3; on logs of real
# rigs, where no structure is right, a filtered estimate that is kept costs 1 to 24 points of the fit
FALSE_ALARM = 0.15  # level of each of the two tests that together reject a filtered estimate [probability]

MOST = 0.5
"""Share phi of the difference of two estimates up to which feedback explains it: the estimate of feedback is noisy
[share].
Origin: 184 loops with autoregressive noise: right models have shares of 0 to 0.4, except three integrators.
Sensitivity: halved, some of these right models are rejected; doubled, feedback explains any difference.
"""

LEAST_LEFT = 0.02  # least share of an ordinate left by the fit: a smaller one is rounding of the leverage [share]


@quiet
def chance_of(structure: Structure, record: Record, plain: Refined, filtered: Refined) -> float:
    """Return the p-value of a right filtered estimate, by how much better the plain one simulates."""
    run_p, run_f = (run_model(structure, one.theta[: structure.size], record, record.dt) for one in (plain, filtered))
    if run_f is None:
        return 0.0
    away = [runs_away(np.append(1.0, one.theta[structure.denominator]), record.span) for one in (plain, filtered)]
    if run_p is None or away[0]:
        return 1.0
    noise = filtered.noise_model
    whole = _whole(record, noise.order)
    if away[1]:  # an unstable plant is in feedback; it has no simulation error to compare
        at_once = answer_of(record, plain.noise_model, run_p.error)  # due to a plant faster than the model
        return float(answer_of(record, noise, run_f.error).found and not at_once.is_direct(structure, plain.theta))
    statistic, degrees, ordinates = hausman(run_p, run_f, noise, whole)
    chance = _chance(statistic, degrees, ordinates)
    if chance >= FALSE_ALARM:
        return chance
    share = _share_of_feedback(structure, record, (plain, filtered), (run_p, run_f), whole, degrees)
    return _chance(share**2 * statistic, degrees, ordinates)


@quiet
def chance_of_dynamics(structure: Structure, record: Record, filtered: Refined) -> float:
    """Return the p-value of a right filtered estimate, by how much other dynamics explain of its residual."""
    run = run_model(structure, filtered.theta[: structure.size], record, record.dt)
    if run is None or runs_away(np.append(1.0, filtered.theta[structure.denominator]), record.span):
        return 0.0
    noise = filtered.noise_model
    columns = run.dynamics(slice(None), record.dt, record.span, feedback=True)
    answer = answer_of(record, noise, run.error)
    if not answer.found or answer.is_direct(structure, filtered.theta):  # an effect of the same sample is the plant's
        columns = np.column_stack([columns, run.u])
    used, known = record.predecessors >= noise.order, np.hstack([run.zeta, run.nuisances])
    return Residual.of(run.error, known, record.predecessors, used, noise).explained(columns).chance


def disagreement(structure: Structure, record: Record, plain: Refined, filtered: Refined) -> float:
    """Return the rms difference of the outputs of two estimates over that of the plain one; at most 1."""
    runs = [run_model(structure, one.theta[: structure.size], record, record.dt) for one in (plain, filtered)]
    if runs[0] is None or runs[1] is None:
        return 1.0
    apart = without(np.column_stack([runs[0].forced - runs[1].forced, runs[0].forced]), runs[0].nuisances)
    size, whole = np.linalg.norm(apart, axis=0)
    return float(size / whole) if size < whole else 1.0


def hausman(run_p: ModelRun, run_f: ModelRun, noise: Autoregression, whole: FloatArray) -> tuple[float, float, float]:
    """Return q / tr Lambda, and the degrees of freedom h and nu of its distribution."""
    size = run_f.zeta.shape[1]
    x = np.hstack([run_f.zeta, run_f.nuisances])
    x = x / lengths_of(x)
    z = without(x[:, :size], x[:, size:])
    filtered = noise.ahead(x) * whole[:, None]
    weights = pseudo_inverse(products(filtered, filtered), 1e-13)[:, :size] @ products(x[:, :size], z)
    back = filtered.copy()  # filtered again, by the transpose of `Autoregression.ahead`
    for lag in range(1, noise.order + 1):
        back[:-lag] += noise.coefficients[lag] * filtered[lag:]
    w = combined(z - combined(back, weights), orthogonal(products(z, z)))
    spectra = np.fft.rfft(w, _length(w), axis=0)
    power = _noise_power(run_p)
    # a power of two: squares stay finite, without rounding
    level = math.ldexp(1.0, math.frexp(float(power.max()))[1] - 1)
    power = power / level
    covariance = products(spectra.conj() * power[:, None], spectra).real
    trace = max(float(np.trace(covariance)), np.finfo(float).tiny)
    each = (np.abs(spectra) ** 2).sum(axis=1) * power
    # padded to twice the length: two ordinates count as one
    each = each[: each.size // 2 * 2].reshape(-1, 2).sum(axis=1)
    ordinates = 4.0 * float(each.sum()) ** 2 / max(float((each**2).sum()), np.finfo(float).tiny)
    q = sum_of_squares(run_f.error) - sum_of_squares(run_p.error)
    return max(q, 0.0) / level / trace, trace**2 / max(float(np.sum(covariance**2)), np.finfo(float).tiny), ordinates


def _noise_power(run: ModelRun) -> FloatArray:
    """Return the periodogram of a residual over the transform's length, corrected for the leverage of the fit."""
    samples, length = run.error.size, _length(run.error)
    columns = np.hstack([run.zeta, run.nuisances])
    columns = columns / lengths_of(columns)
    basis = combined(columns, orthogonal(products(columns, columns)))
    leverage = (np.abs(np.fft.rfft(basis, length, axis=0)) ** 2).sum(axis=1) / samples
    power = np.abs(np.fft.rfft(run.error, length)) ** 2 / samples / np.maximum(1.0 - leverage, LEAST_LEFT)
    power[1:-1] *= 2.0
    return np.asarray(power / length)


def _share_of_feedback(
    structure: Structure,
    record: Record,
    estimates: tuple[Refined, Refined],
    runs: tuple[ModelRun, ModelRun],
    whole: FloatArray,
    degrees: float,
) -> float:
    """Return the share of the difference between two estimates that feedback does not explain, phi."""
    from scipy import special  # slow to import

    u, w = record.u - record.u.mean(), estimates[1].noise_model.ahead(runs[1].error) * whole
    feedback = answering(u, w, record.inputs_before)
    if not feedback.found or feedback.is_direct(structure, estimates[1].theta):
        return 1.0
    rest = dataclasses.replace(record, u=u - part_answering(u, w, record.inputs_before))
    purged = [run_model(structure, one.theta[: structure.size], rest, record.dt) for one in estimates]
    if purged[0] is None or purged[1] is None:
        return 0.0
    deltas = np.column_stack([runs[0].forced - runs[1].forced, purged[0].forced - purged[1].forced])
    deltas = without(deltas, runs[1].nuisances)
    all_of_it, of_the_rest = products(deltas, runs[1].error)
    share = min(float(of_the_rest / all_of_it), 1.0) if all_of_it > 0.0 else 0.0
    told = max(_score(deltas[:, 1], runs[1].error, runs[0]), 0.0)
    is_chance = special.chdtrc(degrees, told * told) >= FALSE_ALARM
    return 0.0 if is_chance or share <= MOST else share


def _score(signal: FloatArray, error: FloatArray, run: ModelRun) -> float:
    """Return the product of a signal (K,) and an error (K,), in its standard deviations under a run's noise."""
    unit, power = signal / lengths_of(signal[:, None]), _noise_power(run)
    level = max(float(power.max()), np.finfo(float).tiny)  # products of squares stay finite
    variance = inner(np.abs(np.fft.rfft(unit, _length(unit))) ** 2, power / level)
    return inner(unit, error) / math.sqrt(level) / math.sqrt(max(variance, np.finfo(float).tiny))


def answer_of(record: Record, noise: Autoregression, error: FloatArray) -> Feedback:
    """Return how a record's input responds to a residual (K,), as in feedback."""
    w = noise.ahead(error) * _whole(record, noise.order)
    return answering(record.u - record.u.mean(), w, record.inputs_before)


def _chance(statistic: float, degrees: float, ordinates: float) -> float:
    from scipy.special import fdtrc  # slow to import

    return float(fdtrc(degrees, ordinates, statistic))


def _length(signal: FloatArray) -> int:
    """Return the length, a power of two from 2 K on, of the zero-padded Fourier transform of a signal (K, ...)."""
    return 1 << (2 * len(signal) - 1).bit_length()


def _whole(record: Record, order: int) -> FloatArray:
    """Return 1 where a record's residual has ``order`` known predecessors one sampling time apart, else 0, (K,)."""
    return np.asarray(record.predecessors >= order, np.float64)
