"""Preprocess: the input map and the working point, applied to raw input and output before any filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from replant.errors import InvalidArgumentError
from replant.kernels.schema import LARGEST
from replant.numerics.arguments import BoolArray, FloatArray, array_of_reals, finite, keep, one_of, record, vector
from replant.numerics.robust import without_spikes

InputMap = str | Callable[[FloatArray], FloatArray]
WorkingPoint = float | str


@dataclass(frozen=True)
class Preprocess:
    """Input map, then working point: u_p = map(u) - input_offset, y_p = y - output_offset.

    Parameters
    ----------
    input_map : {"identity", "square"} or callable
        A static nonlinearity before the linear plant; "square" for electrostatic actuators, whose force is
        proportional to the squared voltage.  A callable maps a float64 vector of any length entry by entry.
    input_offset, output_offset : float, "first" or "mean"
        Working point, in the unit of the *mapped* input and of the output: a number, the first sample, or the mean
        of the start-up samples (in `replant.fit` of the whole record).

    References
    ----------
    Bernat and Kolota (2023), below (25): u_p = u_A^2 - u_R^2, y_p = y_L - y_R.

    Examples
    --------
    >>> Preprocess("square", input_offset="first").resolve([2.0, 3.0], [1.0, 1.0])
    Preprocess(input_map='square', input_offset=4.0, output_offset=0.0)
    """

    input_map: InputMap = "identity"
    input_offset: WorkingPoint = 0.0
    output_offset: WorkingPoint = 0.0

    def __post_init__(self) -> None:
        if not callable(self.input_map):
            keep(self, "input_map", one_of, ("identity", "square"))
        keep(self, "input_offset", _working_point)
        keep(self, "output_offset", _working_point)

    def map_input(self, u: FloatArray) -> FloatArray:
        """Return the mapped input (K,)."""
        u = vector("u", u)
        if self.input_map == "identity":
            return u
        if self.input_map == "square":
            with np.errstate(over="ignore"):  # a sample that overflows is rejected
                return u * u
        return self.call_map(u)

    def call_map(self, u: FloatArray) -> FloatArray:
        """Return the raw input (K,) mapped by the callable; InvalidArgumentError if the shape changes."""
        assert callable(self.input_map)
        mapped = array_of_reals("the result of input_map", self.input_map(u))
        if mapped.shape != u.shape:
            raise InvalidArgumentError(f"input_map must keep the shape {u.shape}, it returned {mapped.shape}")
        return mapped

    @property
    def needs(self) -> str:
        """The samples that the working point needs: "nothing", the "first", or the "mean" of several."""
        offsets = (self.input_offset, self.output_offset)
        return "mean" if "mean" in offsets else "first" if "first" in offsets else "nothing"

    def resolve(self, u: FloatArray, y: FloatArray) -> Preprocess:
        """Return the same with numeric offsets, computed from the raw samples (K,) that `screen` accepts.

        InvalidArgumentError if an offset is "first" or "mean" and the record has no usable sample.
        """
        if self.needs == "nothing":
            return self
        u, y = record(u, y)
        mapped = self.map_input(u)
        valid, rejected = screen(mapped, y)
        if not valid.any():
            none = rejected_in_words(rejected) or "there is no sample"
            raise InvalidArgumentError(f"the working point needs at least one usable sample: {none}")
        offsets = (self.input_offset, mapped[valid]), (self.output_offset, y[valid])
        return Preprocess(self.input_map, *(_level(*each) for each in offsets))


def screen(mapped: FloatArray, y: FloatArray) -> tuple[np.ndarray[tuple[int], np.dtype[np.bool_]], dict[str, int]]:
    """Return which samples (K,) an identifier accepts, and the number rejected for each reason."""
    with np.errstate(invalid="ignore"):
        finite = np.isfinite(mapped) & np.isfinite(y)
        small = (np.abs(mapped) <= LARGEST) & (np.abs(y) <= LARGEST)
    rejected = {"not finite": int((~finite).sum()), "too large": int((finite & ~small).sum())}
    return finite & small, rejected


def rejected_in_words(rejected: Mapping[str, int]) -> str:
    """Return the number of rejected samples for each reason as text; empty if there are none.

    >>> rejected_in_words({"not finite": 1200, "too large": 0, "stuck": 3})
    '1,200 not finite, 3 stuck'
    """
    return ", ".join(f"{count:,} {reason}" for reason, count in rejected.items() if count)


def accepted(signal: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return a signal (K,) with NaN for samples that no identifier accepts, and a mask of those it accepts.

    >>> accepted(np.array([1.0, 1e308]))
    (array([ 1., nan]), array([ True, False]))
    """
    known = np.abs(signal) <= LARGEST
    return np.where(known, signal, np.nan), known


def check_moves(name: str, signal: FloatArray) -> None:
    """Raise an InvalidArgumentError if a signal (K,) moves by so little that its squares leave float64."""
    known = signal[accepted(signal)[1]]
    moves = float(np.ptp(known)) if known.size else 0.0
    if 0.0 < moves < 1.0 / LARGEST:
        raise InvalidArgumentError(f"{name} moves by {moves:.2g} only, whose square leaves float64: change its unit")


def _working_point(name: str, value: WorkingPoint) -> WorkingPoint:
    return one_of(name, value, ("first", "mean")) if isinstance(value, str) else finite(name, value)


def _level(offset: WorkingPoint, signal: FloatArray) -> float:
    levels: dict[WorkingPoint, float] = {"first": float(signal[0]), "mean": float(signal.mean())}
    return float(levels.get(offset, offset))


def centre(preprocess: Preprocess, u: FloatArray, y: FloatArray) -> Preprocess:
    """Return the same with the record's mean, without outliers, as working point."""
    # a constant is estimated with G(s), so any working point is right; one near the data conditions the regression well
    mapped = preprocess.map_input(u)
    accepted, _ = screen(mapped, y)
    if not accepted.any():
        return preprocess
    level = float(without_spikes(y[accepted]).mean())
    return Preprocess(preprocess.input_map, float(mapped[accepted].mean()), level)
