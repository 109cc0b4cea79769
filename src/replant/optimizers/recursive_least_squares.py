"""RecursiveLeastSquares: each sample solves the least-squares problem of all samples so far."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from replant.arguments import (
    FloatArray,
    between,
    keep,
    positive,
)
from replant.errors import InvalidArgumentError
from replant.optimizers.optimizer import Optimizer


@dataclass(frozen=True)
class RecursiveLeastSquares(Optimizer):
    r"""Recursive least squares, with instruments recursive instrumental variables, on a factored covariance.

    .. math:: K = P\zeta / (\mu + \zeta^T P \zeta), \quad \theta \leftarrow \theta + K (z - \varphi^T\theta), \quad
              P \leftarrow (P - K \zeta^T P) / \mu

    P is kept as U D U', so it stays symmetric and positive definite however long the stream is.

    Parameters
    ----------
    forgetting_factor : float
        :math:`\mu` in (0, 1]; 1 remembers everything.
    time_constant : float, optional
        The memory in s instead of a factor: :math:`\mu = e^{-dt / T}`.
    initial_covariance : float
        Diagonal of P before the first sample, in scaled parameters; with instruments the start-up gives P instead.
        It also bounds how far forgetting can let P grow while nothing comes in.

    Raises
    ------
    InvalidArgumentError
        If both a factor and a time constant are given.

    References
    ----------
    Bierman (1977), "Factorization Methods for Discrete Sequential Estimation", chapter V; Young (2011), chapter 8.

    Examples
    --------
    >>> RecursiveLeastSquares(time_constant=10.0).settings(0.1, np.ones(2)).round(4)
    array([0.99])
    """

    forgetting_factor: float = 1.0
    time_constant: float | None = None
    initial_covariance: float = 1e6
    code: ClassVar[int] = 8
    keeps_covariance: ClassVar[bool] = True
    keeps_colour: ClassVar[bool] = True

    def __post_init__(self) -> None:
        keep(self, "forgetting_factor", positive)
        keep(self, "forgetting_factor", between, 0.0, 1.0, closed="both")
        keep(self, "initial_covariance", positive)
        if self.time_constant is not None:
            keep(self, "time_constant", positive)
            if self.forgetting_factor != 1.0:
                raise InvalidArgumentError("give a forgetting_factor or a time_constant, not both")

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return the one that remembers everything."""
        return cls()

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [mu]."""
        return np.array([self.forgetting_factor if self.time_constant is None else math.exp(-dt / self.time_constant)])

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return U and D of the initial covariance, which bounds D later, and one for alpha."""
        diagonal = self.initial_covariance
        return {"U": np.eye(size).ravel(), "D": diagonal, "caps": diagonal, "alpha": 1.0}
