"""Signals with their own rasters are merged exactly."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import replant as rp
from replant.errors import LogError
from replant.logs.merged_channels import Signal, channel_table, merge, merged, on_one_clock
from replant.logs.read import open_recording
from replant.logs.table import Table
from support.cases import every

NAN = np.nan


def signal(t: list[float], values: list[float]) -> Signal:
    return Signal(np.array(t), np.array(values))


def test_one_raster_stays_as_it_is() -> None:
    t = np.arange(100) * 0.01
    u, y = np.random.default_rng(0).standard_normal((2, 100))
    found = merge(Signal(t, y), [Signal(t, u)])
    np.testing.assert_array_equal([found.t, found.output, *found.held], [t, y, u])


#: The output, the signals that are held, and the rows that they make: stamps, the held signals, the output.
MERGED = {
    "a slower input is held": (
        signal([0, 1, 2, 3, 4, 5], [10, 11, 12, 13, 14, 15]), [signal([0, 3], [1, 2])],
        [0, 1, 2, 3, 4, 5], [[1, 1, 1, 2, 2, 2]], [10, 11, 12, 13, 14, 15],
    ),
    # the clock is the input's, and regular
    "of a faster input each stamp is a row": (
        signal([0, 2, 4], [10, 12, 14]), [signal([0, 1, 2, 3, 4, 5], [1, 2, 2, 2, 3, 3])],
        [0, 1, 2, 3, 4], [[1, 2, 2, 2, 3]], [10, NAN, 12, NAN, 14],
    ),
    "an input that changes at outputs alone adds no row": (
        signal([0, 2, 4], [10, 12, 14]), [signal([0, 1, 2, 3, 4], [1, 1, 2, 2, 3])],
        [0, 2, 4], [[1, 2, 3]], [10, 12, 14],
    ),
    "a change between two outputs comes neither earlier nor later": (
        signal([0, 1, 2], [0, 0, 5]), [signal([-1.0, 1.4], [0, 1])],
        [0, 1, 1.4, 2], [[0, 0, 1, 1]], [0, 0, NAN, 5],
    ),
    "rows begin when the held signal is known": (
        signal([0, 1, 2, 3], [0, 1, 2, 3]), [signal([0.5, 5], [1, 2])],
        [1, 2, 3], [[1, 1, 1]], [1, 2, 3],
    ),
    "rows begin when every held signal is known": (
        signal([0, 1, 2, 3], [0, 1, 2, 3]), [signal([0, 5], [1, 2]), signal([1.5, 5], [1, 2])],
        [2, 3], [[1, 1], [1, 1]], [2, 3],
    ),
    "a signal is held for no longer than its longest interval": (
        signal([float(k) for k in range(20)], [0.0] * 20), [signal([0, 1, 2, 5], [1, 2, 3, 4])],
        [*range(8)], [[1, 2, 3, 3, 3, 4, 4, 4]], [0] * 8,
    ),
    "logged once": (
        signal([float(k) for k in range(20)], [0.0] * 20), [signal([0], [1])],
        [*range(20)], [[1] * 20], [0] * 20,
    ),
    "without common time": (signal([0, 1], [0, 1]), [signal([5, 6], [0, 1])], [], [[]], []),
    "of equal stamps the last value counts": (
        signal([0, 1, 2], [0, 0, 0]), [signal([0, 1, 1, 2], [1, 2, 3, 4])],
        [0, 1, 2], [[1, 3, 4]], [0, 0, 0],
    ),
    "a missing input is missing until the next one": (
        signal([0, 1, 2, 3], [0, 0, 0, 0]), [signal([0, 1, 3], [1, NAN, 2])],
        [0, 1, 2, 3], [[1, NAN, NAN, 2]], [0, 0, 0, 0],
    ),
}  # fmt: skip


@every(("output", "inputs", "t", "held", "measured"), MERGED.values(), ids=MERGED)
def test_signals_are_merged(
    output: Signal, inputs: list[Signal], t: list[float], held: list[list[float]], measured: list[float]
) -> None:
    found = merge(output, inputs)
    assert found.t.tolist() == t
    np.testing.assert_array_equal([*found.held], held)
    np.testing.assert_array_equal(found.output, measured)


def test_stamps_that_differ_by_rounding_are_the_same() -> None:
    fast, slow = np.arange(2000) * 0.01, np.arange(200) * 0.1
    assert not np.isin(slow, fast).all()
    found = merge(Signal(fast, fast), [Signal(slow, np.arange(200.0))])
    assert found.t.tolist() == fast.tolist()
    np.testing.assert_array_equal(found.held[0], np.arange(2000) // 10)


@pytest.mark.parametrize("t", [[0, 2, 1], [0, 1, NAN], [0, 1, np.inf]])
def test_stamps_that_decrease_or_are_not_finite_are_refused(t: list[float]) -> None:
    with pytest.raises(ValueError, match="must be finite and never decrease"):
        merge(signal([0, 1, 2], [0, 0, 0]), [signal(t, [0, 0, 0])])


stamps = st.lists(st.integers(0, 60), min_size=1, max_size=25, unique=True).map(sorted)


@given(stamps, stamps, stamps, st.randoms(use_true_random=False))
def test_any_rasters_give_the_held_signals_and_each_output(
    t_y: list[int], t_u: list[int], t_r: list[int], random: Random
) -> None:
    """By the definition: the newest stamp's value at each instant, and each output in its row."""
    y, u, r = ([float(random.randint(0, 3)) for _ in t] for t in (t_y, t_u, t_r))
    found = merge(signal(t_y, y), [signal(t_u, u), signal(t_r, r)])  # type: ignore[arg-type]
    assert np.all(np.diff(found.t) > 0)
    rows = found.t.tolist()
    for t, values, held in ((t_u, u, found.held[0]), (t_r, r, found.held[1])):
        newest = [values[max(k for k, at in enumerate(t) if at <= row)] for row in rows]
        assert held.tolist() == newest
        if rows:  # no change of a held signal is lost, or moved
            changes = {at for at, new, old in zip(t[1:], values[1:], values, strict=False) if new != old}
            assert {at for at in changes if rows[0] < at < rows[-1]} <= set(rows)
    measured = dict(zip(rows, found.output.tolist(), strict=True))
    known = {at: value for at, value in zip(t_y, y, strict=True) if rows and rows[0] <= at <= rows[-1]}
    assert {at: value for at, value in measured.items() if value == value} == known


# --- tables


def table(**signals: Signal) -> Table:
    return channel_table(Path("log.ulg"), [(name, lambda name=name: signals[name]) for name in signals])


def test_columns_are_merged_with_the_time_first() -> None:
    found = table(y=signal([0, 1, 2], [5, 6, 7]), u=signal([0, 2], [1, 2]), r=signal([0, 2], [3, 4]))
    one = merged(found, {"input": 1, "output": 0, "reference": 2})
    assert one.names == ("time", "u", "y", "r")
    assert one.in_seconds == {0}
    assert [column.tolist() for column in one.columns([0, 1, 2, 3])] == [[0, 1, 2], [1, 1, 2], [5, 6, 7], [3, 3, 4]]


def test_with_a_time_given_the_rasters_must_be_equal() -> None:
    found = table(y=signal([0, 1, 2], [5, 6, 7]), u=signal([0, 1, 2], [1, 2, 3]), v=signal([0, 1, 3], [1, 2, 3]))
    assert on_one_clock(found, {"input": 1, "output": 0}, is_timed=True)[0] is found
    with pytest.raises(LogError, match="columns 'v', 'y' have different time stamps; leave out the time"):
        on_one_clock(found, {"input": 2, "output": 0}, is_timed=True)


def test_several_inputs_are_merged_as_one_is() -> None:
    found = table(y=signal([0, 1, 2], [5, 6, 7]), u=signal([0, 2], [1, 2]), v=signal([0, 1, 2], [3, 4, 5]))
    log = open_recording(found, input=["u", "v"], output="y").held
    assert log is not None
    np.testing.assert_array_equal(log.inputs, [[1, 3], [1, 4], [2, 5]])
    assert (log.input_names, log.dt) == (("u", "v"), 1.0)


@every("time", [{"time": "clock"}, {"dt": 1.0}], ids=["column", "sampling time"])
def test_a_log_that_is_opened_with_its_time_is_not_merged(time: dict[str, Any]) -> None:
    stamps = [0, 1, 2, 3]
    found = table(clock=signal(stamps, stamps), y=signal(stamps, [5, 6, 7, 8]), v=signal([0, 1, 3, 4], [1, 2, 3, 4]))
    with pytest.raises(LogError, match=r"columns 'v', 'y'.* have different time stamps; leave out the time"):
        open_recording(found, input="v", output="y", **time)


BAD = {
    "back": (signal([0, 2, 1], [1, 2, 3]), "log.ulg: column 'u', sample 3: the time stamp 1 goes back from the one"),
    "no stamp": (signal([0, NAN, 1], [1, 2, 3]), "log.ulg: column 'u', sample 2: the time stamp is not finite"),
    "empty": (signal([], []), "log.ulg: column 'u' has no sample; choose another column"),
    "apart": (signal([7, 8], [1, 2]), "log.ulg: columns 'u' and 'y' have no time in common; choose others"),
}


@every(("u", "message"), BAD.values(), ids=BAD)
def test_signals_that_cannot_be_merged_are_refused(u: Signal, message: str) -> None:
    with pytest.raises(LogError, match=message):
        merged(table(y=signal([0, 1, 2], [5, 6, 7]), u=u), {"input": 1, "output": 0})


# --- identification


def test_a_plant_is_found_to_the_digit_from_an_input_on_a_slower_raster() -> None:
    dt, plant = 0.01, rp.TransferFunction([6.0], [1.0, 3.0])
    t = dt * np.arange(1600)
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], t.size // 4), 4)
    found = merge(Signal(t, plant.simulate(u, dt)), [Signal(t[::4], u[::4])])
    fitted = rp.fit(found.held[0], found.output, dt, rp.Structure(poles=1))
    np.testing.assert_allclose(np.diff(found.t), dt)
    np.testing.assert_allclose(fitted.transfer_function.den, plant.den, rtol=1e-5)
    np.testing.assert_allclose(fitted.transfer_function.num, plant.num, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("every", [2, *(pytest.param(each, marks=pytest.mark.slow) for each in (5, 10))])
@pytest.mark.parametrize("identified", [rp.fit, rp.run])
def test_a_plant_is_found_from_an_output_that_is_slower_than_its_input(identified, every: int) -> None:
    dt, plant, samples = 0.1, rp.TransferFunction([2.0], [1.0, 1.2, 0.8]), 6000
    rng, t = np.random.default_rng(every), 0.1 * np.arange(samples)
    u = rng.choice([-1.0, 1.0], samples)
    y = plant.simulate(u, dt) + 0.05 * rng.standard_normal(samples)
    log = open_recording(table(u=Signal(t, u), y=Signal(t[::every], y[::every])), input="u", output="y").held
    assert log is not None
    assert int(np.isfinite(log.output).sum()) == samples // every
    found = identified(log, poles=2)
    away = found.parameters - [1.2, 0.8, 2.0]
    assert away @ np.linalg.solve(found.covariance, away) < 21.1  # chi-square of 3, 1 - 1e-4
    assert found.verdict.status == "trusted"


def test_a_few_rows_without_an_output_are_merged() -> None:
    t = np.arange(100.0)
    found = table(u=Signal(np.sort(np.append(t, [3.5, 7.5])), np.arange(102.0)), y=Signal(t, t))
    assert np.isnan(merged(found, {"input": 0, "output": 1}).column("y")).sum() == 2


def test_while_the_output_pauses_the_stamps_of_the_input_are_rows() -> None:
    """The input is known there; a gap would mean that it is unknown."""
    t = np.arange(100.0)
    kept = (t < 30) | (t >= 50)
    found = merge(Signal(t[kept], t[kept]), [Signal(t, np.repeat([1.0, 2.0], 50))])
    np.testing.assert_array_equal(found.t, t)
    np.testing.assert_array_equal(np.isnan(found.output), ~kept)


# --- tables with rows for each signal


def of_rows(**columns: np.ndarray) -> Table:
    return Table(Path("log.csv"), tuple(columns), lambda numbers: iter([[list(columns.values())[n] for n in numbers]]))


def sparse(t: np.ndarray, u: np.ndarray, y: np.ndarray, which: str) -> Table:
    """The same signals in the rows of a file, as loggers write them."""
    if which == "where it changes":
        return of_rows(t=t, u=np.where(np.diff(u, prepend=np.nan) == 0.0, np.nan, u), y=y)
    both, nothing = np.repeat(t, 2), np.full(t.size, np.nan)
    return of_rows(t=both, u=np.stack([u, nothing], 1).ravel(), y=np.stack([nothing, y], 1).ravel())


@every("which", ["where it changes", "on rows of its own"])
@every("unit", [1.0, 1000.0])
def test_an_input_that_is_written_apart_is_held(which: str, unit: float) -> None:
    t = 0.5 * np.arange(400)
    u = np.repeat(np.random.default_rng(0).permutation(np.arange(20.0)), 20)
    found = sparse(unit * t, u, t % 7.0, which)
    found = replace(found, names=("t [s]" if unit == 1.0 else "t [ms]", *found.names[1:]))
    recording = open_recording(found, input="u", output="y")
    log = recording.held
    assert log is not None
    assert re.fullmatch(
        r"log.csv: column 'u' is empty in [34]\d0 of [48]00 rows; each value is held .*", *recording.table.notes
    )
    np.testing.assert_array_equal(log.input, u)
    np.testing.assert_array_equal(log.output, t % 7.0)
    assert log.dt == 0.5


def test_an_input_that_is_written_in_every_second_row_is_held() -> None:
    t, u = np.arange(400.0), np.repeat(np.arange(200.0) % 9.0, 2)
    log = open_recording(of_rows(t=t, u=np.where(t % 2 == 0, u, np.nan), y=t % 7.0), input="u", output="y").held
    assert log is not None
    np.testing.assert_array_equal(log.input, u)


@every("lost", [0.3, 0.7])
def test_an_input_that_was_lost_for_a_while_is_not_held(lost: float) -> None:
    t, u = np.arange(400.0), np.arange(400.0) % 9.0
    u[50 : 50 + int(lost * u.size)] = np.nan
    log = open_recording(of_rows(t=t, u=u, y=t), input="u", output="y").held
    assert log is not None
    np.testing.assert_array_equal(log.input, u)
