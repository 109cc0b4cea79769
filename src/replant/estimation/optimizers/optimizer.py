"""The base class of all optimizers, experience replay, and the optimizers that keep a covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np

from replant.errors import InvalidArgumentError
from replant.numerics.arguments import (
    FloatArray,
    between,
    finite,
    iterable,
    keep,
    not_negative,
    numbers,
    positive,
    whole,
)

LARGEST_BATCH = 100_000  # most updates a sample: they take some milliseconds and cannot be interrupted [count]


@dataclass(frozen=True)
class Replay:
    """Experience replay: each new sample is learned together with samples drawn from a buffer.

    A batch is ``batch_size - 1`` rows drawn uniformly, with replacement, from the filled part of the buffer (including
    the new sample), and then the new sample itself, with one update a row.

    Parameters
    ----------
    capacity : int
        Samples kept; the newest replaces the oldest once the buffer is full.
    batch_size : int
        Updates a sample, up to 100000.
    warmup : int
        Batches begin once the buffer holds more than this many samples, or is full; before that, one update a sample.
    seed : int
        Seed of the random stream, 0 or more; the stream is part of the identifier's state.

    Notes
    -----
    Algorithm 3 as printed sets ``current_buffer_size`` from ``buffer_index``, which returns to zero when the buffer
    wraps: from then on only the newest few samples could be drawn until the buffer is full again.  Here a full buffer
    stays full.  The article prints a batch of 20; its tables are reproduced with 10 (see `replant.paper`).

    References
    ----------
    Bernat and Kolota (2023), section 2.2 and Algorithm 3.

    Examples
    --------
    >>> Replay(capacity=5000, batch_size=20).warmup
    20
    """

    capacity: int = 20_000
    batch_size: int = 20
    warmup: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        keep(self, "capacity", whole, 1, 2**31 - 1)
        keep(self, "batch_size", whole, 1, LARGEST_BATCH)
        keep(self, "warmup", whole, 0, 2**63 - 1)
        keep(self, "seed", whole, 0, 2**63 - 1)


def rounded(value: float) -> float:
    """Return ``value`` rounded to three digits, so that a user can type it again."""
    return float(f"{value:.3g}")


class Optimizer:
    """Base of the optimizers, which are frozen dataclasses of their settings; the state is in the identifier."""

    # code of its loop in `replant.kernels.optimizers`, where its memory is declared.  It is stored in checkpoints, so
    # it must be a number that no other optimizer has or had
    code: ClassVar[int]
    # whether its memory begins with the factors U and D of a covariance and ends with alpha; the loop is then in
    # `replant.kernels.optimizers.covariance`, else in `replant.kernels.optimizers.gradient`
    keeps_covariance: ClassVar[bool] = False
    # whether power and colour of the residual are kept as well, with the first of its settings as forgetting factor
    keeps_colour: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for each in fields(self):  # type: ignore[arg-type]
            if each.name in CHECKS:
                keep(self, each.name, *CHECKS[each.name])

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return this optimizer for auto-scaled signals, sampling time ``dt`` and about ``updates`` updates to come.

        With more updates each step can be smaller: the estimate still converges, with less noise.
        """
        raise NotImplementedError

    def check(self, size: int) -> None:
        """Raise InvalidArgumentError if these settings do not fit ``size`` parameters."""
        return

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return the kernel's settings for the sampling time ``dt`` in s; ``unit`` (T,): physical over scaled."""
        return np.array([getattr(self, each.name) for each in fields(self)])  # type: ignore[arg-type]

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return the blocks of the memory that are not zero before the first sample, for ``size`` parameters."""
        return {}

    def memory(self, size: int) -> FloatArray:
        """Return the kernel's memory before the first sample, for ``size`` parameters."""
        from replant.kernels.optimizers import covariance, gradient

        declared = covariance.MEMORY if self.keeps_covariance else gradient.MEMORY
        return declared[self.code].filled(size, **self.begins_with(size))


@dataclass(frozen=True)
class RecursiveLeastSquares(Optimizer):
    r"""Recursive least squares (with instruments: recursive instrumental variables), on a factored covariance.

    .. math:: K = P\zeta / (\mu + \zeta^T P \zeta), \quad \theta \leftarrow \theta + K (z - \varphi^T\theta), \quad
              P \leftarrow (P - K \zeta^T P) / \mu

    P is kept as U D U', so it stays symmetric and positive definite for any length of the stream.

    Parameters
    ----------
    forgetting_factor : float
        :math:`\mu` in (0, 1]; 1 remembers everything.
    time_constant : float, optional
        The memory in s instead of a factor: :math:`\mu = e^{-dt / T}`.
    initial_covariance : float
        Diagonal of P before the first sample, in scaled parameters; with instruments the start-up gives P instead.
        It also bounds the growth of P by forgetting without excitation.

    Raises
    ------
    InvalidArgumentError
        If both a factor and a time constant are given.

    References
    ----------
    Bierman (1977), "Factorization Methods for Discrete Sequential Estimation", chapter V; Young (2011), chapter 8.

    Examples
    --------
    >>> RecursiveLeastSquares(time_constant=10.0).settings(0.1, np.ones(2)).round(4)
    array([0.99])
    """

    forgetting_factor: float = 1.0
    time_constant: float | None = None
    initial_covariance: float = 1e6
    code: ClassVar[int] = 8
    keeps_covariance: ClassVar[bool] = True
    keeps_colour: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        keep(self, "forgetting_factor", between, 0.0, 1.0, closed="both")
        if self.time_constant is not None:
            keep(self, "time_constant", positive)
            if self.forgetting_factor != 1.0:
                raise InvalidArgumentError("give a forgetting_factor or a time_constant, not both")

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return the optimizer without forgetting."""
        return cls()

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [mu]."""
        return np.array([self.forgetting_factor if self.time_constant is None else math.exp(-dt / self.time_constant)])

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return U and D of the initial covariance, the same bounds of D, and alpha = 1."""
        diagonal = self.initial_covariance
        return {"U": np.eye(size).ravel(), "D": diagonal, "caps": diagonal, "alpha": 1.0}


@dataclass(frozen=True)
class KalmanTracking(Optimizer):
    r"""Track parameters that change, each at its own rate.

    .. math:: \theta_{k+1} = \theta_k + w_k, \quad \mathrm{var}\,w_k = q\, dt

    The variance of the residual is estimated as well, so that only q has to be given.

    Parameters
    ----------
    process_noise : float or sequence of float
        Variance q that a parameter gains in a second: one number for each, in the order of ``Structure.names`` and in
        the squared unit of the parameter, or one for all scaled parameters.  A parameter with a random walk by d within
        T seconds has q = d^2 / T; one that moves steadily through a range d within T seconds, q = (d/4)^2 / T.
    noise_time_constant : float
        Memory of the residual's variance in s.
    initial_covariance : float
        As in `RecursiveLeastSquares`.

    References
    ----------
    Young (2011), "Recursive Estimation and Time-Series Analysis", chapter 4; the time update is Thornton's, in
    Bierman (1977), chapter VII.

    Examples
    --------
    >>> KalmanTracking([0.1, 3.0, 0.003]).settings(0.01, np.ones(3))
    array([0.1  , 0.1  , 3.   , 0.003])
    """

    process_noise: float | Sequence[float]
    noise_time_constant: float = 10.0
    initial_covariance: float = 1e6
    code: ClassVar[int] = 9
    keeps_covariance: ClassVar[bool] = True

    @classmethod
    def suggested(cls, dt: float, updates: int) -> Self:
        """Return a random walk by a tenth of a scaled parameter over the updates to come."""
        return cls(process_noise=rounded(0.1**2 / (updates * dt)))

    def check(self, size: int) -> None:
        """Raise InvalidArgumentError for a sequence of another length than ``size``."""
        if isinstance(self.process_noise, Sequence) and len(self.process_noise) != size:
            given = len(self.process_noise)
            raise InvalidArgumentError(f"process_noise must have {size} entries, one for each parameter, got {given}")

    def settings(self, dt: float, unit: FloatArray) -> FloatArray:
        """Return [1 / time constant of the noise variance, q of each scaled entry]; q of nuisances is 0."""
        noise = np.array(self.process_noise)
        scaled = np.zeros(unit.size)
        if noise.ndim == 0:
            scaled[:] = noise
        else:
            scaled[: noise.size] = noise / unit[: noise.size] ** 2
        return np.concatenate([[1.0 / self.noise_time_constant], scaled])

    def begins_with(self, size: int) -> dict[str, Any]:
        """Return U and D of the initial covariance; the residual's variance and alpha are 1."""
        return {"U": np.eye(size).ravel(), "D": self.initial_covariance, "noise": 1.0, "alpha": 1.0}


def _process_noise(name: str, value: float | Sequence[float]) -> float | tuple[float, ...]:
    noise = numbers(name, value) if iterable(value) else finite(name, value)
    least = noise if isinstance(noise, float) else min(noise)
    if least < 0.0:
        raise InvalidArgumentError(f"{name} must be at least 0, got {least:g}")
    return noise


#: The check of each setting of the optimizers, by its name.
CHECKS: dict[str, tuple[Any, ...]] = {
    **dict.fromkeys(("gain", "step_size", "epsilon", "forgetting_factor"), (positive,)),
    **dict.fromkeys(("noise_time_constant", "initial_covariance"), (positive,)),
    **dict.fromkeys(("rho", "beta1", "beta2"), (between, 0.0, 1.0)),
    "forgetting_rate": (not_negative,),
    "process_noise": (_process_noise,),
}
