"""The free run of a model with offset and initial state fitted to the measured output, and the fit in percent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray, vector
from replant.errors import InvalidArgumentError
from replant.model.transfer_function import TransferFunction
from replant.simulation.fitted_parts import PartedRun, known_outputs, offset_of, state_of
from replant.simulation.record_response import RecordResponse
from replant.statistics.linear_algebra import least_norm, quiet

RANK_TOLERANCE = 1e-12
"""Singular value of the scaled free responses below which it counts as zero [part of the largest].
Derivation: some thousand times the precision of float64.
"""


@dataclass(frozen=True)
class Simulation:
    """The free run of a model, with offset and initial state fitted to a measured output.

    Attributes
    ----------
    output : (K,) array
        Simulated output, with the estimated offset and initial state.
    offset : float
        Estimated constant between measured and simulated output, in the unit of y.
    fit : float
        Fit in percent over the finite samples.
    is_prediction : bool
        Whether the output is predicted one step ahead instead, as of an unstable model, which would run away.
    """

    output: FloatArray
    offset: float
    fit: float
    is_prediction: bool = False

    @property
    def how(self) -> str:
        """In words what the output is made from."""
        return "predicted from input and past output" if self.is_prediction else "simulated from the input alone"


def fit_percent(measured: FloatArray, modelled: FloatArray) -> float:
    r"""Return the fit in percent, :math:`100 (1 - \|y - \hat y\| / \|y - \bar y\|)`; samples with a NaN are left out.

    A perfect model has 100, the mean of the output 0, a worse model less than 0.  A constant output has no fit: NaN.

    Parameters
    ----------
    measured, modelled : (K,) arrays

    Raises
    ------
    InvalidArgumentError
        If the two differ in length, or one is not a vector of real numbers.

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
    """Run a model from the input alone, with the offset and initial state that fit ``y`` best (least squares).

    Parameters
    ----------
    model : TransferFunction
    u, y : (K,) arrays
        Mapped input and measured output.  The working point need not be subtracted: the offset includes it.  An input
        that is not finite is replaced by the last finite one.  An output that is not finite is left out of the fit, and
        with a dead time those that answer to inputs from before the record.
    dt : float
        Sampling time in s.
    input_hold : {"zoh", "foh"}
        What the input does between samples.
    t : (K,) array, optional
        Time stamps in s of an irregular clock.  Behind each gap the state is fitted anew.

    Examples
    --------
    >>> g = TransferFunction([2.0], [1.0, 1.0])
    >>> u = np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    >>> simulate(g, u, g.simulate(u, 0.1) + 5.0, 0.1).offset
    5.0...
    """
    u, _ = bridged(u)
    if t is not None and u.size:
        return _simulate_parts(model, u, y, dt, input_hold, t)
    with np.errstate(over="ignore", invalid="ignore"):
        forced, free, unknown = RecordResponse(model, dt, input_hold).take(u)
        y = np.concatenate([np.full(unknown, np.nan), y[unknown:]])
        weights = initial_weights(forced, free, y)
        if weights is None:
            return Simulation(np.full(u.size, np.nan), 0.0, -math.inf)
        output = with_initial(forced, free, weights)
    return Simulation(output, float(weights[0]), fit_percent(y, output))


def _simulate_parts(
    model: TransferFunction, u: FloatArray, y: FloatArray, dt: float, input_hold: str, t: FloatArray
) -> Simulation:
    """Return what `simulate` does, on an irregular clock."""
    with np.errstate(over="ignore", invalid="ignore"):
        parts = PartedRun(model, dt, input_hold).take(u, t)
        offset = offset_of(parts, y)
        if not (math.isfinite(offset) and all(np.isfinite(part.forced).all() for part in parts)):
            return Simulation(np.full(u.size, np.nan), 0.0, -math.inf)
        output = [with_state(part.forced, part.free, offset, state_of(part, y, offset)) for part in parts]
        known = [known_outputs(part, y) for part in parts]
    joined = np.concatenate(output)
    return Simulation(joined, offset, fit_percent(np.concatenate(known), joined))


@quiet
def initial_weights(forced: FloatArray, free: FloatArray, y: FloatArray) -> FloatArray | None:
    """Return the offset and the initial state (n + 1,) that fit a run from rest to ``y`` best; None without a solution.

    The weight of a response that leaves float64 is zero.

    Parameters
    ----------
    forced : (K,) array
        Output from rest.
    free : (K, n) array
        Responses to unit initial states.
    y : (K,) array
        Measured output; NaN is left out.
    """
    kept = np.isfinite(y) & np.isfinite(forced)
    if not kept.any() or not np.isfinite(forced).all():
        return None
    basis = np.column_stack([np.ones(y.size), free])
    usable = np.isfinite(basis).all(axis=0)
    basis = basis[kept][:, usable]
    lengths = np.linalg.norm(basis, axis=0)
    lengths[lengths == 0.0] = 1.0
    # the columns are scaled: the sizes of a response that dies out and of one that grows differ by many decades
    found, rank, _ = least_norm(basis / lengths, y[kept] - forced[kept], RANK_TOLERANCE)
    if rank == 0:
        return None
    weights = np.zeros(usable.size)
    weights[usable] = found / lengths
    return weights


def with_initial(forced: FloatArray, free: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the output (K,) of a run with an offset and an initial state.

    Parameters
    ----------
    forced : (K,) array
        Output from rest.
    free : (K, n) array
        Responses to unit initial states.
    weights : (n + 1,) array
        Offset and initial state.
    """
    return with_state(forced, free, float(weights[0]), weights[1:])


def with_state(forced: FloatArray, free: FloatArray, offset: float, state: FloatArray) -> FloatArray:
    """Return what `with_initial` does, the offset and the initial state (n,) apart."""
    used = state != 0.0
    return np.asarray(forced + offset + free[:, used] @ state[used])


def bridged(u: FloatArray, before: float = 0.0) -> tuple[FloatArray, float]:
    """Return ``u`` (K,) with each entry that is not finite replaced by the last finite one, and its last entry.

    ``before`` is the entry before the first one.
    """
    finite = np.isfinite(u)
    if not finite.all():
        last = np.maximum.accumulate(np.where(finite, np.arange(u.size), -1))
        u = np.where(last >= 0, u[np.maximum(last, 0)], before)
    return u, float(u[-1]) if u.size else before
