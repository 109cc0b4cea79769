"""Time stamps in two columns, as of ROS: whole seconds, and the rest of a second in a finer unit."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from replant.errors import LogError
from replant.logs.sampling_time import UNITS, mostly_rise
from replant.logs.table import Arrays, Table
from replant.numerics.arguments import FloatArray

_PART = re.compile(rf"(?:(.*)[./_ ])?({'|'.join(UNITS)})", re.IGNORECASE)
_ROWS = 1 << 10  # first rows that decide whether two columns are one clock [rows]


def with_split_times(table: Table) -> Table:
    """Return a table in which columns of whole seconds hold the sum with the column of the rest, in s from row 1."""
    rests = {
        seconds: (rest, unit, origin)
        for seconds, rest, unit in _pairs(table.names)
        if not {seconds, rest} & table.in_seconds and (origin := _origin(table, seconds, rest, unit)) is not None
    }
    if table.stamps is not None or not rests:
        return table
    whole_of = {rest: seconds for seconds, (rest, _, _) in rests.items()}

    def blocks(numbers: Sequence[int]) -> Iterator[Arrays]:
        for number in numbers:
            if number in whole_of:  # it goes back every second: neither a clock by itself, nor a signal
                whole = table.names[whole_of[number]]
                raise table.error(number, f" is the rest of the seconds in column {whole!r}, which has the sum")
        split = [number for number in numbers if number in rests]
        for block in table.blocks([*numbers, *(rests[number][0] for number in split)]):
            further = dict(zip(split, block[len(numbers) :], strict=True))
            yield [
                _sum(column, further[number], *rests[number][1:]) if number in further else column
                for number, column in zip(numbers, block[: len(numbers)], strict=True)
            ]

    origins = {number: round(1e9 * origin) for number, (_, _, origin) in rests.items()}
    return replace(
        table,
        blocks=blocks,
        in_seconds=table.in_seconds | set(rests),
        parts=frozenset(whole_of),
        origins={**table.origins, **origins},
    )


def _pairs(names: Sequence[str]) -> Iterator[tuple[int, int, float]]:
    """Yield columns of seconds, each with the one column of a finer unit that has the same name but for the unit."""
    parts: dict[str, dict[float, list[int]]] = {}
    for number, name in enumerate(names):
        if found := _PART.fullmatch(name.strip()):
            of, unit = parts.setdefault((found[1] or "").casefold(), {}), UNITS[found[2].lower()]
            of.setdefault(unit, []).append(number)
    for of in parts.values():
        finer = [(number, unit) for unit, numbers in of.items() if unit < 1.0 for number in numbers]
        if len(of.get(1.0, [])) == 1 and len(finer) == 1:
            yield of[1.0][0], *finer[0]


def _origin(table: Table, seconds: int, rest: int, unit: float) -> float | None:
    """Return the first whole second; None if the columns are not whole seconds and a rest below one, that advance.

    They may begin anew, as the seconds of a minute do: who reads them as a time says so, with the line.
    """
    try:
        whole, further = table.head([seconds, rest], _ROWS)
    except LogError:  # they hold no numbers
        return None
    known = np.isfinite(whole) & np.isfinite(further)
    whole, further = whole[known], further[known] * unit
    is_split = whole.size and (whole == np.rint(whole)).all() and ((further >= 0.0) & (further < 1.0)).all()
    steps = np.diff(whole + further)
    return float(whole[0]) if is_split and (steps > 0.0).any() and mostly_rise(steps) else None


def _sum(seconds: FloatArray, rest: FloatArray, unit: float, origin: float) -> FloatArray:
    """Return stamps (K,) in s; without the seconds of the first one, a nanosecond would be lost in rounding."""
    return np.asarray((seconds - origin) + unit * rest)
