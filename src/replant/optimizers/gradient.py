"""Gradient: gradient descent, the article's equation (17)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from replant.arguments import FloatArray, keep, positive
from replant.optimizers.optimizer import Optimizer, rounded


@dataclass(frozen=True)
class Gradient(Optimizer):
    r"""Gradient descent on the instantaneous cost: :math:`\Delta = T_p \gamma \epsilon_I \varphi`.

    With normalisation it is stable for :math:`T_p \gamma < 2` whatever the signals are.

    Parameters
    ----------
    gain : float
        :math:`\gamma`, in 1/s: the sampling time is part of the step.

    References
    ----------
    Bernat and Kolota (2023), (15)-(17).

    Examples
    --------
    >>> Gradient(gain=2.0).settings(1e-3, np.ones(2))
    array([0.002])
    """

    gain: float
    code: ClassVar[int] = 0

    def __post_init__(self) -> None:
        keep(self, "gain", positive)

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return Tp gamma = 1000 over the updates to come, between 0.01 and 0.5; 2 is the limit of stability."""
        return cls(gain=rounded(min(max(1000.0 / updates, 0.01), 0.5) / dt))

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [Tp gamma]."""
        return np.array([dt * self.gain])
