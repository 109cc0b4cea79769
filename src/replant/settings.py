"""Settings: every choice of an identifier, as asked for and as made definite."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from replant.errors import ArgumentTypeError
from replant.filters import StateVariableFilter
from replant.optimizers import OPTIMIZERS, Optimizer
from replant.preprocess import Preprocess
from replant.replay import Replay
from replant.scaling import Scaling
from replant.structure import Structure
from replant.validation import positive

AUTO = "auto"


@dataclass(frozen=True)
class Settings:
    """What an identifier works with, nothing left to "auto": printed, it repeats the identifier.

    Attributes
    ----------
    structure : Structure
    dt : float
        Sampling time in s.
    filter : StateVariableFilter
    scaling : Scaling
    optimizer : Optimizer
    replay : Replay or None
    normalize : bool
    preprocess : Preprocess
        With numbers for working points.
    """

    structure: Structure
    dt: float
    filter: StateVariableFilter
    scaling: Scaling
    optimizer: Optimizer
    replay: Replay | None
    normalize: bool
    preprocess: Preprocess


@dataclass(frozen=True)
class Request:
    """What the user asked for: the same as `Settings`, where "auto" leaves a choice to the data."""

    structure: Structure
    dt: float
    filter: StateVariableFilter | str = AUTO
    scaling: Scaling | str | None = AUTO
    optimizer: Optimizer | str = AUTO
    replay: Replay | str | None = AUTO
    normalize: bool = True
    preprocess: Preprocess = field(default_factory=Preprocess)

    def __post_init__(self) -> None:
        _expect("structure", self.structure, Structure)
        _expect("filter", self.filter, StateVariableFilter, AUTO)
        _expect("scaling", self.scaling, Scaling, AUTO, None)
        _expect("optimizer", self.optimizer, Optimizer, AUTO, *OPTIMIZERS)
        _expect("replay", self.replay, Replay, AUTO, None)
        _expect("normalize", self.normalize, bool)
        _expect("preprocess", self.preprocess, Preprocess)
        object.__setattr__(self, "dt", positive("dt", self.dt))
        if isinstance(self.filter, StateVariableFilter):
            self.filter.discretize(self.structure.poles, self.dt, self.structure.delay)  # raises what cannot work
        if isinstance(self.scaling, Scaling):
            self.scaling.sigmas(self.structure)

    @property
    def asks_for_data(self) -> bool:
        """Whether a choice waits for a record of samples; those of optimizer and replay do not."""
        return isinstance(self.filter, str) or isinstance(self.scaling, str) or self.preprocess.needs == "mean"


def _expect(name: str, value: Any, kind: type, *others: str | None) -> None:
    if isinstance(value, kind) or ((value is None or isinstance(value, str)) and value in others):
        return
    allowed = " or ".join([f"a {kind.__name__}", *(repr(other) for other in others)])
    raise ArgumentTypeError(f"{name} must be {allowed}, got {type(value).__name__} {value!r}")
