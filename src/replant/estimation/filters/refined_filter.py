"""RefinedFilter: 1/A(s) of the estimate, which the kernels renew while the plant runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from replant.estimation.filters.state_variable import Filter, StateVariableFilter
from replant.numerics.arguments import FloatArray, keep, one_of
from replant.numerics.linear_algebra import roots

# its memory is then ten thousand samples
NEAREST_AXIS = 1e-4  # least distance of a fixed filter's pole from the imaginary axis [1 / sampling time]


@dataclass(frozen=True)
class RefinedFilter(Filter):
    r"""The filter 1/A(s) of the estimate itself, which follows it while the plant runs: nothing is to be chosen.

    It is the filter with which the regression is optimal when the output noise is white, and with which it has no
    error of discretisation.  It needs instruments, and a start-up from which the first A comes.

    Parameters
    ----------
    input_hold : {"zoh", "foh"}
        What u does between samples.

    References
    ----------
    Young (2011), "Recursive Estimation and Time-Series Analysis", chapter 8; `rsrivc` of the CONTSID toolbox.

    Examples
    --------
    >>> RefinedFilter()
    RefinedFilter(input_hold='zoh')
    """

    input_hold: str = "zoh"
    follows_estimate: ClassVar[bool] = True

    def __post_init__(self) -> None:
        keep(self, "input_hold", one_of, ("zoh", "foh"))

    def fixed_at(self, denominator: FloatArray, dt: float) -> StateVariableFilter:
        """Return the filter 1/A of a model as a fixed one; poles on or right of the axis are mirrored or moved off it.

        Parameters
        ----------
        denominator : (n + 1,) array
            A(s), monic.
        dt : float
            Sampling time in s; a pole is kept at least `NEAREST_AXIS` / dt away from the axis.
        """
        poles = roots(denominator)
        poles = np.minimum(-np.abs(poles.real), -NEAREST_AXIS / dt) + 1j * poles.imag
        return StateVariableFilter(denominator=tuple(np.poly(poles).real.tolist()), input_hold=self.input_hold)
