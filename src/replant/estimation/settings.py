"""Settings of an identifier: as requested (`Request`), as resolved by `online.startup` (`Settings`); scaling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from replant.errors import InvalidArgumentError, shown
from replant.estimation.filters import FILTERS, Filter, RefinedFilter
from replant.estimation.optimizers import OPTIMIZERS, Optimizer
from replant.estimation.optimizers.optimizer import Replay
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray, instance, keep, numbers, positive, truth, whole
from replant.numerics.limits import duration

AUTO = "auto"
LONGEST_DELAY = 1_000_000  # longest dead time, as the inputs of the whole dead time are kept [sampling times]
STORED = 30_000
"""Raw samples stored: a record up to this length is solved as a whole at its end [samples].
Origin: 1.2 MB.  With 10,000, the final estimates of 15 of 496 random records of 3,000 to 30,000 samples were more than
5 points of fit below those of `fit`; all 15 records were longer than 10,000.
Sensitivity: not measured.
"""
DEFAULT_OPTIMIZER = "recursive-least-squares"
NO_USE_OF_REFERENCE = (
    "only the refined filter with recursive least squares uses a reference: give no r, or leave filter, optimizer "
    "and instruments at their defaults"
)


@dataclass(frozen=True)
class Scaling:
    r"""Scales that output and regressor are divided by, so that all scaled parameters are of similar size.

    .. math:: y = y_p / \sigma_y, \quad \varphi_i = \varphi_{uy,i} / \sigma_i, \quad
              \hat\theta_i = \hat\theta_{i,physical}\, \sigma_i / \sigma_y

    Parameters
    ----------
    output : float
        :math:`\sigma_y`, in the unit of y.
    regressor : sequence of float
        :math:`\sigma_i`, in the order of ``Structure.names``: of the filtered derivatives of y, then of u, then of the
        bias (its unscaled entry is 1: the article's "0.1" is a sigma of 10).

    References
    ----------
    Bernat and Kolota (2023), (10)-(12).

    Examples
    --------
    >>> Scaling(output=0.25, regressor=[0.05, 0.15]).sigmas(Structure(poles=1))
    array([0.05, 0.15])
    """

    output: float
    regressor: Sequence[float]

    def __post_init__(self) -> None:
        keep(self, "output", positive, called="scaling output")
        keep(self, "regressor", numbers, called="scaling regressor")
        if min(self.regressor) <= 0.0:
            raise InvalidArgumentError(f"scaling regressor must be greater than 0, got {min(self.regressor):g}")
        if not self.output / min(self.regressor) <= np.finfo(np.float64).max:
            raise InvalidArgumentError(
                f"scaling regressor must be larger: {min(self.regressor):g} is too small beside the output's "
                f"{self.output:g}"
            )

    def sigmas(self, structure: Structure) -> FloatArray:
        """Return the regressor's sigmas (P,) for ``structure``.

        Parameters
        ----------
        structure : Structure
            The structure that is identified.

        Raises
        ------
        InvalidArgumentError
            If their number differs from the number of parameters.
        """
        structure = instance("structure", structure, Structure)
        sigmas = np.array(self.regressor)
        if sigmas.size != structure.size:
            names = ", ".join(structure.names)
            raise InvalidArgumentError(
                f"scaling regressor must have {structure.size} entries ({names}), got {sigmas.size}"
            )
        return sigmas

    @classmethod
    def none(cls, structure: Structure) -> Scaling:
        """Return the scaling that changes nothing."""
        return cls(1.0, (1.0,) * instance("structure", structure, Structure).size)

    @classmethod
    def from_record(cls, y: FloatArray, regressor: FloatArray) -> Scaling:
        """Return the root mean squares of the output (K,) and of unscaled regressors (K, P); 1 for a zero signal.

        Rows that are not finite are left out: `estimation.solver.least_squares` marks rejected samples by NaN.
        """
        kept = np.isfinite(regressor).all(axis=1) & np.isfinite(y)
        return cls(_rms(y[kept]), tuple(_rms(entry) for entry in regressor[kept].T))


def _rms(signal: FloatArray) -> float:
    largest = float(np.abs(signal).max(initial=0.0))
    if largest == 0.0:
        return 1.0
    return largest * float(np.sqrt(np.mean((signal / largest) ** 2)))  # relative to the largest: no overflow


@dataclass(frozen=True)
class Settings:
    """The settings of a running identifier, none of them "auto".  `arguments` make an identifier with the same ones.

    Attributes
    ----------
    structure : Structure
    dt : float
        Sampling time in s.
    filter : StateVariableFilter or RefinedFilter
    scaling : Scaling
    optimizer : Optimizer
    replay : Replay or None
    instruments : bool
    normalize : bool
    preprocess : Preprocess
        With a numeric working point.
    startup : int
        Number of samples collected in the start-up.
    reference : bool
        Whether the samples have a reference.
    """

    structure: Structure
    dt: float
    filter: Filter
    scaling: Scaling
    optimizer: Optimizer
    replay: Replay | None
    instruments: bool
    normalize: bool
    preprocess: Preprocess
    startup: int
    reference: bool = False

    def __post_init__(self) -> None:
        for name, check in CHECKS.items():
            keep(self, name, *check)
        keep(self, "startup", whole, 0)
        keep(self, "reference", truth)
        if self.preprocess.needs != "nothing":
            raise InvalidArgumentError("the working point of settings must be numbers")
        _check_together(self)
        if self.reference and not (self.filter.follows_estimate and self.optimizer.keeps_colour):
            raise InvalidArgumentError(NO_USE_OF_REFERENCE)

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments of an identifier with these settings: all but ``reference``."""
        return {name: value for name, value in vars(self).items() if name != "reference"}


@dataclass(frozen=True)
class Request:
    """The settings requested by the user, as in `Settings`; "auto" leaves a choice to the data."""

    structure: Structure
    dt: float
    filter: Filter | str = AUTO
    scaling: Scaling | str | None = AUTO
    optimizer: Optimizer | str = AUTO
    replay: Replay | str | None = AUTO
    instruments: bool | str = AUTO
    normalize: bool = True
    preprocess: Preprocess = field(default_factory=Preprocess)
    startup: int = 500
    history: int = STORED

    def __post_init__(self) -> None:
        for name, check in REQUESTED.items():
            keep(self, name, *check)
        keep(self, "startup", whole, 1)
        if self.startup >= 2**31:
            raise InvalidArgumentError(f"startup must be below 2^31, got {shown(self.startup)}")
        keep(self, "history", whole, 0)
        if self.history > STORED:
            raise InvalidArgumentError(f"history must be at most {STORED:,} samples, got {shown(self.history)}")
        _check_together(self)
        remembers = isinstance(self.optimizer, Optimizer) and self.optimizer.keeps_covariance
        if remembers and isinstance(self.replay, Replay):
            name = type(self.optimizer).__name__
            raise InvalidArgumentError(f"{name} uses every sample already: replay must be None, not a buffer")
        if isinstance(self.filter, Filter) and self.filter.fixed:  # raises if it cannot be discretised
            self.filter.fixed.discretize(self.structure.poles, self.dt, self.structure.delay)

    @property
    def wants_instruments(self) -> bool:
        """Whether instruments are used; if "auto", with the refined filter or an optimizer that keeps a covariance."""
        if isinstance(self.instruments, bool):
            return self.instruments
        if isinstance(self.filter, Filter) and self.filter.follows_estimate:
            return True
        return self.keeps_covariance

    @property
    def keeps_covariance(self) -> bool:
        """Whether the optimizer keeps a covariance: then outputs are examined, and may be missing."""
        return self.optimizer_kind.keeps_covariance

    @property
    def optimizer_kind(self) -> Optimizer | type[Optimizer]:
        """The optimizer, or its class if the user gave only a name."""
        if isinstance(self.optimizer, Optimizer):
            return self.optimizer
        return OPTIMIZERS[DEFAULT_OPTIMIZER if self.optimizer == AUTO else self.optimizer]

    @property
    def input_hold(self) -> str:
        """The input between two samples: "zoh", held, or "foh", linear."""
        return self.filter.input_hold if isinstance(self.filter, Filter) else "zoh"

    @property
    def takes_reference(self) -> bool:
        """Whether a reference can be used: by the refined filter with recursive least squares."""
        follows = self.filter.follows_estimate if isinstance(self.filter, Filter) else self.wants_instruments
        return follows and self.keeps_covariance and self.optimizer_kind.keeps_colour

    @property
    def least_startup(self) -> int:
        """The least number of samples for a first model."""
        return 4 * (2 * self.structure.poles + self.structure.zeros + 2) if self.wants_instruments else 1

    @property
    def first_hold(self) -> int:
        """Number of measured outputs that the start-up collects first; 0 if no choice needs them."""
        # the choice of optimizer and replay needs no record of samples
        waits = isinstance(self.filter, str) or isinstance(self.scaling, str) or self.preprocess.needs == "mean"
        if waits or self.wants_instruments:
            return max(self.startup, self.least_startup)
        return 0 if self.preprocess.needs == "nothing" else 1


def filter_for(input_hold: str) -> Filter | str:
    """Return the filter to request: "auto" for "zoh"; for "foh" the refined filter, which must know the hold."""
    return AUTO if input_hold == "zoh" else RefinedFilter(input_hold)


def _switch(name: str, value: Any) -> bool | str:
    chosen: bool | str = bool(value) if isinstance(value, np.bool_) else instance(name, value, bool, AUTO)
    return chosen


def check_kept(delay: float, dt: float) -> None:
    """Raise InvalidArgumentError for a dead time so long that its inputs cannot be kept."""
    if delay > LONGEST_DELAY * dt:
        raise InvalidArgumentError(f"delay must be at most {LONGEST_DELAY:,} sampling times, got {delay / dt:.3g}")


def _check_together(chosen: Settings | Request) -> None:
    """Raise InvalidArgumentError if choices do not fit together."""
    check_kept(chosen.structure.delay, chosen.dt)
    if isinstance(chosen.filter, Filter):
        chosen.filter.check(chosen.structure)
        if chosen.filter.follows_estimate and chosen.instruments is False:
            raise InvalidArgumentError("the refined filter needs instruments: leave out instruments=False")
    if isinstance(chosen.scaling, Scaling):
        chosen.scaling.sigmas(chosen.structure)
    if isinstance(chosen.optimizer, Optimizer):
        chosen.optimizer.check(chosen.structure.size)


#: The check of each setting, by its name; and that of each argument, which may leave it to the data.
CHECKS: dict[str, tuple[Any, ...]] = {
    "structure": (instance, Structure), "dt": (duration,), "filter": (instance, *FILTERS),
    "scaling": (instance, Scaling), "optimizer": (instance, Optimizer), "replay": (instance, Replay, None),
    "instruments": (truth,), "normalize": (truth,), "preprocess": (instance, Preprocess),
}  # fmt: skip
REQUESTED = CHECKS | {
    "filter": (instance, *FILTERS, AUTO), "scaling": (instance, Scaling, AUTO, None),
    "optimizer": (instance, Optimizer, AUTO, *OPTIMIZERS), "replay": (instance, Replay, AUTO, None),
    "instruments": (_switch,),
}  # fmt: skip

# two thirds of `STORED`, so that the record is solved once more as a whole
LONGEST_STARTUP = 20_000  # measured outputs after which a start-up ends even if it is not sufficient [samples]
