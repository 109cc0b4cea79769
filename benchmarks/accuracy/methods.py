"""The methods: each takes a record and returns figures, a value and a standard deviation by name.

The standard deviation is NaN where the method prints none, the value where it has no estimate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import replant as rp
from accuracy.records import Measured
from replant.model.uncertainty import Uncertainty
from replant.numerics.arguments import FloatArray
from replant.online.identifier import Identifier

Figures = dict[str, tuple[float, float]]
QUANTILE = 1.96  # standard deviations to either side of a nominal 95 % interval


@dataclass(frozen=True)
class Online:
    """One pass of an `Identifier` with these options, everything else left to it.

    Attributes
    ----------
    options : mapping
    with_reference : bool
        Whether it is given the record's reference.
    judges : bool
        Whether the figure "trusted" is 1 where the verdict on the estimate is so, else 0.
    """

    options: Mapping[str, Any] = field(default_factory=dict)
    with_reference: bool = False
    judges: bool = False

    def identifier(self, structure: rp.Structure, dt: float, measured: Measured) -> Identifier:
        """Return the identifier before its first sample."""
        return Identifier(structure, dt, preprocess=measured.preprocess, **self.options)

    def __call__(self, structure: rp.Structure, dt: float, measured: Measured) -> Figures:
        """Return the parameters and the modes after the last sample."""
        ident = self.identifier(structure, dt, measured)
        ident.update_many(measured.u, measured.y, measured.t, r=measured.r if self.with_reference else None)
        said = {"trusted": (float(ident.assess().status == "trusted"), math.nan)} if self.judges else {}
        if ident.settings is None:  # still starting at the record's end
            return said | figures_of(Uncertainty(structure, np.full(structure.size, np.nan), ident.covariance))
        return said | figures_of(ident.uncertainty)


@dataclass(frozen=True)
class Offline:
    """`replant.fit` on the whole record at once.

    Attributes
    ----------
    method : str
        "srivc", refined instrumental variables, or "least_squares", the article's reference.
    with_reference : bool
        Whether it is given the record's reference.
    """

    method: str = "srivc"
    with_reference: bool = False

    def __call__(self, structure: rp.Structure, dt: float, measured: Measured) -> Figures:
        """Return the parameters and the modes."""
        unknown = np.full((structure.size, structure.size), np.nan)
        try:
            found = rp.fit(
                measured.u,
                measured.y,
                dt,
                structure,
                method=self.method,
                preprocess=measured.preprocess,
                t=measured.t,
                reference=measured.r if self.with_reference else None,
            )
        except rp.InvalidArgumentError:  # no model found
            return figures_of(Uncertainty(structure, unknown[0], unknown))
        return figures_of(found.uncertainty or Uncertainty(structure, found.parameters, unknown))


@dataclass(frozen=True)
class Article:
    """The article's experiment on its actuator: buffered AMSGrad, its scaling, gain and Lambda(s), a bias.

    Attributes
    ----------
    filters : str
        "gbt", the article's, or "exact".
    """

    filters: str

    def __call__(self, structure: rp.Structure, dt: float, measured: Measured) -> Figures:
        """Return the parameters and the modes after the last sample."""
        from replant.paper import actuator
        from replant.rigs import deap_rig

        record = actuator.Record(deap_rig(), measured.u, measured.y)
        ident = actuator.identifier(record, "AMSGrad", "small gain", self.filters)
        ident.update_many(measured.u, measured.y)
        size = structure.size
        return figures_of(Uncertainty(structure, ident.parameters[:size], np.full((size, size), np.nan)))


@dataclass(frozen=True)
class Tracked:
    """How closely an online method follows parameters that change, from its first estimate on.

    The root mean square of the error over time, and how often, looked at twenty times, the truth lies inside the
    nominal 95 % interval.
    """

    online: Online
    looks: int = 20

    def __call__(self, structure: rp.Structure, dt: float, measured: Measured) -> Figures:
        """Return the figures "rms <name>" and "inside <name>" of each parameter."""
        assert measured.truth is not None
        ident = self.online.identifier(structure, dt, measured)
        errors, inside, chunk = [], [], -(-measured.u.size // self.looks)
        for start in range(0, measured.u.size, chunk):
            part = slice(start, start + chunk)
            trace = ident.update_many(measured.u[part], measured.y[part])
            missed = trace.parameters - measured.truth[part]
            errors.append(missed[np.isfinite(trace.errors)])
            std = ident.uncertainty.std
            inside.append(np.where(np.isnan(std), np.nan, np.abs(missed[-1]) <= QUANTILE * std))
        rms = np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))
        share = 100.0 * np.mean(inside, axis=0)
        figures = {f"rms {name}": (float(value), math.nan) for name, value in zip(ident.names, rms, strict=True)}
        if np.isnan(share).any():  # it prints no intervals
            return figures
        return figures | {f"inside {name}": (float(v), math.nan) for name, v in zip(ident.names, share, strict=True)}


def figures_of(known: Uncertainty) -> Figures:
    """Return parameters, and natural frequency (Hz) and damping of the poles, with their standard deviations.

    The poles' figures are "f1", "zeta1", "f2" .. from the slowest on.  A real pole's damping is always 1 and left out;
    where all of two poles are real, "f" and "zeta" are those of the quadratic s^2 + a1 s + a0 as a whole.
    """
    names = known.structure.names
    figures = {
        name: (float(value), float(std)) for name, value, std in zip(names, known.parameters, known.std, strict=True)
    }
    if not np.isfinite(known.parameters).all():
        return figures
    return figures | dict(_of_modes(known))


def _of_modes(known: Uncertainty) -> Iterator[tuple[str, tuple[float, float]]]:
    modes = known.modes
    for number, uncertain in enumerate(modes, 1):
        yield f"f{number}", (uncertain.mode.frequency, uncertain.frequency_std)
        if uncertain.mode.pole.imag != 0.0:
            yield f"zeta{number}", (uncertain.mode.damping, uncertain.damping_std)
    if known.structure.poles == 2 and len(modes) == 2:
        a1, a0 = known.parameters[:2].tolist()
        if a0 > 0.0:
            yield "f", (math.sqrt(a0) / math.tau, _std(known, 0.0, 0.5 / (math.tau * math.sqrt(a0))))
            yield "zeta", (0.5 * a1 / math.sqrt(a0), _std(known, 0.5 / math.sqrt(a0), -0.25 * a1 / a0**1.5))


def _std(known: Uncertainty, *slope: float) -> float:
    """Return the standard deviation of a figure whose derivatives by a1 and a0 are ``slope``."""
    along: FloatArray = np.array(slope)
    return math.sqrt(float(along @ known.covariance[:2, :2] @ along))
