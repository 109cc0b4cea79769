"""ModelFields: the data of a model, checked, and what follows from them at once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from replant.arguments import (
    FloatArray,
    finite,
    instance,
    keep,
    number,
    one_of,
    owned,
    text,
    vector,
    whole,
)
from replant.assessment.verdict import Verdict
from replant.errors import ArgumentTypeError, InvalidArgumentError, shown
from replant.identified.provenance import Provenance
from replant.limits import duration
from replant.model.noise import NoiseModel
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.model.uncertainty import Uncertainty
from replant.regressor.preprocess import InputMap, Preprocess

NOT_JUDGED = Verdict("converging", ("no verdict was asked for",))


@dataclass(frozen=True, eq=False, repr=False)
class ModelFields:
    r"""What is kept of an identification, and what follows from it at once; see `Model`.

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
        keep(self, "dt", duration)
        size = self.structure.size
        keep(self, "parameters", owned, (size,))
        if not np.isfinite(self.parameters).all():
            raise InvalidArgumentError(f"parameters must be finite, got {shown(self.parameters.tolist())}")
        if self.covariance is not None:
            covariance = owned("covariance", self.covariance, (size, size))
            # one that is not known is none: what is kept can be written down to the bit
            object.__setattr__(self, "covariance", covariance if np.isfinite(covariance).all() else None)
        keep(self, "noise", instance, NoiseModel, None)
        keep(self, "input_hold", one_of, ("zoh", "foh"))
        object.__setattr__(self, "input_map", Preprocess(self.input_map).input_map)
        for name in ("input_level", "output_level"):
            keep(self, name, finite)
        for name in ("input_name", "output_name"):
            keep(self, name, text)
        for name in ("simulated_fit", "one_step_fit"):
            keep(self, name, _known)
        keep(self, "rejected", _counts)
        keep(self, "verdict", instance, Verdict)
        keep(self, "provenance", instance, Provenance)

    @property
    def transfer_function(self) -> TransferFunction:
        """G(s), from the mapped input to the output, both as deviations from the working point."""
        return self.structure.transfer_function(self.parameters)

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
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in their order."""
        return self.structure.names

    @property
    def uncertainty(self) -> Uncertainty | None:
        """Standard deviations of parameters, poles, gain and response; None without a covariance."""
        return None if self.covariance is None else Uncertainty(self.structure, self.parameters, self.covariance)

    @property
    def rests(self) -> bool:
        """Whether a constant input leads to rest, as far as the record tells: no mode is slower than the record."""
        span = self.dt * self.provenance.samples
        return has_rest(self.transfer_function, span if self.provenance.samples else math.inf)

    @property
    def preprocess(self) -> Preprocess:
        """Input map and working point."""
        return Preprocess(self.input_map, self.input_level, self.output_level)

    def linear_input(self, u: Any) -> FloatArray:
        """Return the input (K,) of G(s): mapped, working point taken off; NaN where it is not finite."""
        mapped = self.preprocess.map_input(vector("u", u))
        return np.where(np.isfinite(mapped), mapped - self.input_level, np.nan)

    def __eq__(self, other: object) -> bool:
        return self._key == other._key if isinstance(other, ModelFields) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key)

    @property
    def _key(self) -> tuple[Any, ...]:
        noise = self.noise
        numbers = [self.dt, self.input_level, self.output_level, self.simulated_fit, self.one_step_fit]
        return (
            self.structure,
            self.parameters.tobytes(),
            None if self.covariance is None else self.covariance.tobytes(),
            noise and (noise.coefficients.tobytes(), noise.variance, noise.residual_variance, noise.dt),
            (self.input_hold, self.input_map, self.input_name, self.output_name),
            np.array(numbers).tobytes(),
            self.rejected,
            (self.verdict.status, self.verdict.reasons, self.verdict.excited),
            self.provenance,
        )


def has_rest(model: TransferFunction, span: float) -> bool:
    """Return whether a model comes to rest within ``span`` s; slower modes have a gain that nobody knows.

    Examples
    --------
    >>> g = TransferFunction([1.0], [1.0, 0.5])
    >>> has_rest(g, 10.0), has_rest(g, 1.0)
    (True, False)
    """
    return bool((model.poles.real < (-1.0 / span if span > 0.0 else 0.0)).all())


def _counts(name: str, value: Any) -> tuple[tuple[str, int], ...]:
    """Return how many samples were rejected for which reason."""
    try:
        pairs = [(reason, count) for reason, count in value]
    except (TypeError, ValueError) as cause:
        raise ArgumentTypeError(f"{name} must be pairs (reason, count), got {shown(value)}") from cause
    return tuple((text(name, reason), whole(name, count, 0, 2**63 - 1)) for reason, count in pairs)


def _known(name: str, value: Any) -> float:
    value = number(name, value)
    return value if math.isfinite(value) else math.nan
