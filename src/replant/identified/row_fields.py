"""RowFields: the data of a model of several inputs, checked, and what follows from them at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from replant.arguments import FloatArray, finite, instance, iterable, keep, one_of, owned, text
from replant.assessment.verdict import Verdict
from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.identified.fields import NOT_JUDGED
from replant.identified.provenance import Provenance
from replant.limits import duration
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty


@dataclass(frozen=True, eq=False, repr=False)
class RowFields:
    """What is kept of an identification of several inputs; see `RowModel`."""

    structures: tuple[Structure, ...]
    parameters: FloatArray
    dt: float
    covariance: FloatArray | None = None
    noise: NoiseModel | None = None
    input_hold: str = "zoh"
    input_names: tuple[str, ...] = ()
    output_name: str = "y"
    input_levels: FloatArray = field(default_factory=lambda: np.zeros(0))
    output_level: float = 0.0
    simulated_fit: float = math.nan
    one_step_fit: float = math.nan
    verdict: Verdict = NOT_JUDGED
    provenance: Provenance = field(default_factory=lambda: Provenance("given"))

    def __post_init__(self) -> None:
        if not iterable(self.structures) or not self.structures:
            raise ArgumentTypeError(f"structures must be one Structure per input, got {shown(self.structures)}")
        put = object.__setattr__
        put(self, "structures", tuple(instance("structures", each, Structure) for each in self.structures))
        count, size = len(self.structures), sum(each.size for each in self.structures)
        keep(self, "parameters", owned, (size,))
        if not np.isfinite(self.parameters).all():
            raise InvalidArgumentError(f"parameters must be finite, got {shown(self.parameters.tolist())}")
        keep(self, "dt", duration)
        if self.covariance is not None:
            covariance = owned("covariance", self.covariance, (size, size))
            put(self, "covariance", covariance if np.isfinite(covariance).all() else None)
        keep(self, "noise", instance, NoiseModel, None)
        keep(self, "input_hold", one_of, ("zoh", "foh"))
        if not iterable(self.input_names):
            raise ArgumentTypeError(f"input_names must be a name for each input, got {shown(self.input_names)}")
        names = tuple(self.input_names) or tuple(f"u{i}" for i in range(1, count + 1))
        put(self, "input_names", tuple(text("input_names", name) for name in names))
        if len(set(names)) != count or len(names) != count:
            raise InvalidArgumentError(f"input_names must be {count} different names, got {shown(list(names))}")
        keep(self, "output_name", text)
        levels = self.input_levels if np.size(self.input_levels) else np.zeros(count)
        put(self, "input_levels", owned("input_levels", levels, (count,)))
        keep(self, "output_level", finite)
        for name in ("simulated_fit", "one_step_fit"):
            value = float(getattr(self, name))
            put(self, name, value if math.isfinite(value) else math.nan)
        keep(self, "verdict", instance, Verdict)
        keep(self, "provenance", instance, Provenance)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in their order, each with that of its input: a0.u1, b0.u1, a0.u2, .."""
        each = zip(self.input_names, self.structures, strict=True)
        return tuple(f"{parameter}.{name}" for name, structure in each for parameter in structure.names)

    @property
    def input_name(self) -> tuple[str, ...]:
        """The names of the inputs, as `Model` has one."""
        return self.input_names

    @property
    def transfer_functions(self) -> tuple[TransferFunction, ...]:
        """G(s) from each input."""
        pairs = zip(self.structures, self.places, strict=True)
        return tuple(each.transfer_function(self.parameters[rows]) for each, rows in pairs)

    @cached_property
    def uncertainty(self) -> tuple[Uncertainty, ...] | None:
        """Standard deviations of each G(s): of its parameters, poles, gain and response; None without a covariance."""
        if self.covariance is None:
            return None
        pairs = zip(self.structures, self.places, strict=True)
        return tuple(Uncertainty(each, self.parameters[k], self.covariance[k, k]) for each, k in pairs)

    @property
    def places(self) -> list[slice]:
        """Which of the parameters are those of each input."""
        ends = np.cumsum([each.size for each in self.structures]).tolist()
        return [slice(*rows) for rows in zip([0, *ends], ends, strict=False)]
