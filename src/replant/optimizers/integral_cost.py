"""IntegralCost: gradient descent on the cost of all past samples, the article's equations (18)-(19)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from replant.arguments import (
    FloatArray,
    keep,
    not_negative,
    positive,
)
from replant.optimizers.optimizer import Optimizer, rounded


@dataclass(frozen=True)
class IntegralCost(Optimizer):
    r"""Gradient descent on the exponentially forgotten integral of the normalised squared error.

    .. math:: \hat\theta \leftarrow \hat\theta - T_p \Gamma (R \hat\theta + Q), \quad
              \dot R = -\beta R + \varphi\varphi^T / m^2, \quad \dot Q = -\beta Q - y \varphi / m^2

    Parameters
    ----------
    gain : float
        :math:`\Gamma`, in 1/s^2: the integral carries one more second than the gradient.
    forgetting_rate : float
        :math:`\beta` in 1/s, at least 0; its inverse is the memory in s.

    References
    ----------
    Bernat and Kolota (2023), (18)-(19), discretised by Euler's forward method as there.

    Examples
    --------
    >>> IntegralCost(gain=10.0, forgetting_rate=0.1).settings(1e-3, np.ones(2))
    array([1.e-03, 1.e+01, 1.e-01])
    """

    gain: float
    forgetting_rate: float
    code: ClassVar[int] = 7

    def __post_init__(self) -> None:
        keep(self, "gain", positive)
        keep(self, "forgetting_rate", not_negative)

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a memory of a tenth of the updates to come, and half the gain at which it would be stable no more.

        R never exceeds 1/beta in any direction, so Tp Gamma / beta < 2 is safe.
        """
        rate = min(10.0 / (updates * dt), 1.0 / dt)
        return cls(gain=rounded(rate / dt), forgetting_rate=rounded(rate))

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [Tp, Gamma, beta]."""
        return np.array([dt, self.gain, self.forgetting_rate])
