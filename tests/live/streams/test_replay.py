"""A log replayed: all of it, from a row on, at a pace; and what is wrong with it told in one line."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from replant.errors import InvalidArgumentError, LogError
from replant.live.streams import demo, open_source
from replant.logs import read_log
from replant.logs.merged_channels import Signal, channel_table
from support.cases import every
from support.wires import Reading, csv


@pytest.fixture
def log(tmp_path: Path) -> Path:
    file = tmp_path / "log.csv"
    t = np.arange(10_000) * 1e-2
    u, y = np.random.default_rng(10).normal(size=(2, t.size))
    file.write_bytes(b"t,u,y\n" + csv(t, u, y))
    return file


def test_all_of_it_equals_the_log_to_the_bit(log: Path, read: Callable[..., Reading]) -> None:
    reading = read(open_source(str(log)))
    reading.join()
    expected = read_log(log, input="u", output="y")
    assert expected.time is not None
    assert np.array_equal(reading.column("u"), expected.input)
    assert np.array_equal(reading.column("y"), expected.output)
    assert np.array_equal(reading.column("t"), expected.time)
    assert reading.column("sequence").tolist() == list(range(len(expected)))
    assert reading.source.counters == {}
    assert reading.source.state == "ended"


def test_seek_skips(log: Path, read: Callable[..., Reading]) -> None:
    for after, first in ((6999, 7000), (10**6, None)):
        source = open_source(str(log))
        source.seek(after)
        reading = read(source)
        reading.join()
        assert [int(batch.sequence[0]) for batch in reading.batches[:1] if batch.sequence is not None] == [
            first for first in [first] if first is not None
        ]
        assert reading.source.counters == {}


def test_the_columns_that_the_options_name(tmp_path: Path, read: Callable[..., Reading]) -> None:
    file = tmp_path / "log.csv"
    file.write_text("time [ms],volt,speed\n0,1,10\n100,2,\n200,3,30\n")
    reading = read(open_source(f"{file}?input=volt&output=speed"))
    reading.join()
    assert np.allclose(reading.column("t"), [0.0, 0.1, 0.2])
    assert reading.column("u").tolist() == [1, 2, 3]
    assert np.isnan(reading.column("y")).tolist() == [False, True, False]
    untimed = read(open_source(f"{file}?input=1&output=2&dt=0.1"))
    untimed.join()
    assert untimed.batches[0].t is None


def test_rows_without_a_time_stamp_are_counted(tmp_path: Path, read: Callable[..., Reading]) -> None:
    file = tmp_path / "log.csv"
    file.write_text("t,u,y\n0,1,1\n,2,2\n0.2,3,3\n")
    reading = read(open_source(str(file)))
    reading.join()
    assert reading.column("y").tolist() == [1.0, 3.0]
    assert reading.column("sequence").tolist() == [0, 2]
    assert reading.source.counters == {"time not finite": 1, "lost": 1}


@pytest.mark.parametrize("clock", ["", "&time=t", "&dt=0.01"])
def test_a_speed_sets_the_duration(log: Path, read: Callable[..., Reading], clock: str) -> None:
    """A hundred seconds at a thousandfold speed take a tenth of a second, or longer on a busy machine."""
    begun = time.monotonic()
    reading = read(open_source(f"{log}?speed=1000{clock}"))
    reading.join()
    assert time.monotonic() - begun >= 0.0999
    assert len(reading) == 10_000


def test_a_slow_replay_comes_in_parts_and_is_closed_at_once(log: Path, read: Callable[..., Reading]) -> None:
    """At its pace the second sample is due after hours."""
    reading = read(open_source(f"{log}?speed=1e-6"))
    reading.wait_for(1)
    reading.stop()
    assert len(reading) == 1


def test_a_file_whose_name_has_a_question_mark(tmp_path: Path, read: Callable[..., Reading]) -> None:
    file = tmp_path / "what?.csv"
    file.write_text("u,y\n1,2\n3,4\n")
    reading = read(open_source(str(file)))
    reading.join()
    assert len(reading) == 2


@every(
    ("name", "message"),
    [
        ("missing.csv", "no such file"),
        ("log.csv?input=x", "no column 'x'"),
        ("log.csv?colour=red", "unknown option 'colour'; known are: input, output, reference, time, dt, speed"),
        ("log.csv?speed=fast", "speed must be a positive number"),
        ("log.csv?speed=0", "speed must be a positive number"),
        ("log.csv?time=t&dt=1", "give either time or dt"),
        ("log.csv?speed", "options are written"),
        ("untimed.csv?speed=1", "add &time=COLUMN or &dt=SECONDS"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(log: Path, name: str, message: str) -> None:
    log.with_name("untimed.csv").write_text("u,y\n1,2\n3,4\n")
    with pytest.raises((InvalidArgumentError, LogError)) as caught:
        open_source(str(log.with_name(name)))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_signals_with_stamps_of_their_own_are_merged(
    read: Callable[..., Reading], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    t = np.arange(40) * 0.01
    signals = {"u": Signal(t[::4], t[::4]), "y": Signal(t, 2.0 * t)}
    table = channel_table(Path("log.ulg"), [(name, lambda name=name: signals[name]) for name in signals])
    monkeypatch.setattr(demo, "read_columns", lambda path: table)
    log = tmp_path / "log.csv"
    log.touch()
    reading = read(open_source(f"{log}"))
    reading.join()
    assert np.array_equal(reading.column("t"), t)
    assert np.array_equal(reading.column("u"), np.repeat(t[::4], 4))
    assert np.array_equal(reading.column("y"), 2.0 * t)
    with pytest.raises(LogError, match="columns 'u', 'y' have different time stamps; leave out the time"):
        open_source(f"{log}?dt=0.01")


@pytest.mark.parametrize("clock", ["", "&dt=0.01"])
def test_an_input_that_is_written_where_it_changes_is_held(
    read: Callable[..., Reading], tmp_path: Path, clock: str
) -> None:
    u = np.repeat(np.arange(8.0), 5)
    cells = ["" if k % 5 else f"{value:g}" for k, value in enumerate(u)]
    (tmp_path / "log.csv").write_text("t,u,y\n" + "".join(f"{0.01 * k:g},{cell},{k}\n" for k, cell in enumerate(cells)))
    reading = read(open_source(f"{tmp_path / 'log.csv'}?input=u{clock}"))
    reading.join()
    assert np.array_equal(reading.column("u"), u)
    assert np.array_equal(reading.column("y"), np.arange(40.0))


@every("header, stamp", [("sec,nanosec,u,y", "{0},{1}"), ("timestamp,u,y", "{0}{1:09d}")])
def test_the_time_is_that_of_the_log(tmp_path: Path, read: Callable[..., Reading], header: str, stamp: str) -> None:
    """In two columns, or since 1970 in a unit that its size tells."""
    file = tmp_path / "log.csv"
    ticks = [1_700_000_000_900_000_000 + 50_000_000 * k for k in range(40)]
    rows = [f"{stamp.format(tick // 10**9, tick % 10**9)},{k},{k}" for k, tick in enumerate(ticks)]
    file.write_text("\n".join([header, *rows]) + "\n")
    reading = read(open_source(str(file)))
    reading.join()
    assert np.allclose(np.diff(reading.column("t")), 0.05, rtol=0.0, atol=1e-6)
