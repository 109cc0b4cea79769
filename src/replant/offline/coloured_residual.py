r"""A coloured residual: noise, or what the model cannot explain.

Where the residual is noise, the estimate that is filtered by the noise model is the better one, and in feedback the
only one that is right.  Where it is what a wrong model leaves, as of a plant that is slightly nonlinear, the filter
weighs high frequencies, where a slow error is least and the model matters least: the simulated output fits worse.

Two tests tell them apart:

* In feedback the input answers the output: given its own past it depends on the output now and before.  In open loop it
  does not (Granger's causality).  What is left of the input once its past is known, and the output's correlations with
  that, make a statistic with the :math:`\chi^2` of their number.
* In open loop the estimate without a filter is right whatever the noise is.  It is kept where the input still explains
  a part of its residual (`replant.assessment.cross_test`): then that residual is no noise.

Sources: Granger (1969), "Investigating causal relations by econometric models and cross-spectral methods",
Econometrica 37; Caines and Chan (1975), "Feedback between stationary stochastic processes", IEEE Transactions on
Automatic Control 20.
"""

from __future__ import annotations

import numpy as np

from replant.arguments import FloatArray, IntArray
from replant.assessment.cross_test import unexplained
from replant.assessment.feedback_test import FALSE_ALARM, LEFT, PAST, PER_COLUMN
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.refined import Refined
from replant.simulation.model_run import run_model
from replant.statistics.chi2 import chi2_quantile
from replant.statistics.linear_algebra import quiet, roots
from replant.statistics.projections import lengths_of, orthogonal, products, without
from replant.statistics.robust import robust_std

ANSWERS = 10
"""Past outputs that the input may answer, beside the present one [samples].
Origin: as LATEST of the feedback test.
Sensitivity: halved or doubled, nothing changes on these records.
"""

FEWEST = PER_COLUMN * (PAST + ANSWERS + 2)
"""Samples below which nothing is told [samples].
Derivation: eight for each column, as in the feedback test.
"""

JUMP = 4.0
"""Movement of the input, its past known, beyond which a sample is left out: a set-point that steps drowns the answers
[standard deviations, robust].
Origin: of normal movements one in 16,000 is left out.
Sensitivity: halved or doubled, nothing changes on these records.
"""


@quiet
def is_noise(structure: Structure, record: Record, plain: Refined, filtered: Refined) -> bool:
    """Return whether the residual is noise, so that the filtered estimate is to be taken.

    Parameters
    ----------
    structure : Structure
    record : Record
    plain, filtered : Refined
        Estimates without and with the noise model as a filter.

    Notes
    -----
    False for a record of fewer than `FEWEST` samples of a stable plant, which cannot tell.
    """
    poles = roots(np.concatenate([[1.0], filtered.theta[structure.denominator]]))
    if filtered.converged and (not plain.converged or poles.real.max() >= 0.0):
        return True  # a plant that is not stable is in feedback
    if record.u.size < PAST + FEWEST:
        return False  # too short to tell
    if answers_output(record.u, record.y):
        return True  # then the plain one is wrong, and a filtered one right but for the last steps
    if not filtered.converged:
        return False
    run = run_model(structure, plain.theta[: structure.size], record, record.dt)
    return run is not None and unexplained(run, slice(0, record.u.size), record.dt).statistic <= 1.0


@quiet
def answers_output(u: FloatArray, y: FloatArray) -> bool:
    """Return whether an input (K,) answers an output (K,), as under a controller.

    Examples
    --------
    >>> y, r = np.random.default_rng(0).standard_normal((2, 1000))
    >>> answers_output(r - 0.5 * y, y), answers_output(r, y)
    (True, False)
    """
    count = u.size - PAST
    if count < FEWEST:
        return False
    index = np.arange(PAST, u.size)
    now, outputs = _left(u, y, index)
    calm = np.abs(now) <= JUMP * robust_std(now)
    if int(calm.sum()) >= max(count // 2, FEWEST):  # a set-point steps: what is left moves
        now, outputs = _left(u, y, index[calm])
    count = now.size
    if not np.linalg.norm(now) > LEFT * np.linalg.norm(u - u.mean()):
        return False
    outputs = outputs / lengths_of(outputs)
    amounts = orthogonal(products(outputs, outputs)).T @ products(outputs, now[:, None])[:, 0]
    explained, power = float(amounts @ amounts), float(now @ now)
    rest = max(power - explained, 1e-12 * power) / max(count - amounts.size, 1)
    return bool(explained / rest > chi2_quantile(1.0 - FALSE_ALARM, amounts.size))


def _left(u: FloatArray, y: FloatArray, index: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return the input (K,) and the newest outputs (K, ANSWERS + 1) at these samples, less what past inputs tell."""
    told = np.column_stack([*(u[index - lag] for lag in range(1, PAST + 1)), np.ones(index.size)])
    outputs = np.column_stack([y[index - lag] for lag in range(ANSWERS + 1)])
    left = without(np.column_stack([u[index], outputs]), told)
    return left[:, 0], left[:, 1:]
