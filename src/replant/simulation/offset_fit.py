"""The free run of a model beside the measured output, and how well they agree: fit in percent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray, vector
from replant.errors import InvalidArgumentError
from replant.model.transfer_function import TransferFunction
from replant.simulation.free_run import free_run
from replant.statistics.linear_algebra import least_norm, quiet

RANK_TOLERANCE = 1e-12
"""Singular value of the scaled free responses below which it counts as zero [part of the largest].
Derivation: some thousand times the precision of float64.
"""


@dataclass(frozen=True)
class Simulation:
    """A free run of a model beside the measured output.

    Attributes
    ----------
    output : (K,) array
        Simulated output, with the estimated offset and initial state.
    offset : float
        Estimated constant between measured and simulated output, in the unit of y.
    fit : float
        Fit in percent over the finite samples.
    """

    output: FloatArray
    offset: float
    fit: float


def fit_percent(measured: FloatArray, modelled: FloatArray) -> float:
    r"""Return :math:`100 (1 - \|y - \hat y\| / \|y - \bar y\|)`; samples where either is NaN are left out.

    100 is a perfect model, 0 no better than the mean, below 0 worse than the mean; NaN if the output is constant.

    Examples
    --------
    >>> fit_percent(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 2.0]))
    100.0
    """
    measured, modelled = vector("measured", measured), vector("modelled", modelled)
    if measured.size != modelled.size:
        raise InvalidArgumentError(
            f"measured and modelled must have the same length, got {measured.size} and {modelled.size} samples"
        )
    kept = np.isfinite(measured) & ~np.isnan(modelled)
    y, model = measured[kept], modelled[kept]
    if y.size == 0 or y.min() == y.max():
        return math.nan
    with np.errstate(over="ignore", invalid="ignore"):
        return float(100.0 * (1.0 - np.linalg.norm(y - model) / np.linalg.norm(y - y.mean())))


def simulate(
    model: TransferFunction,
    u: FloatArray,
    y: FloatArray,
    dt: float,
    *,
    input_hold: str = "zoh",
    t: FloatArray | None = None,
) -> Simulation:
    """Run ``model`` from the input alone; offset and initial state are those that fit ``y`` best (least squares).

    Parameters
    ----------
    model : TransferFunction
    u, y : (K,) arrays
        Mapped input and measured output, working point subtracted or not (the offset takes it up).  Samples that are
        not finite are bridged by the last finite input and left out of the fit.
    dt : float
        Sampling time in s.
    t : (K,) array, optional
        Time stamps in s, where the clock is not regular.

    Examples
    --------
    >>> g = TransferFunction([2.0], [1.0, 1.0])
    >>> u = np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    >>> simulate(g, u, g.simulate(u, 0.1) + 5.0, 0.1).offset
    5.0...
    """
    u, _ = bridged(u)
    with np.errstate(over="ignore", invalid="ignore"):
        if t is None:
            forced = model.simulate(u, dt, input_hold=input_hold)
            free = model.free_responses(u.size, dt)
        else:
            forced, free = free_run(model, u, np.diff(t, prepend=t[0] - dt), dt, input_hold)
        weights = initial_weights(forced, free, y)
        if weights is None:
            return Simulation(np.full(u.size, np.nan), 0.0, -math.inf)
        output = with_initial(forced, free, weights)
    return Simulation(output, float(weights[0]), fit_percent(y, output))


@quiet
def initial_weights(forced: FloatArray, free: FloatArray, y: FloatArray) -> FloatArray | None:
    """Return the offset and the initial state (n + 1,) with which a run from rest fits ``y`` best; None if none does.

    Zero stands for a response that leaves float64.
    """
    kept = np.isfinite(y) & np.isfinite(forced)
    if not kept.any() or not np.isfinite(forced).all():
        return None
    basis = np.column_stack([np.ones(y.size), free])
    usable = np.isfinite(basis).all(axis=0)
    basis = basis[kept][:, usable]
    lengths = np.linalg.norm(basis, axis=0)
    lengths[lengths == 0.0] = 1.0
    # a response that has died out, or that grows beyond reason, must not spoil the others: scaled columns
    found, rank, _ = least_norm(basis / lengths, y[kept] - forced[kept], RANK_TOLERANCE)
    if rank == 0:
        return None
    weights = np.zeros(usable.size)
    weights[usable] = found / lengths
    return weights


def with_initial(forced: FloatArray, free: FloatArray, weights: FloatArray) -> FloatArray:
    """Return a run from rest (K,) with what offset and initial state (n + 1,) add."""
    used = weights[1:] != 0.0
    return np.asarray(forced + weights[0] + free[:, used] @ weights[1:][used])


def bridged(u: FloatArray, before: float = 0.0) -> tuple[FloatArray, float]:
    """Return ``u`` (K,) with each entry that is not finite replaced by the last finite one, and that of the end.

    ``before`` is the last one before the first.
    """
    finite = np.isfinite(u)
    if not finite.all():
        last = np.maximum.accumulate(np.where(finite, np.arange(u.size), -1))
        u = np.where(last >= 0, u[np.maximum(last, 0)], before)
    return u, float(u[-1]) if u.size else before
