"""The inspection of a log as a JSON object, and as text for the terminal."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from typing import Any

import numpy as np

from replant.fitting.log_inspection import UNKNOWN, Inspection, lacking, options_of
from replant.fitting.model_json import finite
from replant.logs.column_roles import Role
from replant.logs.columns import Column, Kind, counts_rows
from replant.logs.sampling_time import time_candidates
from replant.numerics.limits import typed_path
from replant.plotting.numbers import duration, interval, wrapped
from replant.verdict.evidence import COPY, is_copy
from replant.verdict.verdict import percent as share

FEW = 8  # most different values whose number is shown, and most columns of other lengths or problems listed [count]
LISTED = 30  # most columns in the table [count]
STEADY = 1e-3  # largest jitter of a clock that is called regular [part of dt]
INDENT = 11  # indent of the text below the table [columns]
NOTHING = "-"
_PUT_DT = f"put the sampling time in s in place of {UNKNOWN} in --dt {UNKNOWN}"
HEADINGS = ("column", "type", "min", "max", "missing", "smallest step", "looks like")
RIGHT = ("min", "max", "missing")


def command_of(found: Inspection) -> str:
    """Return the command of a first fit; empty if no input and output were found."""
    options = options_of(found)
    return shlex.join(["replant", "fit", typed_path(found.table.path), *options]) if options else ""


def as_json(found: Inspection) -> dict[str, Any]:
    """Return the JSON object of `look`; unknown figures are null."""
    clock, seen = found.clock, found.response
    roles = {name: {"column": role.column.name, "why": role.why} for name, role in _roles(found).items()}
    dt = math.nan if clock is None else clock.dt
    return {
        "path": str(found.table.path),
        "rows": found.rows,
        "complete": found.contents.whole,
        "columns": [_column(column, found) for column in found.contents.columns],
        "clock": None if clock is None else {
            "column": None if clock.column is None else clock.column.name,
            "guess": clock.guess or None,
            "unit_in_seconds": clock.unit,
            "unit_doubt": clock.doubt or None,
            "dt": finite(clock.dt),
            "jitter": finite(clock.jitter),
            "gaps": clock.gaps,
            "longest_interval": finite(clock.longest),
            "not_rising": clock.backward,
            "duration": finite(clock.duration),
            "problem": clock.problem or None,
        },
        "guess": dict.fromkeys(("input", "output", "reference")) | roles,
        "controller_suspected": found.roles.answers,
        "direction_unsure": found.roles.either,
        "response": None if seen is None else {
            "delay": finite(seen.delay * dt),
            "peak": finite(seen.peak * dt),
            "delay_samples": seen.delay,
            "correlation": seen.correlation,
        },
        "first_model": None if found.first is None else {
            "delay": finite(found.first.delay),
            "time_constant": finite(found.first.time_constant),
            "fit": finite(found.first.fit),
        },
        "others": [{"column": other.name, "explains": finite(other.left)} for other in found.others],
        "command": command_of(found) or None,
    }  # fmt: skip


def _column(column: Column, found: Inspection) -> dict[str, Any]:
    return {
        "number": column.number,
        "name": column.name,
        "type": column.kind.value,
        "rows": column.rows,
        "missing": column.missing,
        "min": finite(column.low),
        "max": finite(column.high),
        "values": column.levels,
        "step": finite(column.step),
        "quantised": column.quantised,
        "looks_like": looks_like(column, found) or None,
        "problem": column.problem or None,
    }


def looks_like(column: Column, found: Inspection) -> str:
    """Return the role of a column: time, part of a time, input, output, reference, or empty."""
    if column.kind is Kind.PART:
        return "part of a time"
    if found.clock is not None and column == found.clock.column:
        return "time"
    return next((name for name, role in _roles(found).items() if role.column == column), "")


def _roles(found: Inspection) -> dict[str, Role]:
    """Return the columns that were found, by their roles."""
    named = {"input": found.roles.input, "output": found.roles.output, "reference": found.roles.reference}
    return {name: role for name, role in named.items() if role is not None}


def print_look(console: Any, found: Inspection) -> None:
    """Print columns, clock, guesses and the suggested command."""
    print_findings(console, found)
    console.print()
    _say(console, command_of(found) or f"No command to suggest: {lacking(found)}.")


def print_findings(console: Any, found: Inspection) -> None:
    """Print columns, clock and guesses."""
    rows = _counted(found.rows, "row")
    if not found.contents.whole:
        rows = f"the first {found.rows:,} of about {max(found.rows, found.table.approximate_rows):,} rows"
    size = f"{rows}, {_counted(len(found.contents.columns), 'column')}"
    _say(console, f"{found.table.path}: {size}")
    console.print()
    for line in [*_lines_of_table(found), *_other_columns(found)]:
        _say(console, line)
    console.print()
    for heading, text in findings_of(found):
        for at, line in enumerate(wrapped(text, console.width - INDENT)):
            _say(console, f"{heading if at == 0 else '':{INDENT}}{line}")


def _counted(count: int, what: str) -> str:
    """Return a count with its noun, in the plural if needed."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def _say(console: Any, text: str) -> None:
    console.print(text.rstrip(), highlight=False, markup=False, soft_wrap=True)


def _lines_of_table(found: Inspection) -> list[str]:
    """Return the table's lines, never wrapped: names must stay in one piece for use in commands."""
    rows = [HEADINGS]
    for column in found.record[:LISTED]:
        low, high = (NOTHING if math.isnan(value) else f"{value:.6g}" for value in (column.low, column.high))
        missing = NOTHING if column.problem else f"{column.missing:,}"
        role = looks_like(column, found)
        rows.append((column.name, column.kind.value, low, high, missing, _resolution(column), role))
    widths = [max(len(cell) for cell in cells) for cells in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.rjust(width) if heading in RIGHT else cell.ljust(width)
            for heading, cell, width in zip(HEADINGS, row, widths, strict=True)
        )
        for row in rows
    ]


def _resolution(column: Column) -> str:
    if math.isnan(column.step):
        return NOTHING
    if column.levels <= FEW:
        return f"{column.step:.4g} ({column.levels} values)"
    return f"{column.step:.4g}" + (" (quantised)" if column.quantised else "")


def _other_columns(found: Inspection) -> Iterator[str]:
    """Yield lines on columns that the table leaves out, and on columns without numbers."""
    if len(found.record) > LISTED:
        yield f"... and {len(found.record) - LISTED} more columns of this length"
    others = [column for column in found.contents.columns if column not in found.record]
    if others:
        shown = ", ".join(f"{column.name} ({column.rows:,})" for column in others[:FEW])
        more = f", ... ({len(others) - FEW} more)" if len(others) > FEW else ""
        yield f"Of other lengths: {shown}{more}"
    for column in [column for column in found.record if column.problem][:FEW]:
        yield f"{'Part of a time' if column.kind is Kind.PART else 'Not numbers'}: {column.problem}"


def findings_of(found: Inspection) -> Iterator[tuple[str, str]]:
    """Yield findings on clock, roles and response with their headings; a continued finding has an empty heading."""
    yield from _clock_findings(found)
    roles = found.roles
    for name, role in _roles(found).items():
        guess = role.why if role.why == "as given" else f"a guess, from: {role.why}"
        yield name.capitalize(), f"{role.column.name} ({guess})"
    if roles.input is None or roles.output is None:
        yield "Input", "fewer than two columns of changing numbers: there is no input and output"
        return
    if roles.either:
        yield "", "Input and output could equally be exchanged: name them with -i and -o."
    if roles.answers and roles.reference is None:
        follows = "The input also follows the output, as under a controller"
        yield "", f"{follows}: if there is one, give its set-point as --reference."
    yield "Response", _response(found)
    if found.doubted:
        rows = f"{_counted(found.doubted, 'output')} {'is' if found.doubted == 1 else 'are'}"
        yield (
            "",
            f"{rows} left out of it, as of a fit: far from all others, or equal to the bit for too long for chance.",
        )
    for heading, other in zip(["Others"] + [""] * len(found.others), found.others, strict=False):
        what = f"column {other.name} explains {share(min(other.left, 1.0))} of the residual of a model with one pole"
        yield heading, f"{what}: it seems to move {roles.output.column.name}, too."


def _clock_findings(found: Inspection) -> Iterator[tuple[str, str]]:
    clock = found.clock
    if clock is None:
        dated = [column.name for column in found.contents.columns if column.problem and time_candidates([column.name])]
        named = f"column {dated[0]!r} holds no numbers" if dated else "no column is called t, time or timestamp"
        counting = [column.name for column in found.contents.columns if counts_rows(column, found.contents)]
        named += f", {counting[0]!r} counts the rows, and no other" if counting else ", and none"
        yield "Clock", f"{named} rises in equal steps{f': {_PUT_DT}' if command_of(found) else ''}"
        return
    name = "Ts, a number in the file" if clock.column is None else clock.column.name
    if math.isnan(clock.dt):
        yield "Clock", f"{name}: {clock.problem}"
        if command_of(found):
            yield "", f"Otherwise {_PUT_DT}."
        return
    steady = clock.jitter <= STEADY * clock.dt
    jitter = "regular" if steady else f"jitter {interval(clock.jitter)} ({share(clock.jitter / clock.dt)})"
    gaps = f"{_counted(clock.gaps, 'gap')}, the longest {interval(clock.longest)}"
    back = f"{_counted(clock.backward, 'stamp')} missing, repeated or going back"
    known = [f"dt {interval(clock.dt)}", duration(clock.duration), jitter]
    known += ([gaps] if clock.gaps else []) + ([back] if clock.backward else [])
    yield "Clock", f"{name}: {', '.join(known)}"
    if clock.guess:
        yield "", f"That this is the time is a guess: {clock.guess}."
    if clock.doubt:
        yield "", f"The unit is a guess: {clock.doubt}."
    elif clock.problem:
        yield "", f"Its stamps are not used as they are: {clock.problem}."
    if clock.shuffled:
        yield "", "All that is shown here is of the rows in the order of time."
    elif clock.problem:
        missing = ", as if none were missing" if clock.gaps else ""
        yield "", f"The command counts samples instead, --dt {clock.dt:.6g}{missing}."


def _response(found: Inspection) -> str:
    seen, roles = found.response, found.roles
    assert roles.input is not None
    assert roles.output is not None
    pair = f"{roles.output.column.name} to changes of {roles.input.column.name}"
    u, y = (found.contents.values[role.column.number] for role in (roles.input, roles.output))
    known = np.isfinite(u) & np.isfinite(y) if u.size == y.size else np.zeros(0, bool)
    if known.size and is_copy(u[known], y[known]):
        return f"of {pair}: none, {COPY}"
    if found.first is not None:
        first = found.first
        dead = f"begins after {interval(float(f'{first.delay:.2g}'))}" if first.delay > 0.0 else "begins at once"
        return (
            f"of {pair}: {dead}, with a time constant of {interval(float(f'{first.time_constant:.2g}'))}; a model of "
            f"one pole explains the output to {share(first.fit / 100.0)}"
        )
    if seen is None:
        return f"no response of {pair} is significant: neither in the cross-correlation, nor with a model of one pole"
    dt = math.nan if found.clock is None else found.clock.dt

    def lag(samples: float) -> str:
        return f"{samples:.3g} samples" if math.isnan(dt) else interval(samples * dt)

    if seen.peak == 0:
        begins = (
            "is in the same row: the input depends on the output of that row, as under a controller, or the output is "
            "recorded after the input has acted"
        )
    else:
        begins = "begins with the next row" if seen.delay < 1.0 else f"begins after {lag(float(f'{seen.delay:.2g}'))}"
    at = f"; the cross-correlation is largest, {seen.correlation:.2f}, after {lag(seen.peak)}"
    loop = roles.answers or roles.reference is not None
    mixed = "; under a controller this mixes both directions" if loop else ""
    return f"of {pair}: {begins}{at}{mixed}"
