"""Names of signals and the header that states them, batches of samples, and the numbers that reveal lost samples."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.errors import InvalidArgumentError, LogError, shown
from replant.logs.sampling_time import clearer_times, is_letter, time_candidates, unit_in_seconds
from replant.logs.text_cells import is_number
from replant.model.interop import without_unit
from replant.numerics.arguments import BoolArray, FloatArray, IntArray

#: The columns of lines in order; None: to be determined from the lines.
Columns = tuple[str, ...] | None

#: The fields of a sample besides its signals: sequence number, time stamp in s, reference.
NUMBER, TIME, REFERENCE = "n", "t", "r"


@dataclass(frozen=True)
class Signals:
    """The names of inputs and output in lines and columns."""

    inputs: tuple[str, ...] = ("u",)
    output: str = "y"

    def __post_init__(self) -> None:
        names = self.names
        for name in names:
            if name in (NUMBER, TIME, REFERENCE):
                raise InvalidArgumentError(f"{name!r} is the number, time or reference of a sample: rename the signal")
            if names.count(name) > 1:
                role = "an input twice" if self.inputs.count(name) > 1 else "an input and the output"
                raise InvalidArgumentError(f"{shown(name)} is {role}: name each signal once")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the inputs, then of the output."""
        return *self.inputs, self.output

    @property
    def fields(self) -> tuple[str, ...]:
        """All fields that a line may have, in the usual order."""
        return NUMBER, TIME, *self.names, REFERENCE

    @property
    def by_width(self) -> dict[int, tuple[str, ...]]:
        """The columns by the number of cells in a line, if neither the URL nor a header names them."""
        ways = (self.names, (TIME, *self.names), (NUMBER, TIME, *self.names))
        return {len(columns): columns for columns in ways}

    def are_in(self, columns: Collection[str]) -> bool:
        """Return whether columns hold each signal, each name once, and no unknown name."""
        return set(self.names) <= set(columns) <= set(self.fields) and len(set(columns)) == len(columns)


UY = Signals()


def header_of(line: str, signals: Signals) -> tuple[tuple[str, ...], float] | None:
    """Return the columns in a header of CSV, the time column as t, and its unit in s; None if a signal is missing."""
    titles = [cell.strip().strip('"') for cell in line.split(",")]
    cells, times = _known(titles, signals)
    if not set(signals.names) <= set(cells) or len(set(cells)) < len(cells):
        return None
    return tuple(cells), unit_in_seconds(titles[times[0]]) if len(times) == 1 else 1.0


def _known(titles: Sequence[str], signals: Signals) -> tuple[list[str], list[int]]:
    """Return titles with the names of fields in the place of those that stand for them, and the time's candidates.

    A title stands for a field of its name, or, if there is none, of its name without unit; one of time stands for t.
    T may be a temperature: it is no time beside another one, or if too few columns would be left for the signals.
    """
    fields = {without_unit(name): name for name in signals.fields if name != TIME and name not in titles}
    bare = [without_unit(title) for title in titles]
    cells = [
        fields.get(name, title) if bare.count(name) == 1 else title for name, title in zip(bare, titles, strict=True)
    ]
    named = [number for number in time_candidates(titles) if cells[number] not in signals.names]
    times = clearer_times(titles, named)
    if len(titles) - len(times) < len(signals.names):
        times = [number for number in times if not is_letter(titles[number])]
    if len(times) == 1:
        cells[times[0]] = TIME
    return cells, times


def titles_of(line: str) -> tuple[str, ...]:
    """Return the cells of a line in which each is text and another one, as in a header; else none."""
    cells = tuple(cell.strip().strip('"') for cell in line.split(","))
    return () if len(set(cells)) < len(cells) or any(is_number(cell, ",") for cell in cells) else cells


def remark_on(titles: Sequence[str], columns: Sequence[str], signals: Signals) -> str:
    """Return how lines are read as ``columns`` after a line of texts that does not name each signal.

    Raise LogError if it is a header, as it names a field, and contradicts that: it names another place of a column, or
    a user has named the signals.  One of the names is then wrong, and any reading a guess.
    """
    known, times = _known(titles, signals)
    if not times and not set(known) & set(signals.fields):  # perhaps a greeting
        order = f"read {', '.join(columns)} in this order; if it is a header, name signals as it does with -i and -o"
        return f"the line {shown(','.join(titles))} before the rows names no signal: {order}"
    missing = [name for name in signals.names if name not in known]
    known = [TIME if k in times else title for k, title in enumerate(known)]
    moved = any(name != read and name in signals.fields for name, read in zip(known, columns, strict=True))
    if moved or signals != UY:
        there = ", ".join(map(shown, titles))
        advice = "name signals with -i and -o" if signals == UY else "correct -i and -o, or the header"
        raise LogError(f"no column {shown(missing[0])} in the header; there are: {there}; {advice}")
    read = ", ".join(f"{name} from {shown(title)}" for name, title in zip(columns, titles, strict=True))
    return f"the header does not name {' and '.join(missing)}: read {read}; if not, give -i and -o"


def together(columns: Sequence[FloatArray]) -> FloatArray:
    """Return the inputs of a batch: one input as (K,), several as (K, q)."""
    return columns[0] if len(columns) == 1 else np.column_stack(columns)


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples that arrived together; empty while the source is idle."""

    # u, y: (K,): input and output in the device's units; NaN if the device sent none; several inputs: u is (K, q)
    u: FloatArray
    y: FloatArray
    # (K,): the device's time stamps in s.  None: the device sends no stamps, and the samples are dt apart
    t: FloatArray | None = None
    # (K,): the device's sequence numbers, strictly increasing; a gap means lost samples
    sequence: IntArray | None = None
    arrived: float = 0.0  # `time.monotonic()` when the newest sample arrived
    r: FloatArray | None = None  # (K,): the reference; NaN if the device sent none.  None: there is no reference

    def __len__(self) -> int:
        return len(self.y)

    @property
    def signals(self) -> dict[str, NDArray[Any]]:
        """The fields of the batch, without its time of arrival."""
        return {name: each for name, each in vars(self).items() if isinstance(each, np.ndarray)}

    def select(self, rows: slice | BoolArray | IntArray) -> Batch:
        """Return the samples that ``rows`` selects: a slice, a mask (K,) or indices."""
        chosen: dict[str, Any] = {name: signal[rows] for name, signal in self.signals.items()}
        return replace(self, **chosen)


def joined(batches: Sequence[Batch]) -> Batch:
    """Return batches with the same fields as one, which arrived with the last of them."""
    last = batches[-1]
    if len(batches) == 1:
        return last
    whole: dict[str, Any] = {name: np.concatenate([getattr(each, name) for each in batches]) for name in last.signals}
    return replace(last, **whole)


# after a misread number that is less ahead, the samples up to it are lost as duplicates: at twice the value learning
# would pause for too long; at half the value bursts of losses are leaps more often, which loses no sample
LEAP = 50  # step ahead beyond which a number is a leap, and within which the next number confirms it [samples]

# the rule of RFC 3550, appendix A.1, with more tolerance for packets out of order
MISORDER = 1000  # step back beyond which two numbers in a row mean a restarted device, not a repeat [samples]

WRAPS = 1 << 16, 1 << 32  # values at which the counters of devices wrap [count]
LEAPS_KEPT = 8  # most leaps that are remembered, as the numbers may return into them [count]


class Numbering:
    """Screens the samples of one stream by their sequence numbers.

    A number at most `LEAP` ahead of the last one continues the sequence.  A sample whose number leaps further is held
    back: a successor confirms it, and the numbers between are lost; any other number shows that it was misread.  If the
    sender does not repeat samples, a number far back is confirmed by its successor, too, as a reset.  Otherwise only
    unused numbers are accepted: after a counter wrapped at 2^16 or 2^32, or within a leap.
    """

    def __init__(self, counters: Counter[str], *, replays: bool) -> None:
        self.last: int | None = None
        self._counters = counters
        self._replays = replays
        self._candidate: int | None = None  # a number that did not continue; its successor would confirm it
        self._held: Batch | None = None  # the sample of a candidate that leapt ahead
        self._unused: list[tuple[int, int]] = []  # leaps of this connection: last number before, first number after
        self._heard = False  # whether a number has arrived over this connection
        self._alone = False  # whether the last number is the first one and not confirmed yet

    def connect(self) -> None:
        """Record the start of a connection, over which samples may be sent again."""
        self._unused, self._heard = [], False
        self._candidate = self._held = None

    def screen(self, batch: Batch) -> Batch:
        """Return the samples of ``batch`` whose numbers continue, after the held sample if they confirm it."""
        numbers = batch.sequence
        if numbers is None or not numbers.size:
            return batch
        if self.last is not None and not self._alone:
            steps = np.diff(numbers, prepend=self.last)
            if steps.min() > 0 and steps.max() <= LEAP:
                self._advance(self.last, int(numbers[-1]), numbers.size)
                return batch
        return self._one_by_one(batch, numbers.tolist())

    def _one_by_one(self, batch: Batch, numbers: list[int]) -> Batch:
        """Screen each sample by its number in ``numbers``."""
        kept: list[int] = []
        held = None  # index of the candidate's sample in ``batch``
        if self._held is not None:
            batch, held = joined([self._held, batch]), 0
        for at, number in enumerate(numbers, start=len(batch) - len(numbers)):
            candidate = self._candidate
            if candidate is not None and not self._continues(number) and self._confirms(candidate, number):
                kept += [] if held is None else [held]
            if self._continues(number):
                kept.append(at)
                self._advance(number - 1 if self.last is None else self.last, number, 1)
                held = None
            else:
                ahead = self.last is not None and number > self.last
                self._candidate, held = number, at if ahead else None
                self._counters["number leap" if ahead else "duplicate"] += 1
        self._held = None if held is None else batch.select(slice(held, held + 1))
        return batch.select(np.array(kept, np.int64))

    def _advance(self, before: int, last: int, samples: int) -> None:
        if last - before > samples:
            self._counters["lost"] += last - before - samples
        self._alone = self.last is None
        self.last, self._candidate, self._held, self._heard = last, None, None, True

    def _continues(self, number: int) -> bool:
        return self.last is None or 0 < number - self.last <= LEAP

    def _confirms(self, candidate: int, number: int) -> bool:
        """Return whether ``number`` confirms the candidate; if so, the candidate becomes the last number."""
        last = self.last or 0
        # a confirming number follows within `LEAP`, or within twice the leap, as some devices count in steps
        if not 0 < number - candidate <= max(LEAP, 2 * (candidate - last)):
            return False
        left = next((leap for leap in self._unused if leap[0] < candidate < leap[1]), None)
        if candidate > last:
            self._unused = [*self._unused, (last, candidate)][-LEAPS_KEPT:]
            self._counters["number leap"] -= 1
            self._advance(last, candidate, 1)
        elif left is not None:  # the numbers return into a leap: its end had been misread repeatedly
            self._unused.remove(left)
            self._counters["restarts"] += 1
            self._counters["lost"] -= left[1] - left[0] - 1
            self._advance(left[0], candidate, 1)
        elif self._is_restart(last, candidate):
            self._counters["restarts"] += 1
            self._advance(candidate - 1, candidate, 1)
        else:
            return False
        return True

    def _is_restart(self, last: int, number: int) -> bool:
        """Return whether the device was reset, its counter wrapped, or the first number was misread."""
        if self._alone:
            return number < last - LEAP
        if not self._replays:
            return number < last - MISORDER
        return self._heard and number < MISORDER and any(0 < wrap - last <= MISORDER for wrap in WRAPS)
