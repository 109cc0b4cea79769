"""Adam: adaptive moment estimation, the article's Algorithm 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from replant.arguments import (
    FloatArray,
    between,
    keep,
    positive,
)
from replant.optimizers.optimizer import Optimizer, rounded


@dataclass(frozen=True)
class Adam(Optimizer):
    r"""Steps of nearly equal size in every scaled parameter, from moving means of gradient and squared gradient.

    .. math:: \theta \leftarrow \theta - \alpha\, \hat m / (\sqrt{\hat v} + \epsilon)

    Parameters
    ----------
    step_size : float
        :math:`\alpha`, in scaled parameters per update.
    beta1, beta2 : float
        Decay of the first and the second moment, in [0, 1).
    epsilon : float
        Keeps the division finite.

    References
    ----------
    Kingma and Ba (2015); Bernat and Kolota (2023), Algorithm 1.

    Examples
    --------
    >>> Adam(step_size=1e-3).beta2
    0.999
    """

    step_size: float
    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-8
    code: ClassVar[int] = 1

    def __post_init__(self) -> None:
        keep(self, "step_size", positive)
        keep(self, "beta1", between, 0.0, 1.0)
        keep(self, "beta2", between, 0.0, 1.0)
        keep(self, "epsilon", positive)

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a step size of ten over the updates to come, between 1e-4 and 1e-3."""
        return cls(step_size=rounded(min(max(10.0 / updates, 1e-4), 1e-3)))

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [alpha, beta1, beta2, epsilon]."""
        return np.array([self.step_size, self.beta1, self.beta2, self.epsilon])

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return the powers of beta1 and beta2 that correct the bias of the moments: one."""
        return {"power1": 1.0, "power2": 1.0}
