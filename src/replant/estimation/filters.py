"""The filters that a user can choose; their loops are in `kernels.filters`.

To add one: write a subclass of `Filter` and add it to `FILTERS` below.  Settings, checkpoints and messages about wrong
arguments use that list; all other code uses the interface of `Filter`.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from replant.errors import InvalidArgumentError
from replant.model import state_space
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, between, keep, numbers, one_of, positive, whole
from replant.numerics.limits import dead_time, duration
from replant.numerics.linear_algebra import roots

# a pole there has a memory of ten thousand samples
NEAREST_AXIS = 1e-4  # least distance of a fixed filter's pole from the imaginary axis [1 / sampling time]


@dataclass(frozen=True, eq=False)
class DiscreteFilter:
    """The filters (7) for one sampling time, in scaled states (see `replant.model.state_space`)."""

    transition: FloatArray  # (n, n)
    output_taps: FloatArray  # (2, n): for y[k-1] and y[k]
    input_taps: FloatArray  # (3, n): for u[k-lag-2], u[k-lag-1] and u[k-lag]
    characteristic: FloatArray  # (n,), as scale: see `replant.model.state_space.Companion`
    scale: FloatArray
    lag: int  # whole samples of dead time


class Filter:
    """The interface of a filter that the rest of the package uses."""

    input_hold: str  # "zoh" or "foh": the input between samples
    # whether it is made from the estimate, which needs a start-up, and renewed as the estimate moves
    follows_estimate: ClassVar[bool] = False

    @property
    def regular_only(self) -> bool:
        """Whether it needs a regular clock."""
        return False

    @property
    def fixed(self) -> StateVariableFilter | None:
        """The filter itself if it is fixed; None if it follows the estimate."""
        return None

    def fixed_at(self, denominator: FloatArray, dt: float) -> StateVariableFilter:
        """Return the fixed filter that equals this one for an estimate with this monic ``denominator`` (n + 1,)."""
        raise NotImplementedError

    def check(self, structure: Structure) -> None:
        """Raise InvalidArgumentError if this filter cannot be used with this structure."""
        return


@dataclass(frozen=True)
class StateVariableFilter(Filter):
    r"""The filter :math:`\Lambda(s)` of (2): signals pass :math:`s^i/\Lambda(s)`, so nothing is differentiated.

    Parameters
    ----------
    cutoff : float, optional
        :math:`\lambda` in rad/s, for :math:`\Lambda(s) = (s + \lambda)^n`.  Choose it a little above the fastest pole
        of interest: a much lower cutoff suppresses that pole, a much higher one passes the noise.
    denominator : sequence of float, optional
        :math:`\Lambda(s)` itself, monic, descending powers, instead of a cutoff.
    method : {"exact", "gbt"}
        "exact" solves the filters between samples without error: u as given by ``input_hold``, y linear.  "gbt" is the
        article's generalised bilinear transform, strictly causal as in (7): half a sample late.
    input_hold : {"zoh", "foh"}
        Input between samples: held, as by a D/A converter, or linear.  For "exact".
    alpha : float
        Parameter of the generalised bilinear transform: 0 forward Euler, 0.5 Tustin, 1 backward Euler.  For "gbt".

    Notes
    -----
    The generalised bilinear transform with alpha < 0.5 is unstable if lambda dt > 2 / (1 - 2 alpha): `discretize` then
    raises an error.  With alpha = 0.5 it rings if lambda dt > 2: `discretize` then warns.

    References
    ----------
    Bernat and Kolota (2023), (2)-(7) and Appendix A.

    Examples
    --------
    >>> StateVariableFilter(cutoff=5.0).polynomial(2)
    array([ 1., 10., 25.])
    """

    cutoff: float | None = None
    denominator: Sequence[float] | None = None
    method: str = "exact"
    input_hold: str = "zoh"
    alpha: float = 0.5

    def __post_init__(self) -> None:
        if (self.cutoff is None) == (self.denominator is None):
            raise InvalidArgumentError("a filter needs either a cutoff [rad/s] or a denominator, and not both")
        if self.cutoff is not None:
            keep(self, "cutoff", positive)
        if self.denominator is not None:
            keep(self, "denominator", _denominator)
        keep(self, "method", one_of, ("exact", "gbt"))
        keep(self, "input_hold", one_of, ("zoh", "foh"))
        keep(self, "alpha", between, 0.0, 1.0, closed="both")

    @property
    def regular_only(self) -> bool:
        """Whether it needs a regular clock, as the article's filter does."""
        return self.method == "gbt"

    @property
    def fixed(self) -> StateVariableFilter:
        """The filter itself."""
        return self

    def fixed_at(self, denominator: FloatArray, dt: float) -> StateVariableFilter:
        """Return this filter, for any estimate."""
        return self

    def check(self, structure: Structure) -> None:
        """Raise InvalidArgumentError if this filter cannot be used with this structure."""
        self.polynomial(structure.poles)
        if self.method == "gbt" and structure.is_biproper:
            raise InvalidArgumentError("the gbt filter is strictly causal: as many zeros as poles need method='exact'")

    def polynomial(self, poles: int) -> FloatArray:
        """Return Lambda(s) for ``poles`` poles: (poles + 1,), monic, descending powers.

        Parameters
        ----------
        poles : int
            Number of poles.

        Raises
        ------
        InvalidArgumentError
            For a denominator of another order, or a cutoff whose powers overflow.
        """
        poles = whole("poles", poles, 1, Structure.MOST_POLES)
        if self.denominator is not None:
            if len(self.denominator) != poles + 1:
                raise InvalidArgumentError(
                    f"denominator must have {poles + 1} coefficients for {poles} poles, got {len(self.denominator)}"
                )
            return np.array(self.denominator)
        assert self.cutoff is not None
        with np.errstate(over="ignore", invalid="ignore"):
            polynomial = np.asarray(np.poly(np.full(poles, -self.cutoff)), np.float64)
        if not np.isfinite(polynomial).all():
            raise InvalidArgumentError(f"cutoff must be smaller: {self.cutoff:g} overflows with {poles} poles")
        return polynomial

    def discretize(self, poles: int, dt: float, delay: float = 0.0) -> DiscreteFilter:
        """Return the difference equations (7).

        Parameters
        ----------
        poles : int
        dt : float
            Sampling time in s.
        delay : float
            Dead time in s.

        Raises
        ------
        InvalidArgumentError
            For a bilinear filter that is unstable at this sampling time.
        """
        polynomial, dt, delay = self.polynomial(poles), duration("dt", dt), dead_time("delay", delay)
        model = state_space.companion(polynomial)
        lag, fraction = state_space.split_delay(delay, dt)
        if self.method == "exact":
            transition, before, after = state_space.exact(model.matrix, model.column, dt, "foh")
            output_taps = np.stack([before, after])
            input_taps = state_space.input_taps(model.matrix, model.column, dt, self.input_hold, fraction)
        else:
            transition, column = state_space.bilinear(model.matrix, model.column, dt, self.alpha)
            self._check_poles(dt)
            output_taps = np.stack([column, np.zeros_like(column)])
            input_taps = np.stack([fraction * column, (1 - fraction) * column, np.zeros_like(column)])
        return DiscreteFilter(transition, output_taps, input_taps, model.characteristic, model.scale, lag)

    def _check_poles(self, dt: float) -> None:
        # mapped from the continuous poles: computed eigenvalues of a tenfold pole scatter by a few percent
        s = dt * roots(np.asarray(self.polynomial(1) if self.denominator is None else self.denominator))
        poles = (1 + (1 - self.alpha) * s) / (1 - self.alpha * s)
        if np.abs(poles).max() >= 1.0:
            limit = "" if self.alpha >= 0.5 else f"; with alpha {self.alpha:g} keep cutoff * dt below 2/(1 - 2 alpha)"
            raise InvalidArgumentError(f"the gbt filter is unstable at dt = {dt:g} s{limit}, or use method='exact'")
        if poles.real.min() < 0:
            warnings.warn(
                f"the gbt filter rings at dt = {dt:g} s (cutoff * dt > 2): lower the cutoff or use method='exact'",
                stacklevel=3,
            )


@dataclass(frozen=True)
class RefinedFilter(Filter):
    r"""The filter 1/A(s), made of the estimate and renewed while the plant runs: there is nothing to choose.

    With this filter the regression is optimal for white output noise, and has no discretisation error.  It needs
    instruments, and a start-up for the first A.

    Parameters
    ----------
    input_hold : {"zoh", "foh"}
        Input between samples: held, or linear.

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
        """Return the filter 1/A of a model as a fixed one; unstable poles are reflected, others moved off the axis."""
        poles = roots(denominator)
        poles = np.minimum(-np.abs(poles.real), -NEAREST_AXIS / dt) + 1j * poles.imag
        return StateVariableFilter(denominator=tuple(np.poly(poles).real.tolist()), input_hold=self.input_hold)


#: Every filter.
FILTERS: tuple[type[Filter], ...] = (StateVariableFilter, RefinedFilter)


def _denominator(name: str, value: Sequence[float]) -> tuple[float, ...]:
    """Return a monic polynomial with all roots left of the axis; its order is checked before they are computed."""
    polynomial = numbers(name, value)
    if len(polynomial) < 2 or polynomial[0] != 1.0:
        raise InvalidArgumentError(f"{name} must be monic, of order 1 or more, got {list(polynomial[:12])}")
    if len(polynomial) > Structure.MOST_POLES + 1:
        raise InvalidArgumentError(f"{name} must be of order {Structure.MOST_POLES} at most, got {len(polynomial) - 1}")
    if not roots(np.array(polynomial)).real.max() < 0.0:
        raise InvalidArgumentError(f"{name} must have all roots left of the axis: {list(polynomial)}")
    return polynomial
