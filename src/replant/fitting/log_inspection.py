"""Inspect a log: its columns and their roles, its clock, and the options of a first fit."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from replant.errors import ReplantError
from replant.kernels.schema import Doubt
from replant.logs.column_roles import INPUT, OUTPUT, Response, Roles, find_roles, prepared, response
from replant.logs.columns import Clock, Column, Contents, describe, find_clock, read_contents, seems_time
from replant.logs.conditioning import from_rest
from replant.logs.file_formats import read_columns
from replant.logs.log import Log
from replant.logs.merged_channels import held_where_empty, side_by_side
from replant.logs.read import with_repeats_noted
from replant.logs.recording import Recording
from replant.logs.sampling_time import is_shuffled
from replant.logs.table import Table, repeated_rows
from replant.model.preprocess import Preprocess
from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.verdict.assess import MOST_SAMPLES
from replant.verdict.other_columns import OtherColumn, other_columns
from replant.verdict.reasons import POOREST_FIT

MOST_SAMPLES_OF_FIRST = 1000  # samples that a first model is made from: evenly spaced ones of a longer record [samples]
DELAYS = 6  # dead times that it tries besides 0, from a sample to a quarter of the record, by equal factors [count]


@dataclass(frozen=True)
class FirstModel:
    """A model of one pole that the verdict trusts."""

    delay: float  # dead time in s
    time_constant: float  # in s
    fit: float  # fit of the simulated output in percent


def first_model(u: FloatArray, y: FloatArray, dt: float) -> FirstModel | None:
    """Return the model of one pole and a dead time for a step test, where correlation fails; None if not trusted."""
    from replant.fitting.structure_search import search

    every = -(-u.size // MOST_SAMPLES_OF_FIRST)
    u, y, dt = u[::every], y[::every], dt * every
    u = np.where(np.isfinite(u), u, np.nan)
    if u.size < 2 * DELAYS or not np.isfinite(u).any() or not np.nanmax(u) > np.nanmin(u):
        return None
    delays = dt * np.unique([0.0, *np.geomspace(1.0, u.size / 4, DELAYS).round()])
    log = Log(u, y, dt)
    for begins in (lambda log: log, from_rest):  # with a step at the begin, the gain is known only from rest
        try:
            found = search(begins(log), poles=1, zeros=0, delays=delays.tolist()).best
        except ReplantError:
            continue
        if found.verdict.status == "trusted":
            slowest = found.transfer_function.modes[0].time_constant
            return FirstModel(found.structure.delay, slowest, found.simulation.fit)
        if found.simulation.fit < POOREST_FIT:  # from rest, without an initial state, it would explain less
            return None
    return None


def with_others(recording: Recording) -> Recording:
    """Return a recording whose log in memory has the other columns of numbers that change, and are as long."""
    log, names = recording.held, recording.table.names
    roles = set() if log is None else {log.input_name, log.output_name, log.reference_name}
    if log is None or not set(names) - roles:
        return recording
    contents = read_contents(recording.table)
    times = {recording.clock, *recording.table.in_seconds}  # a date is no signal: neither a cause nor a set-point
    others = {
        column.name: contents.values[column.number]
        for column in contents.columns
        if column.is_signal and column.rows == log.input.size and column.name not in roles
        and names.count(column.name) == 1 and column.number not in times
    }  # fmt: skip
    return replace(recording, held=replace(log, others={**others, **log.others}))


def beside_first_model(
    u: FloatArray, y: FloatArray, dt: float, delay: float, others: Mapping[str, FloatArray]
) -> tuple[OtherColumn, ...]:
    """Return the columns that explain a part of the residual of a model of one pole; none if there is no model."""
    from replant.estimation.solver.solve import solve
    from replant.fitting.samples import Samples

    if not others:
        return ()
    rows = slice(0, MOST_SAMPLES)
    u, y = u[rows], y[rows]
    try:
        structure = Structure(poles=1, delay=delay)
        about_means = Preprocess("identity", "mean", "mean")
        raw, _, _ = Samples(u, y, dt, None, None).checked(structure, dt, "zoh", about_means)
        # no search for loads: a load may be what another column shows
        solution = solve(structure, raw.made_ready(None))
    except ReplantError:
        return ()
    if solution is None:
        return ()
    shown = {name: signal[rows][raw.made_use_of] for name, signal in others.items()}
    return other_columns(structure, solution.found.theta[: structure.size], solution.record, dt, shown)


POLES = 2  # poles of the model that is suggested first [count]
# the slow begin of two equal poles reaches 0.6
DEAD = 1.0  # least delay that is a dead time, not a slow begin [part of the time from there to half the response]
CLEAR = 3.0  # delay from which on a search for the dead time is suggested [samples]
TRIED = 6  # dead times that this search tries [count]
UNKNOWN = "S"  # stands for a sampling time that nothing tells: no command runs with it


@dataclass(frozen=True, eq=False)
class Inspection:
    """The content of a log."""

    table: Table  # the file
    contents: Contents  # its columns with their values
    record: tuple[Column, ...]  # the columns of the record: those as long as the time, or of the most frequent length
    clock: Clock | None
    roles: Roles
    response: Response | None  # of the output to the input
    time_given: bool = False  # whether the time column was given
    doubted: int = 0  # outputs that the response leaves out, as a fit leaves them out: gross, or of a stuck sensor
    # further columns that explain a part of the residual of a first model
    others: tuple[OtherColumn, ...] = ()
    # a model of one pole, where the input moves too seldom for a correlation, as in a step test
    first: FirstModel | None = None

    @property
    def rows(self) -> int:
        """The number of rows of the record."""
        return max((column.rows for column in self.record), default=0)

    @property
    def delay(self) -> float | None:
        """Lag at which the response seems to begin, in s; None if unknown."""
        if self.first is not None:
            return float(f"{self.first.delay:.2g}")
        if self.response is None or self.clock is None or math.isnan(self.clock.dt):
            return None
        return float(f"{self.response.delay * self.clock.dt:.2g}")


def inspect(
    path: str | os.PathLike[str],
    *,
    input: str | int | None = None,  # noqa: A002 - the field's word
    output: str | int | None = None,
    time: str | int | None = None,
) -> Inspection:
    """Return the content of a log file; guesses are marked as such."""
    read = read_columns(path)
    table = side_by_side(read)
    own = None if table is read else len(table.names) - 1  # the time of channels with stamps of their own
    given = {role: table.find(key) for role, key in ((INPUT, input), (OUTPUT, output)) if key is not None}
    for number in given.values():
        table.column(number)  # raises, with the place of the cell that is no number
    contents = read_contents(table)
    raw = contents.values
    contents = replace(contents, values={number: held_where_empty(each) for number, each in raw.items()})
    is_held = any(each is not raw[number] for number, each in contents.values.items())
    clock = find_clock(table, contents, own if time is None else table.find(time), set(given.values()))
    contents, clock = _in_order(table, contents, clock)
    table, contents, clock = _without_repeats(table, contents, clock, is_held=is_held)
    record = _record(contents, clock, given)
    signals = [column for column in record if column.is_signal and (clock is None or column != clock.column)]
    # without further clocks, which rise in nearly equal steps, if two signals remain
    moving = [column for column in signals if column.number in given.values() or not seems_time(column, contents)]
    signals = moving if len(moving) > 1 else signals
    roles = find_roles(signals, contents.values, given)
    seen, first, doubted = None, None, 0
    if roles.input and roles.output:
        u, y = (contents.values[role.column.number] for role in (roles.input, roles.output))
        left, doubted = _without_doubted(u, y)
        heads = prepared(u), prepared(left)
        seen = response(*heads) if heads[0].size == heads[1].size else None
        first = first_model(u, y, _sampling_time(clock)) if seen is None and u.size == y.size else None
    found = Inspection(table, contents, record, clock, roles, seen, time is not None, doubted=doubted, first=first)
    return replace(found, others=_others(found, signals))


def _without_doubted(u: FloatArray, y: FloatArray) -> tuple[FloatArray, int]:
    """Return an output (K,) without those that a fit leaves out before it has a model, and their number."""
    from replant.estimation.solver.bad_samples import suspicious

    if u.size != y.size:
        return y, 0
    left_out = np.isin(suspicious(u, y), (Doubt.OUTLIER, Doubt.STUCK))
    return np.where(left_out, np.nan, y), int(np.count_nonzero(left_out))


def _in_order(table: Table, contents: Contents, clock: Clock | None) -> tuple[Contents, Clock | None]:
    """Return columns and clock in the order of time, if the rows of the file are not; the clock keeps the problem."""
    if clock is None or clock.column is None or not is_shuffled(t := contents.values[clock.column.number]):
        return contents, clock
    order = np.argsort(t, kind="stable")
    values = contents.values | {n: each[order] for n, each in contents.values.items() if each.size == t.size}
    columns = tuple(
        each if each.number not in values else describe(each.number, each.name, values[each.number])
        for each in contents.columns
    )
    contents = replace(contents, columns=columns, values=values)
    found = find_clock(table, contents, clock.column.number)
    assert found is not None
    return contents, replace(found, guess=clock.guess, backward=clock.backward, problem=clock.problem, shuffled=True)


def _without_repeats(
    table: Table, contents: Contents, clock: Clock | None, *, is_held: bool
) -> tuple[Table, Contents, Clock | None]:
    """Return columns and clock without repeated rows; if ``is_held``, without all but the last row of a stamp."""
    # where columns have rows of their own, the last row of a stamp has all values that are known then
    if clock is None or clock.column is None or not clock.problem or clock.shuffled:
        return table, contents, clock
    t = contents.values[clock.column.number]
    beside = {number: each for number, each in contents.values.items() if each.size == t.size}
    repeated = np.flatnonzero(t[1:] == t[:-1]) if is_held else repeated_rows(t, list(beside.values()))
    if not repeated.size:
        return table, contents, clock
    values = contents.values | {number: np.delete(each, repeated) for number, each in beside.items()}
    columns = tuple(
        describe(each.number, each.name, values[each.number])
        if each.number in values
        else replace(each, rows=each.rows - repeated.size, missing=each.missing - repeated.size)
        for each in contents.columns
    )
    contents = Contents(columns, values, contents.whole)
    found = find_clock(table, contents, clock.column.number)
    table = table if is_held else with_repeats_noted(table, repeated.size)
    return table, contents, None if found is None else replace(found, guess=clock.guess)


def _others(found: Inspection, signals: list[Column]) -> tuple[OtherColumn, ...]:
    """Return the other signals that explain a part of the residual of a model of one pole."""
    u, y, r = found.roles.input, found.roles.output, found.roles.reference
    if (found.response is None and found.first is None) or u is None or y is None:
        return ()
    values, known = found.contents.values, {each.column.number for each in (u, y, r) if each is not None}
    others = {each.name: values[each.number] for each in signals if each.number not in known}
    dt = _sampling_time(found.clock)
    delay = math.floor(found.response.delay) * dt if found.response is not None else found.first.delay  # type: ignore[union-attr]
    return beside_first_model(values[u.column.number], values[y.column.number], dt, delay, others)


def _sampling_time(clock: Clock | None) -> float:
    """Return the sampling time in s, or 1 where time is counted in samples."""
    return 1.0 if clock is None or math.isnan(clock.dt) else clock.dt


def _record(contents: Contents, clock: Clock | None, given: dict[str, int]) -> tuple[Column, ...]:
    """Return the columns of the record's length, also those of text."""
    sizes = [contents.values[number].size for number in given.values()]
    sizes += [clock.column.rows] if clock is not None and clock.column is not None else []
    length = sizes[0] if sizes else contents.usual_length
    return tuple(column for column in contents.columns if column.rows == length)


def lacking(found: Inspection) -> str:
    """Return what a log lacks for a first fit; empty if nothing."""
    if found.rows < 2:
        counted = "1 row" if found.rows == 1 else f"{found.rows} rows"
        return f"{counted} of data, at least 2 are needed; record more samples"
    if found.clock is not None and found.clock.shuffled:
        return "sort the rows by time first"
    if found.roles.input is None or found.roles.output is None:
        return "name two columns of changing numbers with --input and --output"
    least = Structure(_poles(found)).size + 1
    if found.rows < least:
        return f"{found.rows} rows of data, a first fit needs {least}; record more samples"
    return ""


def _poles(found: Inspection) -> int:
    """Return the number of poles of the first fit."""
    return POLES if found.first is None else 1


def options_of(found: Inspection) -> tuple[str, ...]:
    """Return the options of a first fit: columns, poles, clock, dead time; empty if `lacking` says what is missing."""
    u, y, r = found.roles.input, found.roles.output, found.roles.reference
    if u is None or y is None or lacking(found):
        return ()
    words = ["-i", key_of(found.table, u.column), "-o", key_of(found.table, y.column), "-p", str(_poles(found))]
    if r is not None:
        words += ["--reference", key_of(found.table, r.column)]
    return (*words, *clock_options(found), *_delay_options(found))


def clock_options(found: Inspection) -> tuple[str, ...]:
    """Return the option that gives the sampling time, where the time column does not; `UNKNOWN` if nothing tells it."""
    clock = found.clock
    if clock is None or math.isnan(clock.dt):
        return ("--dt", UNKNOWN)
    if clock.problem:
        return ("--dt", f"{clock.dt:.6g}")
    if clock.column is None or not (clock.guess or found.time_given):
        return ()
    return ("--time", key_of(found.table, clock.column))


def _delay_options(found: Inspection) -> tuple[str, ...]:
    """Return a range of dead times about that of the response, if it begins later than without a dead time."""
    seen, dt = found.response, 1.0 if found.clock is None else found.clock.dt
    delay = 0.0 if found.first is None else found.first.delay
    if not delay > 0.0:
        if seen is None or math.isnan(dt) or seen.delay < max(CLEAR, DEAD * (seen.half - 1 - seen.delay)):
            return ()
        delay = seen.delay * dt
    step = rounded_up(1.5 * delay / (TRIED - 1))
    return ("--delay", f"0:{step * (TRIED - 1):.6g}:{step:.6g}")


def rounded_up(value: float) -> float:
    """Return a positive number with one digit, not less than ``value``."""
    size = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.ceil(value / size - 1e-9) * size:.6g}")


def key_of(table: Table, column: Column) -> str:
    """Return how an option names a column: by its name, or by its number if the name is odd or not unique."""
    alone = sum(name == column.name for name in table.names) == 1
    plain = column.name.isprintable() and column.name.strip() == column.name and not column.name.startswith("-")
    return column.name if alone and plain else str(column.number)
