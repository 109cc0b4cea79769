"""Gradient optimizers: the article's equations (17) to (19), Algorithms 1 and 2, and related ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from replant.estimation.optimizers.optimizer import Optimizer, rounded
from replant.numerics.arguments import FloatArray


@dataclass(frozen=True)
class Gradient(Optimizer):
    r"""Gradient descent on the instantaneous cost: :math:`\Delta = T_p \gamma \epsilon_I \varphi`.

    With normalisation it is stable for :math:`T_p \gamma < 2` with any signals.

    Parameters
    ----------
    gain : float
        :math:`\gamma`, in 1/s, as the sampling time is part of the step.

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

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return Tp gamma = 1000 over the updates to come, between 0.01 and 0.5; 2 is the limit of stability."""
        return cls(gain=rounded(min(max(1000.0 / updates, 0.01), 0.5) / dt))

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [Tp gamma]."""
        return np.array([dt * self.gain])


@dataclass(frozen=True)
class IntegralCost(Optimizer):
    r"""Gradient descent on the exponentially forgotten integral of the normalised squared error.

    .. math:: \hat\theta \leftarrow \hat\theta - T_p \Gamma (R \hat\theta + Q), \quad
              \dot R = -\beta R + \varphi\varphi^T / m^2, \quad \dot Q = -\beta Q - y \varphi / m^2

    Parameters
    ----------
    gain : float
        :math:`\Gamma`, in 1/s^2, as the integral has one more unit of s than the gradient.
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

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a memory of a tenth of the updates to come, and half of the largest stable gain.

        R never exceeds 1/beta in any direction, so Tp Gamma / beta < 2 is safe.
        """
        rate = min(10.0 / (updates * dt), 1.0 / dt)
        return cls(gain=rounded(rate / dt), forgetting_rate=rounded(rate))

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [Tp, Gamma, beta]."""
        return np.array([dt, self.gain, self.forgetting_rate])


@dataclass(frozen=True)
class AdaGrad(Optimizer):
    r"""Adaptive gradient: :math:`\theta \leftarrow \theta - \alpha\, g / (\sqrt{\sum g^2} + \epsilon)`.

    Its steps decrease with the square root of time: for plants that do not change.

    Parameters
    ----------
    step_size : float
        :math:`\alpha`, in scaled parameters.
    epsilon : float
        Small constant that keeps the division finite.

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

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a step size of 0.05, as the algorithm reduces its steps itself."""
        return cls(step_size=0.05)


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
        Small constant that keeps the division finite.

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

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a step size of ten over the updates to come, between 1e-4 and 1e-3."""
        return cls(step_size=rounded(min(max(10.0 / updates, 1e-4), 1e-3)))


@dataclass(frozen=True)
class AdaDelta(RMSProp):
    r"""RMSProp with steps scaled by the root mean square of its past steps.

    .. math:: \theta \leftarrow \theta - \alpha \frac{\sqrt{E[\Delta^2] + \epsilon}}{\sqrt{E[g^2] + \epsilon}}\, g

    Parameters
    ----------
    step_size : float
        :math:`\alpha`, a factor; 1 as published.
    rho : float
        Decay of both moving means, in [0, 1).
    epsilon : float
        Determines the size of the first steps.

    References
    ----------
    Zeiler (2012).

    Examples
    --------
    >>> AdaDelta().rho
    0.95
    """

    step_size: float = 1.0
    rho: float = 0.95
    epsilon: float = 1e-6
    code: ClassVar[int] = 6

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return the published constants."""
        return cls()


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
        Small constant that keeps the division finite.

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

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a step size of ten over the updates to come, between 1e-4 and 1e-3."""
        return cls(step_size=rounded(min(max(10.0 / updates, 1e-4), 1e-3)))

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return the powers of beta1 and beta2 that correct the bias of the moments: one."""
        return {"power1": 1.0, "power2": 1.0}


@dataclass(frozen=True)
class AMSGrad(Adam):
    r"""Adam that divides by the largest second moment so far, without bias correction.

    .. math:: \hat v \leftarrow \max(\hat v, v), \quad
              \theta \leftarrow \theta - \alpha\, m / (\sqrt{\hat v} + \epsilon)

    Parameters
    ----------
    step_size, beta1, beta2, epsilon : float
        As in `Adam`.

    References
    ----------
    Reddi, Kale and Kumar (2018); Bernat and Kolota (2023), Algorithm 2.

    Examples
    --------
    >>> import numpy as np
    >>> AMSGrad(step_size=5e-4).settings(1e-3, np.ones(2))
    array([5.00e-04, 9.00e-01, 9.99e-01, 1.00e-08])
    """

    code: ClassVar[int] = 2

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return nothing: the bias of the moments is not corrected."""
        return {}


@dataclass(frozen=True)
class NAdam(Adam):
    r"""Adam with Nesterov momentum: the step includes the next momentum.

    .. math:: \theta \leftarrow \theta - \frac{\alpha}{\sqrt{\hat v} + \epsilon}
              \Big( \frac{\beta_1 m}{1 - \beta_1^{t+1}} + \frac{(1 - \beta_1) g}{1 - \beta_1^t} \Big)

    Parameters
    ----------
    step_size, beta1, beta2, epsilon : float
        As in `Adam`.

    References
    ----------
    Dozat (2016), with a constant momentum schedule.

    Examples
    --------
    >>> NAdam(step_size=1e-3).beta1
    0.9
    """

    code: ClassVar[int] = 5
