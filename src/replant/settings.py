"""Settings: every choice of an identifier, as asked for and as made definite."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from replant.arguments import positive, whole
from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.model.structure import Structure
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.optimizers.replay import Replay
from replant.regressor.filters import RefinedFilter, StateVariableFilter
from replant.regressor.preprocess import Preprocess
from replant.regressor.scaling import Scaling

AUTO = "auto"
LONGEST_DELAY = 1_000_000  # sampling times; every input of that long is kept
DEFAULT_OPTIMIZER = "recursive-least-squares"


@dataclass(frozen=True)
class Settings:
    """What an identifier works with, nothing left to "auto": printed, it repeats the identifier.

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
        With numbers for working points.
    startup : int
        Samples that were held back.
    """

    structure: Structure
    dt: float
    filter: StateVariableFilter | RefinedFilter
    scaling: Scaling
    optimizer: Optimizer
    replay: Replay | None
    instruments: bool
    normalize: bool
    preprocess: Preprocess
    startup: int


@dataclass(frozen=True)
class Request:
    """What the user asked for: the same as `Settings`, where "auto" leaves a choice to the data."""

    structure: Structure
    dt: float
    filter: StateVariableFilter | RefinedFilter | str = AUTO
    scaling: Scaling | str | None = AUTO
    optimizer: Optimizer | str = AUTO
    replay: Replay | str | None = AUTO
    instruments: bool | str = AUTO
    normalize: bool = True
    preprocess: Preprocess = field(default_factory=Preprocess)
    startup: int = 500

    def __post_init__(self) -> None:
        _expect("structure", self.structure, Structure)
        _expect("filter", self.filter, (StateVariableFilter, RefinedFilter), AUTO)
        _expect("scaling", self.scaling, Scaling, AUTO, None)
        _expect("optimizer", self.optimizer, Optimizer, AUTO, *OPTIMIZERS)
        _expect("replay", self.replay, Replay, AUTO, None)
        _expect("instruments", self.instruments, bool, AUTO)
        _expect("normalize", self.normalize, bool)
        _expect("preprocess", self.preprocess, Preprocess)
        whole("startup", self.startup, 1)
        object.__setattr__(self, "dt", positive("dt", self.dt))
        if self.structure.delay > LONGEST_DELAY * self.dt:
            raise InvalidArgumentError(
                f"delay must be at most {LONGEST_DELAY:,} sampling times, got {self.structure.delay / self.dt:.3g}"
            )
        if isinstance(self.filter, StateVariableFilter):
            self.filter.discretize(self.structure.poles, self.dt, self.structure.delay)  # raises what cannot work
        if isinstance(self.scaling, Scaling):
            self.scaling.sigmas(self.structure)
        if isinstance(self.optimizer, Optimizer):
            self.optimizer.check(self.structure.size)
        if isinstance(self.filter, RefinedFilter) and self.instruments is False:
            raise InvalidArgumentError("the refined filter needs instruments: instruments=False cannot go with it")
        if (
            isinstance(self.optimizer, Optimizer)
            and self.optimizer.keeps_covariance
            and isinstance(self.replay, Replay)
        ):
            name = type(self.optimizer).__name__
            raise InvalidArgumentError(f"{name} remembers every sample by itself: replay must be None, not a buffer")
        if isinstance(self.filter, StateVariableFilter) and self.filter.method == "gbt" and self.structure.is_biproper:
            raise InvalidArgumentError("the gbt filter is strictly causal: as many zeros as poles need method='exact'")

    @property
    def wants_instruments(self) -> bool:
        """Whether instruments are asked for, or go with what is asked for.

        Left to "auto", they come with the refined filter and with the optimizers that keep a covariance.
        """
        if isinstance(self.instruments, bool):
            return self.instruments
        if isinstance(self.filter, RefinedFilter):
            return True
        if isinstance(self.optimizer, Optimizer):
            return self.optimizer.keeps_covariance
        name = DEFAULT_OPTIMIZER if self.optimizer == AUTO else self.optimizer
        return OPTIMIZERS[name].keeps_covariance

    @property
    def least_startup(self) -> int:
        """How many samples a first model needs at the least."""
        return 4 * (2 * self.structure.poles + self.structure.zeros + 2) if self.wants_instruments else 1

    @property
    def asks_for_data(self) -> bool:
        """Whether a choice waits for a record of samples; those of optimizer and replay do not."""
        waits = isinstance(self.filter, str) or isinstance(self.scaling, str) or self.preprocess.needs == "mean"
        return waits or self.wants_instruments


def _expect(name: str, value: Any, kind: type | tuple[type, ...], *others: str | None) -> None:
    if isinstance(value, kind) or ((value is None or isinstance(value, str)) and value in others):
        return
    kinds = kind if isinstance(kind, tuple) else (kind,)
    allowed = " or ".join([*(_one(each.__name__) for each in kinds), *(repr(other) for other in others)])
    raise ArgumentTypeError(f"{name} must be {allowed}, got {type(value).__name__} {value!r}")


def _one(name: str) -> str:
    return f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"
