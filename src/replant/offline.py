"""fit: a whole record at once, the batch reference of the online estimators."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from replant.assessment import Simulation, fit_percent, simulate
from replant.defaults import choose_filter
from replant.errors import InvalidArgumentError
from replant.filters import StateVariableFilter
from replant.least_squares import least_squares
from replant.preprocess import Preprocess, screen
from replant.regression import regressors
from replant.settings import AUTO, Request
from replant.structure import Structure
from replant.transfer_function import TransferFunction
from replant.validation import FloatArray, one_of, record


@dataclass(frozen=True, eq=False)
class FitResult:
    """What `fit` found.

    Attributes
    ----------
    structure : Structure
    dt : float
        Sampling time in s.
    filter : StateVariableFilter
        The filter used, chosen or given.
    preprocess : Preprocess
        Input map and working point used, as numbers.
    parameters : (P,) array
        In physical units, in the order of ``structure.names``.
    condition : float
        Condition number of the scaled regressors; infinite where the input does not excite every parameter.
    one_step : float
        Fit in percent of y predicted from past outputs, (8).
    simulation : Simulation
        The free run from the input alone, offset and initial state estimated.
    samples : int
        Samples used.
    rejected : dict
        Samples left out, by reason.
    """

    structure: Structure
    dt: float
    filter: StateVariableFilter
    preprocess: Preprocess
    parameters: FloatArray
    condition: float
    one_step: float
    simulation: Simulation
    samples: int
    rejected: dict[str, int]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order."""
        return self.structure.names

    @property
    def transfer_function(self) -> TransferFunction:
        """The estimate as G(s)."""
        return self.structure.transfer_function(self.parameters)


def fit(
    u: Any,
    y: Any,
    dt: float,
    structure: Structure,
    *,
    method: str = "least_squares",
    filter: StateVariableFilter | str = AUTO,  # noqa: A002 - the field's word
    preprocess: Preprocess = Preprocess(),  # noqa: B008 - frozen
) -> FitResult:
    r"""Fit G(s) to a whole record.

    Least squares minimises :math:`\sum_k (y(t_k) - \theta_\lambda^T \varphi_{uy}(t_k))^2`, the article's way to its
    Table 6.  Measurement noise biases it: the regressor holds the noisy output.

    Parameters
    ----------
    u, y : (K,) arrays
        Input and output; samples that are not finite are passed over.
    dt : float
        Sampling time in s.
    structure : Structure
    method : {"least_squares"}
    filter : StateVariableFilter or "auto"
        "auto" tries a range of cutoffs and keeps the one whose model simulates the record best.
    preprocess : Preprocess
        Input map and working point.

    Raises
    ------
    InvalidArgumentError
        If the record is too short for the parameters, or an argument cannot be used.

    Examples
    --------
    >>> true = TransferFunction([2.0], [1.0, 0.5])
    >>> u = np.where(np.arange(400) // 50 % 2 == 0, 1.0, -1.0)
    >>> print(fit(u, true.simulate(u, dt=0.1), dt=0.1, structure=Structure(poles=1)).transfer_function)
    2 / (s + 0.5)

    References
    ----------
    Bernat and Kolota (2023), section 4; Garnier and Wang (2008), "Identification of Continuous-time Models from
    Sampled Data", chapter 1.
    """
    one_of("method", method, ("least_squares",))
    dt = Request(structure, dt, filter=filter, preprocess=preprocess).dt
    u, y = record(u, y)
    accepted, rejected = screen(preprocess.map_input(u), y)
    samples = int(accepted.sum())
    if samples < structure.size + 1:
        raise InvalidArgumentError(
            f"the record has {samples} usable samples, fewer than the {structure.size + 1} that "
            f"{structure.size} parameters need: record more, or ask for fewer poles and zeros"
        )
    preprocess = preprocess.resolve(u, y)
    if not isinstance(filter, StateVariableFilter):
        filter = choose_filter(structure, dt, preprocess, u, y)  # noqa: A001
    y = np.where(accepted, y, np.nan)
    phi, target = regressors(structure, dt, filter, preprocess, u, y)
    solution = least_squares(phi, target)
    predicted = y - (target - phi @ solution.parameters)
    model = structure.transfer_function(solution.parameters)
    mapped = preprocess.map_input(u) - float(preprocess.input_offset)
    return FitResult(
        structure,
        dt,
        filter,
        preprocess,
        solution.parameters,
        solution.condition if solution.rank == structure.size else math.inf,
        fit_percent(y, predicted),
        simulate(model, np.where(accepted, mapped, np.nan), y, dt, input_hold=filter.input_hold),
        samples,
        rejected,
    )
