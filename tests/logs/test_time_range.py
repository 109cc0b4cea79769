"""A part of a log, chosen by time."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import InvalidArgumentError, LogError
from replant.logs import open_recording, read_log
from support.cases import every

Write = Callable[..., Path]


def text(samples: int, *, dt: float = 0.1, start: float = 0.0, name: str = "t") -> str:
    return f"{name},u,y\n" + "".join(f"{start + dt * k:.15g},{k % 7},{k}\n" for k in range(samples))


@every("start", [0.0, 1234.5, 1.7e9])
@every(
    ("begin", "end", "first", "last"),
    [
        (None, None, 0, 99),
        (2.0, None, 20, 99),
        (None, 3.0, 0, 29),
        (0.3, 0.7, 3, 6),
        (0.25, 0.75, 3, 7),
        (5, 99, 50, 99),
    ],
)
def test_the_begin_belongs_to_the_part_and_the_end_does_not(
    write: Write, begin: float | None, end: float | None, first: int, last: int, start: float
) -> None:
    path = write(text(100, start=start))
    log = read_log(path, input="u", output="y", begin=begin, end=end)
    assert log.output.tolist() == list(range(first, last + 1))
    assert log.dt == pytest.approx(0.1)
    assert log.time is not None
    assert log.time[0] == pytest.approx(start + 0.1 * first)
    assert (log.begin, log.end) == (begin, end)


@every(
    ("content", "given"),
    [(text(100, dt=100.0, name="t [ms]"), {}), (text(100, name="n"), {"dt": 0.1})],
    ids=["ms", "dt"],
)
def test_the_unit_of_the_stamps_or_the_sampling_time_counts(
    write: Write, content: str, given: dict[str, float]
) -> None:
    log = read_log(write(content), input="u", output="y", begin=0.3, end=0.7, **given)
    assert log.output.tolist() == [3, 4, 5, 6]


def test_every_chunk_of_a_long_log_is_cut(write: Write) -> None:
    """A log of several blocks: the part begins and ends within blocks of their own."""
    samples = 300_000
    path = write(text(samples, dt=0.01))
    recording = open_recording(path, input="u", output="y", begin=500.0, end=2500.0, most_held=1000)
    assert recording.held is None
    y = np.concatenate([batch[1] for batch in recording.batches()])
    assert y.size == recording.samples == 200_000
    assert np.array_equal(y, np.arange(50_000, 250_000))
    newest = recording.newest(y[-5:], y[-5:])
    assert (newest.begin, newest.end) == (500.0, 2500.0)


def test_a_fault_outside_of_the_part_does_no_harm_and_one_inside_names_its_line(write: Write) -> None:
    lines = text(100).splitlines()
    lines[51] = lines[51].replace("5,", "4.9,", 1)  # the stamp before, once more
    path = write("\n".join(lines) + "\n")
    assert len(read_log(path, input="u", output="y", end=4.0)) == 40
    with pytest.raises(LogError, match="line 52, column 't'"):
        read_log(path, input="u", output="y", begin=2.0)


@every(("begin", "end"), [(-1.0, None), (2.0, 2.0), (3.0, 2.0), (float("nan"), None), (0.0, float("nan"))])
def test_an_impossible_range_is_refused(write: Write, begin: float, end: float | None) -> None:
    with pytest.raises(InvalidArgumentError, match=r"time range .* \(begin=...\)"):
        read_log(write(text(10)), input="u", output="y", begin=begin, end=end)


def test_a_range_behind_the_end_is_said(write: Write) -> None:
    with pytest.raises(LogError, match="no row from 50 s on after its first one"):
        read_log(write(text(10)), input="u", output="y", begin=50.0)
    with pytest.raises(LogError, match="0 rows"):
        read_log(write(text(10)), input="u", output="y", begin=50.0, dt=0.1)
