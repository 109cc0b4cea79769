"""The free run of a model with offset and initial state fitted to the measured output, and the fit in percent."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import FloatArray, vector
from replant.errors import InvalidArgumentError
from replant.model.transfer_function import TransferFunction
from replant.simulation.fitted_run import FittedRun


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
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the squares of tiny numbers are zero
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

    >>> g = TransferFunction([2.0], [1.0, 1.0])
    >>> u = np.repeat([0.0, 1.0, -1.0, 1.0], 10)
    >>> simulate(g, u, g.simulate(u, 0.1) + 5.0, 0.1).offset
    5.0...
    """
    run = FittedRun(model, dt, input_hold)
    output, known = run.take(u, y, t)
    if not (np.isfinite(output).all() and np.isfinite(known).any()):
        return Simulation(np.full(u.size, np.nan), 0.0, -math.inf)
    return Simulation(output, run.offset, fit_percent(known, output))
