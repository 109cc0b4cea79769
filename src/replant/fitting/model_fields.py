"""The fields of a model of one input or of several, checked, and the properties that follow from them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from importlib.metadata import version
from typing import Any

import numpy as np

from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.model.noise import NoiseModel
from replant.model.preprocess import InputMap, Preprocess
from replant.model.structure import Structure, names_of, places_of
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.numerics.arguments import (
    FloatArray,
    finite,
    instance,
    iterable,
    keep,
    number,
    one_of,
    owned,
    text,
    vector,
    whole,
)
from replant.numerics.limits import duration
from replant.verdict.verdict import Verdict

NOT_JUDGED = Verdict("converging", ("no verdict was asked for",))


@dataclass(frozen=True)
class Provenance:
    """Where a model comes from."""

    method: str  # "srivc", "least_squares", or the optimizer of an identifier
    source: str = ""  # name of the log's file; empty for arrays and live samples
    sha256: str = ""  # digest of that file in hexadecimal; empty if unknown
    samples: int = 0  # that the model was made from
    version: str = field(default_factory=lambda: version("replant"))  # of replant
    # UTC in ISO 8601; two models that differ in nothing else are equal
    date: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"), compare=False)

    def __post_init__(self) -> None:
        for name in ("method", "source", "sha256", "version", "date"):
            keep(self, name, text)
        keep(self, "samples", whole, 0, 2**63 - 1)


def _counts(name: str, value: Any) -> tuple[tuple[str, int], ...]:
    """Return the checked numbers of rejected samples by reason."""
    try:
        pairs = [(reason, count) for reason, count in value]
    except (TypeError, ValueError) as cause:
        raise ArgumentTypeError(f"{name} must be pairs (reason, count), got {shown(value)}") from cause
    return tuple((text(name, reason), whole(name, count, 0, 2**63 - 1)) for reason, count in pairs)


def _known(name: str, value: Any) -> float:
    value = number(name, value)
    return value if math.isfinite(value) else math.nan


#: The checks of fields of models, of one input or of several.
CHECKS: dict[str, tuple[Any, ...]] = {
    "dt": (duration,),
    "noise": (instance, NoiseModel, None),
    "input_hold": (one_of, ("zoh", "foh")),
    "input_map": (lambda _, value: Preprocess(value).input_map,),
    "input_level": (finite,),
    "output_level": (finite,),
    "input_name": (text,),
    "output_name": (text,),
    "simulated_fit": (_known,),
    "one_step_fit": (_known,),
    "rejected": (_counts,),
    "verdict": (instance, Verdict),
    "provenance": (instance, Provenance),
}


class Identified:
    """Properties that follow from a structure, its parameters and their covariance."""

    structure: Structure
    parameters: FloatArray
    covariance: FloatArray | None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order."""
        return self.structure.names

    @property
    def transfer_function(self) -> TransferFunction:
        """G(s), from the mapped input to the output, both as deviations from the working point."""
        return self.structure.transfer_function(self.parameters)

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Standard deviations of parameters, poles, gain and response; None without a covariance."""
        return None if self.covariance is None else Uncertainty(self.structure, self.parameters, self.covariance)


class Fields:
    """The base of the fields of models of one input and of several: checks, equality, and what follows for both."""

    parameters: FloatArray
    dt: float
    covariance: FloatArray | None
    provenance: Provenance
    structures: Any  # tuple of Structure: a field, or the only one

    @property
    def places(self) -> list[slice]:
        """Which of the parameters are those of each input."""
        return places_of(self.structures)

    @property
    def transfer_functions(self) -> tuple[TransferFunction, ...]:
        """G(s) from each input, as deviations from the working point."""
        pairs = zip(self.structures, self.places, strict=True)
        return tuple(each.transfer_function(self.parameters[rows]) for each, rows in pairs)

    @property
    def rests(self) -> bool:
        """Whether constant inputs lead to rest within the duration of the record: no mode is slower."""
        span = self.dt * self.provenance.samples if self.provenance.samples else math.inf
        return all(has_rest(g, span) for g in self.transfer_functions)

    def _check(self, size: int) -> None:
        keep(self, "parameters", owned, (size,))
        if not np.isfinite(self.parameters).all():
            raise InvalidArgumentError(f"parameters must be finite, got {shown(self.parameters.tolist())}")
        if self.covariance is not None:
            covariance = owned("covariance", self.covariance, (size, size))
            # an unknown covariance is dropped, so that a model can be written to the bit
            object.__setattr__(self, "covariance", covariance if np.isfinite(covariance).all() else None)
        own = {each.name for each in dataclasses.fields(self)}  # type: ignore[arg-type]
        for name, (check, *how) in CHECKS.items():
            if name in own:
                keep(self, name, check, *how)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, Fields) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        return tuple(_bits(getattr(self, each.name)) for each in dataclasses.fields(self))  # type: ignore[arg-type]


def _bits(value: Any) -> Any:
    """Return a key that is equal for values that are equal to the bit."""
    match value:
        case np.ndarray():
            return value.tobytes()
        case float():
            return np.float64(value).tobytes()
        case NoiseModel():
            return tuple(map(_bits, (value.coefficients, value.variance, value.residual_variance, value.dt)))
        case Verdict():
            return value.status, value.reasons, value.excited
    return value


@dataclass(frozen=True, eq=False, repr=False)
class ModelFields(Fields, Identified):
    r"""The fields of a `Model`, and the properties that follow from them.

    .. math:: y = \mathrm{output\_level} + G(s)\,(\mathrm{map}(u) - \mathrm{input\_level})
    """

    structure: Structure
    parameters: FloatArray
    dt: float
    covariance: FloatArray | None = None
    noise: NoiseModel | None = None
    input_hold: str = "zoh"
    input_map: InputMap = "identity"
    input_level: float = 0.0
    output_level: float = 0.0
    input_name: str = "u"
    output_name: str = "y"
    simulated_fit: float = math.nan
    one_step_fit: float = math.nan
    rejected: tuple[tuple[str, int], ...] = ()
    verdict: Verdict = NOT_JUDGED
    provenance: Provenance = field(default_factory=lambda: Provenance("given"))

    def __post_init__(self) -> None:
        keep(self, "structure", instance, Structure)
        self._check(self.structure.size)

    @property
    def structures(self) -> tuple[Structure]:
        """The structure, as the only one."""
        return (self.structure,)

    @property
    def num(self) -> FloatArray:
        """Numerator (m + 1,), in descending powers of s."""
        return self.transfer_function.num

    @property
    def den(self) -> FloatArray:
        """Denominator (n + 1,), monic, in descending powers of s."""
        return self.transfer_function.den

    @property
    def delay(self) -> float:
        """Dead time in s."""
        return self.structure.delay

    @property
    def preprocess(self) -> Preprocess:
        """Input map and working point."""
        return Preprocess(self.input_map, self.input_level, self.output_level)

    def linear_input(self, u: Any) -> FloatArray:
        """Return the input (K,) of G(s): mapped, working point subtracted; NaN where it is not finite."""
        mapped = self.preprocess.map_input(vector("u", u))
        return np.where(np.isfinite(mapped), mapped - self.input_level, np.nan)


@dataclass(frozen=True, eq=False, repr=False)
class RowFields(Fields):
    """The fields of a `RowModel`, and the properties that follow from them."""

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
    rejected: tuple[tuple[str, int], ...] = ()
    verdict: Verdict = NOT_JUDGED
    provenance: Provenance = field(default_factory=lambda: Provenance("given"))

    def __post_init__(self) -> None:
        put = object.__setattr__
        if not iterable(self.structures) or not self.structures:
            raise ArgumentTypeError(f"structures must be one Structure per input, got {shown(self.structures)}")
        put(self, "structures", tuple(instance("structures", each, Structure) for each in self.structures))
        count = len(self.structures)
        self._check(sum(each.size for each in self.structures))
        put(self, "input_names", input_names_of(self.input_names, count))
        levels = self.input_levels if np.size(self.input_levels) else np.zeros(count)
        put(self, "input_levels", owned("input_levels", levels, (count,)))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters in their order, each with that of its input: a0.u1, b0.u1, a0.u2, .."""
        return names_of(self.structures, self.input_names)

    @property
    def input_name(self) -> tuple[str, ...]:
        """The names of the inputs, by the name that `Model` uses."""
        return self.input_names

    @cached_property
    def uncertainty(self) -> tuple[Uncertainty, ...] | None:
        """Standard deviations of each G(s): of its parameters, poles, gain and response; None without a covariance."""
        if self.covariance is None:
            return None
        pairs = zip(self.structures, self.places, strict=True)
        return tuple(Uncertainty(each, self.parameters[k], self.covariance[k, k]) for each, k in pairs)


def input_names_of(given: Any, count: int) -> tuple[str, ...]:
    """Return the names of so many inputs, checked; those of `unnamed` if none are given."""
    if not isinstance(given, list | tuple):
        raise ArgumentTypeError(f"input_names must be a list or tuple of names, got {shown(given)}")
    names = tuple(text("input_names", name) for name in given) or unnamed(count)
    if len(set(names)) != count or len(names) != count:
        raise InvalidArgumentError(f"input_names must be {count} different names, got {shown(list(names))}")
    return names


def unnamed(count: int) -> tuple[str, ...]:
    """Return names for so many unnamed inputs: u1, u2, ..."""
    return tuple(f"u{i}" for i in range(1, count + 1))


def has_rest(model: TransferFunction, span: float) -> bool:
    """Return whether a model comes to rest within ``span`` s; the gain of slower modes is unknown."""
    return bool((model.poles.real < (-1.0 / span if span > 0.0 else 0.0)).all())
