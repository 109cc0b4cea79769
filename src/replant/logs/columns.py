"""Description of a log's columns (kind, range, resolution) and of its clock (interval, jitter, gaps); advice on it."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from enum import Enum

import numpy as np

from replant.errors import LogError, ReplantError, shown
from replant.logs.sampling_time import MOSTLY, interval_of, time_columns, unit_of_column
from replant.logs.table import Table, listed
from replant.numerics.arguments import BoolArray, FloatArray

MOST_CELLS = 1 << 24  # most cells of a log held at once: 128 MB [count]
MOST_ROWS = 1 << 20  # rows of a log that are examined [rows]
FEWEST_ROWS = 1 << 10  # fewest rows that are examined, if a log has very many columns [rows]
MOST_STEPS = 10_000  # most steps in the range of a column that is called quantised: at most 13 bits [count]
ROUND_OFF = 1e-9  # difference of two values that is a rounding error [part of the largest value]
ON_GRID = 0.01  # largest distance of a value from its grid [part of the grid's step]


class Kind(Enum):
    """What a column holds."""

    WHOLE = "whole"
    REAL = "real"
    CONSTANT = "constant"
    EMPTY = "empty"
    TEXT = "text"
    PART = "part"  # of the stamps in another column, as the nanoseconds beside the seconds


@dataclass(frozen=True)
class Column:
    """What one column of a log holds."""

    number: int  # its 0-based number
    name: str  # its name in the file
    kind: Kind
    rows: int  # rows that were examined
    missing: int  # examined rows without a finite number
    low: float = np.nan  # low, high: the smallest and the largest value; NaN if there is none
    high: float = np.nan
    levels: int = 0  # number of different values
    step: float = np.nan  # the smallest difference of two different values; NaN if all are equal
    quantised: bool = False  # whether all values lie on a grid of this step, with at most `MOST_STEPS` steps
    held: float = 0.0  # part of the rows that repeat the previous value
    problem: str = ""  # why a column of text, or a part of stamps, cannot be read as numbers; empty for other columns

    @property
    def is_signal(self) -> bool:
        """Whether the column holds numbers that change."""
        return self.kind in (Kind.WHOLE, Kind.REAL)


def describe(number: int, name: str, values: FloatArray) -> Column:
    """Describe a column of numbers ``values`` (K,)."""
    known = values[np.isfinite(values)]
    missing = int(values.size - known.size)
    if not known.size:
        return Column(number, name, Kind.EMPTY, int(values.size), missing)
    levels = np.unique(known)
    with np.errstate(over="ignore"):
        steps = np.diff(levels)
    steps = steps[steps > ROUND_OFF * max(abs(float(levels[0])), abs(float(levels[-1])))]
    step = float(f"{steps.min():.9g}") if steps.size else np.nan
    whole = bool((levels == np.rint(levels)).all())
    kind = Kind.CONSTANT if levels.size == 1 else Kind.WHOLE if whole else Kind.REAL
    held = float((known[1:] == known[:-1]).mean()) if known.size > 1 else 0.0
    return Column(
        number, name, kind, int(values.size), missing, float(levels[0]), float(levels[-1]), int(levels.size), step,
        _on_grid(levels, step), held,
    )  # fmt: skip


def _on_grid(levels: FloatArray, step: float) -> bool:
    if not 0.0 < step < np.inf:
        return False
    with np.errstate(over="ignore"):
        places = (levels - levels[0]) / step
    return bool(places[-1] <= MOST_STEPS and (np.abs(places - np.rint(places)) <= ON_GRID).all())


@dataclass(frozen=True, eq=False)
class Contents:
    """The described columns of a log, and the values of the numeric ones."""

    columns: tuple[Column, ...]
    values: dict[int, FloatArray]  # the values of each numeric column, by the column's number
    whole: bool  # whether all rows were examined

    @property
    def usual_length(self) -> int:
        """The most common length of the columns; the longer one if two are equally common."""
        sizes = [values.size for values in self.values.values()]
        return max(sizes, key=lambda size: (sizes.count(size), size), default=0)


def read_contents(table: Table) -> Contents:
    """Read as many first rows of a log as memory holds, and describe its columns: with a cell of text, as text."""
    names = table.names
    most = min(MOST_ROWS, max(FEWEST_ROWS, MOST_CELLS // max(1, len(names))))
    values: dict[int, FloatArray] = {}
    problems: dict[int, ReplantError] = {}
    try:
        values = dict(enumerate(table.head(range(len(names)), most + 1)))
    except ReplantError:  # then each column by itself
        for number in range(len(names)):
            try:
                (values[number],) = table.head([number], most + 1)
            except ReplantError as problem:
                problems[number] = problem
        if not values:
            raise problems[len(names) - 1] from None
    rows = max((min(column.size, most) for column in values.values()), default=0)
    columns = [
        _unread(table, number, rows, problems[number])
        if number in problems
        else describe(number, name, values[number][:most])
        for number, name in enumerate(names)
    ]
    whole = all(column.size <= most for column in values.values())
    return Contents(tuple(columns), {number: column[:most] for number, column in values.items()}, whole)


def _unread(table: Table, number: int, rows: int, problem: ReplantError) -> Column:
    kind = Kind.PART if number in table.parts else Kind.TEXT
    return Column(number, table.names[number], kind, rows, rows, problem=str(problem).removeprefix(f"{table.path}: "))


LAGS = 8  # past values of both signals: those of a controller and of the filter before it [samples]
EXACT = math.exp(-10.0)  # part of the input's power that is the rounding of the recorded output [part]


def is_computed(u: FloatArray, y: FloatArray) -> bool:
    r"""Return whether ``u`` (K,) follows from its own past and from ``y`` (K,) but for rounding, as of a controller.

    In a loop that only disturbances move, the output acts on the input as a plant's input acts on its output, and the
    recorded input adds nothing to the output's own past.  Both records differ in one respect: a controller computes
    each value from the past alone,

    .. math:: u_k = \sum_{i \ge 1} a_i u_{k-i} + \sum_{i \ge 0} b_i y_{k-i},

    and what a plant's sensor measures has noise.  A value that is rounded to steps q is off by q / 2 at most, so that
    of independent roundings at most :math:`q^2 (1 + \sum a_i^2) / 4` is left.
    """
    known = np.isfinite(u) & np.isfinite(y)
    if not known.any():
        return False
    (v, power), (w, _) = (_standard(signal, known) for signal in (u, y))
    past = [_before(v, lag) for lag in range(1, LAGS + 1)]
    columns = np.column_stack([np.ones(u.size), *past, *(_before(w, lag) for lag in range(LAGS + 1))])
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(v)
    if int(rows.sum()) <= 2 * columns.shape[1]:  # nearly any values would follow
        return False
    solution = np.linalg.lstsq(columns[rows], v[rows], rcond=1e-10)[0]
    left = float(np.mean((v[rows] - columns[rows] @ solution) ** 2))
    about = describe(0, "", u)
    step = about.step / power if about.quantised and power > 0.0 else 0.0
    rounding = 0.25 * step**2 * (1.0 + float(np.sum(solution[1 : LAGS + 1] ** 2)))
    return left <= EXACT + rounding


def _standard(signal: FloatArray, known: BoolArray) -> tuple[FloatArray, float]:
    """Return a signal (K,) with mean 0 and deviation 1 over the ``known`` samples, and its deviation before."""
    centred = signal - signal[known].mean()
    deviation = float(centred[known].std())
    return np.asarray(centred / deviation if deviation > 0.0 else centred), deviation


def _before(signal: FloatArray, lag: int) -> FloatArray:
    """Return a signal (K,) delayed by ``lag`` samples; NaN before its begin."""
    return np.concatenate([np.full(lag, np.nan), signal[: signal.size - lag]])


GAP = 1.5  # shortest interval of a steady clock that is a gap [usual intervals]
LOST = 3.5  # the same for a clock with jitter, as GAP of `replant.estimation.engine.record` [usual intervals]
STEADY = 0.2  # largest deviation of a steady interval [part of the median]
SINCE_1970 = 1e9  # stamp of September 2001: a column that never falls and is larger is taken for times since 1970 [s]
FEWEST = 20  # fewest rows of a time column without a name of time [rows]


@dataclass(frozen=True)
class Clock:
    """The time column of a log, or the sampling time that its file states."""

    column: Column | None  # None where the file states the sampling time
    guess: str  # why the column may not be the time; empty if it was given, or is the only one of `time_columns`
    unit: float  # one unit of its stamps in s
    doubt: str  # why the unit may be wrong; empty if it is stated
    dt: float  # the usual (median) interval in s; NaN without a rising step
    jitter: float  # standard deviation of the intervals without the gaps, in s
    gaps: int  # number of gaps
    longest: float  # the longest interval in s
    backward: int  # number of stamps that repeat, go back, or are missing
    duration: float  # from the first stamp to the last, in s
    problem: str  # why `replant run` would refuse these stamps; empty if it accepts them
    shuffled: bool = False  # whether the rows of the file are not in the order of time


def find_clock(
    table: Table, contents: Contents, given: int | None = None, others: Collection[int] = ()
) -> Clock | None:
    """Return the clock of a log; None without a column that is or seems to be its time."""
    if given is not None:
        return _clock(table, contents, contents.columns[given], "") if given in contents.values else None
    named = [number for number in time_columns(table) if number in contents.values and number not in others]
    fitting = [number for number in named if contents.values[number].size == contents.usual_length] or named
    if fitting:
        guess = f"{listed([table.names[number] for number in fitting])} could be it" if len(fitting) > 1 else ""
        return _clock(table, contents, contents.columns[fitting[0]], guess)
    if table.dt is not None and not time_columns(table):
        duration = table.dt * max(0, contents.usual_length - 1)
        return Clock(None, "", 1.0, "", table.dt, 0.0, 0, table.dt, 0, duration, "")
    free = [column for column in contents.columns if column.number not in others]
    seeming = (each for each in free if seems_time(each, contents) and not counts_rows(each, contents))
    # it never goes back, as part of a stamp does
    rising = next((each for each in seeming if np.diff(contents.values[each.number]).min() >= 0.0), None)
    guess = "no column is called t, time or timestamp, and this one rises in equal steps"
    return None if rising is None else _clock(table, contents, rising, guess)


def seems_time(column: Column, contents: Contents) -> bool:
    """Return whether a column rises in nearly equal steps, or seems to hold times since 1970."""
    if column.kind not in (Kind.WHOLE, Kind.REAL) or column.missing or column.rows < FEWEST:
        return False
    steps = np.diff(contents.values[column.number])
    usual = float(np.median(steps))
    if usual > 0.0 and column.low > SINCE_1970 and steps.min() >= 0.0:
        return True
    return usual > 0.0 and float((np.abs(steps - usual) <= STEADY * usual).mean()) >= MOSTLY


def counts_rows(column: Column, contents: Contents) -> bool:
    """Return whether a column only numbers the rows, from 0 or 1."""
    values = contents.values.get(column.number, np.empty(0))
    return bool(values.size >= FEWEST and values[0] in (0.0, 1.0) and (np.diff(values) == 1.0).all())


def _clock(table: Table, contents: Contents, column: Column, guess: str) -> Clock:
    stamps = contents.values[column.number]
    unit = unit_of_column(table, column.number, stamps)
    with np.errstate(invalid="ignore", over="ignore"):
        steps = np.diff(stamps)
    rises = np.flatnonzero(steps > 0.0)
    rising = steps[rises]
    usual = float(np.median(rising)) if rising.size else np.nan
    regular = rising[rising <= GAP * usual]
    if regular.size and regular.std() > STEADY * usual:
        regular = rising[rising <= LOST * usual]
    known, dt = stamps[np.isfinite(stamps)], usual
    if rising.size > 1 and np.count_nonzero(steps == 0.0) > rising.size:  # most rows repeat the stamp: it is too coarse
        first, last = rises[0] + 1, rises[-1] + 1
        dt = float((stamps[last] - stamps[first]) / (last - first))
    return Clock(
        column=column,
        guess=guess,
        unit=unit.seconds,
        doubt=unit.doubt,
        dt=float(f"{dt * unit.seconds:.9g}"),
        jitter=float(regular.std()) * unit.seconds if regular.size else np.nan,
        gaps=int(rising.size - regular.size),
        longest=float(rising.max()) * unit.seconds if rising.size else np.nan,
        backward=int(stamps.size - known.size + np.count_nonzero(np.diff(known) <= 0.0)),
        duration=float(known.max() - known.min()) * unit.seconds if known.size else np.nan,
        problem=unit.doubt if unit.refused else _refusal(table, column.number, stamps),
    )


def _refusal(table: Table, number: int, stamps: FloatArray) -> str:
    """Return why these stamps give no sampling time; empty if they give one."""
    if np.count_nonzero(np.isfinite(stamps)) < 2:
        return "fewer than two stamps"
    try:
        interval_of(table, number, stamps)
    except LogError as problem:
        return str(problem).removeprefix(f"{table.path}: ")
    return ""


MOST_OFF = 0.1  # difference of the usual interval from the given one that jitter makes [part of the sampling time]
GIVE_TIME = "name the time column (time, --time) or give the sampling time (dt, --dt)"


def time_advice(table: Table, taken: Collection[int]) -> str:
    """Return what to do without a column with a name of time; one that rises as a clock does is named."""
    found, there = find_clock(table, read_contents(table), others=taken), f"there are: {listed(table.names)}"
    likely = "" if found is None or found.column is None else f", perhaps {shown(found.column.name)},"
    return f"{GIVE_TIME.replace(' or ', f'{likely} or ')}; {there}"


def contradicted(table: Table, dt: float | None) -> str:
    """Return a note on a ``--dt`` in s that a table's time column contradicts; empty if none does."""
    interval = None if dt is None else stamped_interval(table)
    if dt is None or interval is None or abs(interval[1] / dt - 1.0) <= MOST_OFF:
        return ""
    column, usual = interval
    return f"{table.path}: column {column!r} steps by {usual:.4g} s, but --dt is {dt:.4g} s; --dt is used"


def stamped_interval(table: Table) -> tuple[str, float] | None:
    """Return the time column's name and the median interval of its first block in s; None if no column is certain."""
    candidates = time_columns(table)
    if len(candidates) != 1:
        return None
    try:
        (stamps,) = table.head(candidates, 1)
    except LogError:  # it holds no numbers
        return None
    name = table.names[candidates[0]]
    unit = unit_of_column(table, candidates[0], stamps).seconds
    with np.errstate(invalid="ignore", over="ignore"):
        interval = float(np.median(np.diff(stamps))) * unit if stamps.size > 1 else math.nan
    return (name, interval) if interval > 0.0 else None
