"""Every number of every wire format, misread once: the session learns again, and counts what it lost.

The record goes through the real parser, numbering, inbox and session, block by block; nothing waits.
"""

from __future__ import annotations

import itertools
import json
import os
import statistics
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.settings import Request
from replant.live.streams import Batch
from replant.live.streams.line_parser import MAGIC, Parser
from replant.live.streams.reader_thread import LineSplitter, Source
from replant.live.streams.source import UY
from support.builders import engine_state
from support.cases import every
from support.live_fakes import DT, PLANT, JudgingObserver, make, record

STARTUP, SAMPLES, BLOCK = 100, 390, 10
REQUEST = Request(
    rp.Structure(1), DT, preprocess=rp.Preprocess("identity", "mean", "mean"), startup=STARTUP
)  # fmt: skip
TRUE = np.array([PLANT.den[1], PLANT.num[0]])
PATIENCE = 100  # samples until it learns again

#: What a number turns into.
TEXT, NOTHING = "garbled", None
VALUES: dict[str, Any] = {
    "nan": np.nan, "inf": np.inf, "-inf": -np.inf, "-1": -1.0, "0": 0.0, "2^32": 2.0**32, "2^64": 2.0**64, "1e12": 1e12,
    "1e16": 1e16, "1e300": 1e300, "-1e300": -1e300, "text": TEXT, "nothing": NOTHING,
}  # fmt: skip
#: When: the very first sample, in the start-up, just after it, later.
TIMES = (0, 47, STARTUP + 5, 248)
#: With REPLANT_LONG each value comes at all times and with all columns, else all columns come in one format alone, and
#: each value at each time in one of the cases, by turns; in `make slow` in three.
LONG = "REPLANT_LONG" in os.environ

#: The columns that a stream may have: input and output, each of the others or not.
COLUMNS = [
    tuple(name for name in UY.fields if name in ("u", "y") or name in others)
    for others in itertools.chain.from_iterable(itertools.combinations(("n", "t"), k) for k in range(3))
]
Sample = dict[str, Any]


def plain(name: str, value: Any) -> Any:
    """A number as a device writes it: sequence numbers without a point."""
    return int(value) if name == "n" and isinstance(value, float) and np.isfinite(value) else value


def csv(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    cells = ([repr(plain(name, one[name])) for name in columns if one[name] is not NOTHING] for one in block)
    return "".join(",".join(cell.strip("'") for cell in line) + "\n" for line in cells).encode()


def empty_cells(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    """CSV where a value that is missing leaves its commas."""
    cells = (["" if one[name] is NOTHING else repr(plain(name, one[name])) for name in columns] for one in block)
    return "".join(",".join(cell.strip("'") for cell in line) + "\n" for line in cells).encode()


def objects(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    kept = ({name: plain(name, one[name]) for name in columns if one[name] is not NOTHING} for one in block)
    return "".join(json.dumps(one) + "\n" for one in kept).encode()


def nulls(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    """One array of objects, a missing value null."""
    return json.dumps([{name: plain(name, one[name]) for name in columns} for one in block]).encode() + b"\n"


def arrays(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    """One object of arrays; a missing value makes its array shorter."""
    lists = {name: [plain(name, one[name]) for one in block if one[name] is not NOTHING] for name in columns}
    return json.dumps(lists).encode() + b"\n"


def counted_on(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    """One object of arrays with the number of the first sample alone."""
    numbers = [one["n"] for one in block]
    begin = statistics.mode(n - k for k, n in enumerate(numbers) if isinstance(n, float) and np.isfinite(n))
    first = next((n for k, n in enumerate(numbers) if n != begin + k), begin)  # the one misread
    lists: Sample = {name: [one[name] for one in block if one[name] is not NOTHING] for name in columns}
    if "n" in columns:
        lists["n"] = plain("n", first)
    return json.dumps({name: value for name, value in lists.items() if value is not NOTHING}).encode() + b"\n"


def doubles(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    """Bare float64; a text is its first eight bytes."""
    values = [one[name] for one in block for name in columns if one[name] is not NOTHING]
    return b"".join(v.encode().ljust(8)[:8] if isinstance(v, str) else struct.pack("<d", v) for v in values)


def packed(block: Sequence[Sample], columns: Sequence[str]) -> bytes:
    return MAGIC + "".join(columns).ljust(4).encode() + doubles(block, columns)


@dataclass(frozen=True)
class Format:
    """How samples are written, whether one that is off takes its whole block along, and what carries them."""

    write: Callable[[Sequence[Sample], Sequence[str]], bytes]
    together: bool = False
    lines: bool = True
    replays: bool = True
    bare: bool = False


#: Every format of `replant.live.streams`: lines as over TCP, a pipe or a serial port, payloads as over UDP and MQTT.
FORMATS = {
    "csv": Format(csv),
    "csv over serial": Format(csv, replays=False),
    "csv, empty cells": Format(empty_cells),
    "csv datagrams": Format(csv, lines=False, replays=False),
    "json lines": Format(objects),
    "json messages": Format(objects, lines=False),
    "array of objects": Format(nulls, together=True, lines=False),
    "object of arrays": Format(arrays, together=True, lines=False),
    "object of arrays, first number": Format(counted_on, together=True, lines=False),
    "packed datagrams": Format(packed, together=True, lines=False, replays=False),
    "packed messages": Format(packed, together=True, lines=False),
    "doubles": Format(doubles, together=True, lines=False, replays=False, bare=True),
}


class Wire(Source):
    """A source whose bytes are known, read as they are handed over; notes what the identifier has made of them."""

    waits = True

    def __init__(self, blocks: Sequence[bytes], form: Format, columns: tuple[str, ...]) -> None:
        self.replays = form.replays
        super().__init__("wire://")
        said = columns if form.bare or columns not in UY.by_width.values() else None
        parser = Parser(self._counts, said)
        lines = LineSplitter(self._counts)
        self._parse = (
            (lambda data: parser.parse(lines.split(data), 0.0))
            if form.lines
            else lambda data: parser.payloads([data], 0.0, bare=form.bare)
        )
        self._blocks = blocks
        self.identifier: rp.Identifier | None = None
        self.learned: list[int] = []  # after each block: samples learned, or held for the start-up

    def _read(self) -> None:
        """Nothing is read in a thread of its own."""

    def batches(self) -> Iterator[Batch]:
        self._connected()
        for block in self._blocks:
            self._deliver(self._parse(block))
            yield self._inbox.get(0.0)
            assert self.identifier is not None
            running = self.identifier.settings is not None
            self.learned.append(engine_state(self.identifier).learned if running else self.identifier.samples)


def samples_of(u: np.ndarray, y: np.ndarray) -> list[Sample]:
    return [{"n": float(k), "t": k * DT, "u": float(u[k]), "y": float(y[k])} for k in range(u.size)]


def session_of(samples: Sequence[Sample], form: Format, columns: tuple[str, ...], **arguments: Any) -> Any:
    blocks = [form.write(samples[k : k + BLOCK], columns) for k in range(0, len(samples), BLOCK)]
    wire = Wire(blocks, form, columns)
    wire.identifier = rp.Identifier(**vars(REQUEST))
    session, _ = make(wire, identifier=wire.identifier, **arguments)
    session.run()
    return session


CASES = [
    (form, columns, field)
    for form, columns in itertools.product(FORMATS, COLUMNS)
    for field in columns
    if LONG or form == "csv" or columns == UY.by_width[4]
]


@pytest.mark.parametrize("period", [144, pytest.param(18, marks=pytest.mark.slow)])
@every(("form", "columns", "field"), CASES, ids=[f"{form}-{''.join(names)}-{field}" for form, names, field in CASES])
def test_a_number_that_is_misread_once_ends_nothing(
    form: str, columns: tuple[str, ...], field: str, period: int
) -> None:
    u, y = record(SAMPLES, seed=3)
    turn = CASES.index((form, columns, field))
    for number, ((value, misread), when) in enumerate(itertools.product(VALUES.items(), TIMES)):
        if not LONG and (number + number // len(TIMES) + turn) % period:
            continue
        samples = samples_of(u, y)
        samples[when][field] = misread
        session = session_of(samples, FORMATS[form], columns)
        said = f"{value} at {when}: {session.identifier.rejected}, {session.source.counters}"
        assert_learns(session, FORMATS[form], when, said)
        assert_counted(session, FORMATS[form], said)


def assert_learns(session: Any, form: Format, when: int, said: str) -> None:
    """Samples are accepted again soon, all that follow are learned, and the estimate is what it says."""
    learned, block = session.source.learned, when // BLOCK
    recovered = block + PATIENCE // BLOCK
    assert learned[recovered] > learned[recovered - 2], said
    assert session.identifier.settings is not None, said
    assert learned[-1] >= SAMPLES - PATIENCE, said
    away = (session.identifier.parameters - TRUE) / session.identifier.uncertainty.std
    assert (np.abs(away) < 5.0).all(), f"{said}: {away}"


BRIDGED = ("outlier", "stuck", "no output")  # of these the input was used
EVENTS = ("lost", "restarts", "reconnects")  # no samples that came


def assert_counted(session: Any, form: Format, said: str) -> None:
    """What was written is accepted, or counted with its reason."""
    identifier, source = session.identifier, session.source.counters
    rejected = sum(count for reason, count in identifier.rejected.items() if reason not in BRIDGED)
    assert session.progress.taken == identifier.samples + rejected, said
    refused = sum(count for reason, count in source.items() if reason not in EVENTS)
    missing = SAMPLES - session.progress.taken
    assert refused == missing or (form.together and 0 < refused < missing), said


def test_the_list_has_every_set_of_columns_that_lines_may_have() -> None:
    assert set(UY.by_width.values()) <= set(COLUMNS)


@every("form", FORMATS)
@every("columns", COLUMNS[::-1], quick=1)
def test_every_format_learns_what_is_not_misread(form: str, columns: tuple[str, ...]) -> None:
    """The counter-test."""
    u, y = record(SAMPLES, seed=3)
    session = session_of(samples_of(u, y), FORMATS[form], columns)
    assert session.identifier.samples == SAMPLES
    assert session.source.counters == {}


@pytest.mark.slow
def test_after_a_number_that_is_misread_a_plant_that_changes_is_noticed() -> None:
    """Its gain triples; nothing says ``trusted`` of the old one for good."""
    u, y = record(2 * SAMPLES, seed=3)
    y[SAMPLES:] += 2.0 * PLANT.simulate(u - 3.0, DT)[SAMPLES:]
    samples = samples_of(u, y)
    samples[SAMPLES - 100]["n"] = 2.0**32
    observer = JudgingObserver()
    session = session_of(samples, FORMATS["csv"], ("n", "t", "u", "y"), observer=observer)
    assert session.source.counters == {"number leap": 1, "lost": 1}
    assert session.identifier.samples == 2 * SAMPLES - 1
    gain = session.identifier.transfer_function.num[-1] / session.identifier.transfer_function.den[-1]
    assert observer.view.verdict != "trusted" or gain == pytest.approx(12.0, rel=0.1)
