"""RMSProp: steps divided by the moving size of the gradient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from replant.arguments import (
    FloatArray,
    between,
    keep,
    positive,
)
from replant.optimizers.optimizer import Optimizer, rounded


@dataclass(frozen=True)
class RMSProp(Optimizer):
    r"""Root mean square propagation: :math:`\theta \leftarrow \theta - \alpha\, g / (\sqrt{v} + \epsilon)`.

    :math:`v \leftarrow \rho v + (1 - \rho) g^2`.

    Parameters
    ----------
    step_size : float
        :math:`\alpha`, in scaled parameters per update.
    rho : float
        Decay of the moving mean, in [0, 1).
    epsilon : float
        Keeps the division finite.

    References
    ----------
    Tieleman and Hinton (2012).

    Examples
    --------
    >>> RMSProp(step_size=1e-3).settings(0.1, np.ones(2))
    array([1.e-03, 9.e-01, 1.e-08])
    """

    step_size: float
    rho: float = 0.9
    epsilon: float = 1e-8
    code: ClassVar[int] = 4

    def __post_init__(self) -> None:
        keep(self, "step_size", positive)
        keep(self, "rho", between, 0.0, 1.0)
        keep(self, "epsilon", positive)

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a step size of ten over the updates to come, between 1e-4 and 1e-3."""
        return cls(step_size=rounded(min(max(10.0 / updates, 1e-4), 1e-3)))

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [alpha, rho, epsilon]."""
        return np.array([self.step_size, self.rho, self.epsilon])
