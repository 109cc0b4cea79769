"""NAdam: Adam with Nesterov's look-ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from replant.optimizers.adam import Adam


@dataclass(frozen=True)
class NAdam(Adam):
    r"""Adam whose step already looks along the next momentum.

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
