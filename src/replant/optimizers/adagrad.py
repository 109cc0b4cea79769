"""AdaGrad: steps that shrink with the sum of squared gradients."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from replant.arguments import FloatArray, keep, positive
from replant.optimizers.optimizer import Optimizer


@dataclass(frozen=True)
class AdaGrad(Optimizer):
    r"""Adaptive gradient: :math:`\theta \leftarrow \theta - \alpha\, g / (\sqrt{\sum g^2} + \epsilon)`.

    Its step falls like one over the square root of time: for plants that do not change.

    Parameters
    ----------
    step_size : float
        :math:`\alpha`, in scaled parameters.
    epsilon : float
        Keeps the division finite.

    References
    ----------
    Duchi, Hazan and Singer (2011).

    Examples
    --------
    >>> AdaGrad(step_size=0.1).memory(2)
    array([0., 0.])
    """

    step_size: float
    epsilon: float = 1e-8
    code: ClassVar[int] = 3

    def __post_init__(self) -> None:
        keep(self, "step_size", positive)
        keep(self, "epsilon", positive)

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a step size of 0.05: the algorithm shrinks it by itself."""
        return cls(step_size=0.05)

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [alpha, epsilon]."""
        return np.array([self.step_size, self.epsilon])
