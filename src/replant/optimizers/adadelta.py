"""AdaDelta: steps in the parameter's own unit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Self

from replant.optimizers.rmsprop import RMSProp


@dataclass(frozen=True)
class AdaDelta(RMSProp):
    r"""RMSProp whose step is measured by the size of its past steps.

    .. math:: \theta \leftarrow \theta - \alpha \frac{\sqrt{E[\Delta^2] + \epsilon}}{\sqrt{E[g^2] + \epsilon}}\, g

    Parameters
    ----------
    step_size : float
        :math:`\alpha`, a factor; 1 as published.
    rho : float
        Decay of both moving means, in [0, 1).
    epsilon : float
        Sets the size of the first steps.

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
