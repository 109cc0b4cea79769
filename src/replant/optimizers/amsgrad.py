"""AMSGrad: Adam with a step that never grows, the article's Algorithm 2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from replant.optimizers.adam import Adam


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
