"""The unit of time stamps: stated in the column's name; where nothing is stated, what the stamps themselves tell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from replant.arguments import FloatArray
from replant.data.logs.sampling_time import has_unit, unit_in_seconds
from replant.errors import LogError, shown
from replant.interop.units import unit_of

LATEST = 1e11  # stamp beyond which the unit cannot be the one taken: in seconds since 1970 it is the year 5138 [s]
COARSE = 1.0  # interval of stamps without a unit from which on they may be counts of ms, us or ns [their unit]

_COUNTS = ((1e-3, "milliseconds", "ms"), (1e-6, "microseconds", "us"), (1e-9, "nanoseconds", "ns"))
_REMEDY = "or give the sampling time (dt, --dt) instead of a time column"


@dataclass(frozen=True)
class StampUnit:
    """The unit of a column of time stamps.

    Attributes
    ----------
    seconds : float
        One unit in s: as the name states it, else the likely one.
    doubt : str
        What is guessed, and why; empty if the unit is stated.
    refused : bool
        Whether the doubt is so grave that these stamps are not used.
    remedy : str
        What to do about the doubt.
    """

    seconds: float
    doubt: str = ""
    refused: bool = False
    remedy: str = ""


def unit_of_stamps(name: str, stamps: FloatArray) -> StampUnit:
    """Return the unit of the time stamps (K,) in the column ``name``.

    Examples
    --------
    >>> unit_of_stamps("t [ms]", np.array([0.0, 20.0])).seconds
    0.001
    >>> unit_of_stamps("t", np.array([0.0, 20.0])).doubt
    'its name states no unit; its steps of 20 are taken as seconds, and may be milliseconds or less'
    >>> unit_of_stamps("timestamp", 1.7e12 + np.array([0.0, 20.0])).seconds
    0.001
    """
    unit, known = unit_in_seconds(name), has_unit(name)
    stated = unit_of(name)
    if stated and not known:
        doubt = f"the unit {shown(stated)} in its name is not one of s, ms, us, ns, min, h"
        return StampUnit(unit, doubt, True, f"write one of these, {_REMEDY}")
    finite = stamps[np.isfinite(stamps)]
    farthest = float(np.abs(finite).max()) if finite.size else 0.0
    if farthest * unit > LATEST:
        taken = "its stamps in the unit of its name" if known else "its name states no unit, and its stamps in seconds"
        for seconds, words, short in _COUNTS:
            if farthest * seconds <= LATEST:
                doubt = f"{taken} are beyond the year 5000; by their size they are {words} since 1970"
                return StampUnit(seconds, doubt, True, f"name the column {_core(name)}_{short}, {_REMEDY}")
    if not known and (step := _usual_step(finite)) >= COARSE:
        doubt = (
            f"its name states no unit; its steps of {step:.6g} are taken as seconds, and may be milliseconds or less"
        )
        remedy = f"if they are, name the column {_core(name)}_ms, {_REMEDY}"
        return StampUnit(unit, doubt, False, remedy)
    return StampUnit(unit)


def check_unit(path: Path, name: str, stamps: FloatArray) -> None:
    """Check that the unit of time stamps (K,) can be the one taken."""
    unit = unit_of_stamps(name, stamps)
    if unit.refused:
        raise LogError(f"{path}: column {shown(name)}: {unit.doubt}; {unit.remedy}")


def _usual_step(stamps: FloatArray) -> float:
    with np.errstate(over="ignore"):
        return float(np.median(np.diff(stamps))) if stamps.size > 1 else 0.0


def _core(name: str) -> str:
    """Return a column's name without struct and unit, as a part of another name."""
    return name.rpartition(".")[2].partition("[")[0].partition("(")[0].strip().replace(" ", "_") or "t"
