"""The sampling time: regular and irregular stamps, and the errors of invalid ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError
from replant.logs import Table, open_recording, read_log
from replant.logs.sampling_time import check_dt, interval_of, time_candidates, unit_in_seconds, unit_of_stamps
from replant.numerics.time_stamps import StampResolution, is_regular
from support.cases import every

Write = Callable[..., Path]


def judged(stamps: NDArray[np.float64]) -> tuple[float, str]:
    """Return the interval of stamps, and the text on the first irregular one."""
    interval, irregularity = interval_of(Table(Path("log.csv"), ("t",), lambda _: iter(()), "row {}".format), 0, stamps)
    assert is_regular(stamps) == (not irregularity)
    return interval, irregularity


def step_of(stamps: NDArray[np.float64]) -> float:
    """The interval of a clock that is regular."""
    interval, irregularity = judged(stamps)
    assert not irregularity
    return interval


def step_of_irregular(stamps: NDArray[np.float64]) -> float:
    interval, irregularity = judged(stamps)
    assert irregularity
    return interval


def log_text(stamps: list[str], name: str = "t") -> str:
    return f"{name},u,y\n" + "".join(f"{stamp},{k},{-k}\n" for k, stamp in enumerate(stamps))


@given(
    dt=st.sampled_from([1e-4, 1e-3, 0.02, 0.1, 1 / 3, 1.0, 60.0, 1 / 44100]),
    start=st.sampled_from([0.0, -5.0, 1234.5]),
    count=st.integers(2, 2000),
)
def test_a_regular_grid_gives_its_interval(dt: float, start: float, count: int) -> None:
    spacing = float(np.spacing(abs(start) + dt * count))
    assert math.isclose(step_of(start + dt * np.arange(count)), dt, rel_tol=1e-11, abs_tol=2 * spacing)


@given(
    dt=st.floats(0.01, 1.0),
    decimals=st.integers(3, 8),
    start=st.floats(-100.0, 100.0),
    count=st.integers(10, 500),
)
def test_rounding_of_printed_digits_is_no_irregularity(dt: float, decimals: int, start: float, count: int) -> None:
    stamps = np.round(start + dt * np.arange(count), decimals)
    assert abs(step_of(stamps) - dt) <= 1.01 * 10.0**-decimals / (count - 1) + 1e-11 * dt


REGULAR = {
    "single precision": ((1e-3 * np.arange(240_000)).astype(np.float32).astype(np.float64), 1e-3, 1e-6),
    "since 1970": (1.7e9 + 1e-4 * np.arange(10_000), 1e-4, 1e-6),
    "jitter below one percent": (np.arange(500) + np.random.default_rng(0).uniform(-0.004, 0.004, 500), 1.0, 1e-4),
    "slow drift, rounded": (np.round(np.cumsum(np.linspace(0.0333, 0.0334, 100_000)), 3), 0.03335, 1e-5),
}


@every("stamps, step, tolerance", REGULAR.values(), ids=REGULAR)
def test_what_numbers_and_clocks_leave_of_a_grid_is_regular(
    stamps: NDArray[np.float64], step: float, tolerance: float
) -> None:
    assert math.isclose(step_of(stamps), step, rel_tol=tolerance)


@given(
    dt=st.sampled_from([1e-3, 0.02, 0.0333333, 1.0]),
    decimals=st.integers(2, 9),
    count=st.integers(20, 400),
    data=st.data(),
)
def test_a_missing_sample_is_found_where_it_is(dt: float, decimals: int, count: int, data: st.DataObject) -> None:
    if dt < 4.0 * 10.0**-decimals:
        decimals = 9
    gap = data.draw(st.integers(1, count - 1))
    stamps = np.delete(np.round(dt * np.arange(count + 1), decimals), gap)
    interval, irregularity = judged(stamps)
    assert f"row {gap}, column 't': irregular time stamps" in irregularity
    assert interval == pytest.approx(dt, abs=1.01 * 10.0**-decimals)


@given(dt=st.sampled_from([1e-3, 0.02, 1.0]), count=st.integers(20, 400), data=st.data())
def test_a_displaced_stamp_is_found(dt: float, count: int, data: st.DataObject) -> None:
    stamps = dt * np.arange(count)
    row = data.draw(st.integers(1, count - 2))  # at the ends, one printed digit may be rounding
    stamps[row] += data.draw(st.sampled_from([-0.5, -0.02, 0.02, 0.5])) * dt
    assert f"row {row}, column 't': irregular" in judged(stamps)[1]


def test_a_stamp_displaced_by_one_digit_is_not_rounding() -> None:
    stamps = np.round(0.1 * np.arange(50), 1)
    stamps[30] += 0.01
    assert "row 30, column 't': irregular" in judged(stamps)[1]


def test_irregular_stamps_come_with_the_log_and_the_line_is_named(write: Write) -> None:
    path = write("# rig\n\n" + log_text(["0", "0.1", "0.2", "0.35", "0.4", "0.5"]))
    log = read_log(path, input="u", output="y", time="t")
    assert log.dt == 0.1
    assert log.stamps is not None
    assert log.stamps.tolist() == [0.0, 0.1, 0.2, 0.35, 0.4, 0.5]
    assert log.duration == pytest.approx(0.6)
    assert open_recording(path, input="u", output="y").irregularity == (
        f"{path}: line 7, column 't': irregular time stamps, 0.15 after the one before instead of the usual 0.1"
    )
    given = read_log(path, input="u", output="y", dt=0.1)
    assert given.time is None
    assert given.stamps is None


@every(("begin", "dt"), [(0.0, 0.05), (1.7e9, 0.25), (65_000.1, 1e-3), (0.0, 1 / 3)])
def test_the_interval_of_an_irregular_clock_has_no_digits_of_rounding(begin: float, dt: float) -> None:
    stamps = begin + dt * np.delete(np.arange(2000), 70)
    assert step_of_irregular(stamps) == pytest.approx(dt, rel=1e-9 + 1e-7 * (begin > 1e6))
    if dt != 1 / 3:
        assert len(repr(step_of_irregular(stamps))) < 8


def test_the_stamps_of_a_regular_clock_do_not_count(write: Write) -> None:
    """Rounded stamps would reduce the accuracy: the mean interval is more accurate than each interval."""
    log = read_log(write(log_text(["0", "0.033", "0.067", "0.1"])), input="u", output="y")
    assert log.stamps is None
    assert log.time is not None
    assert log.duration == 4 * log.dt


def test_irregular_stamps_in_another_unit_become_seconds(write: Write) -> None:
    log = read_log(write(log_text(["0", "100", "200", "450"], "t [ms]")), input="u", output="y")
    assert log.dt == 0.1
    assert log.stamps is not None
    np.testing.assert_allclose(log.stamps, [0.0, 0.1, 0.2, 0.45], rtol=1e-12)


@every("stamps", [[], [1.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.5], [0.0, math.nan, 2.0]])
def test_stamps_that_do_not_increase_are_not_a_regular_clock(stamps: list[float]) -> None:
    assert is_regular(np.array(stamps)) == (len(stamps) < 2)


DISORDERED = {
    "repeated": (log_text(["0", "0.1", "0.1", "0.2"]), "line 4, column 't': the time stamp 0.1 repeats the one before"),
    "begun anew": (
        log_text([*(f"{k}" for k in range(20)), *(f"{k}" for k in range(20))]),
        r"goes back from the one before \(19\); the clock begins anew: if another",
    ),
    "back": (
        log_text(["0", "0.1", "0.05", "0.2"]),
        "line 4, column 't': the time stamp 0.05 goes back from the one before",
    ),
    "empty": (
        log_text(["0", "", "0.2", "0.3"]),
        "line 3, column 't': the time stamp is nan; drop that row, or give the sampling",
    ),
    "infinite": (log_text(["0", "0.1", "inf", "0.3"]), "line 4, column 't': the time stamp is inf"),
    "huge": (log_text(["-1e308", "0", "1e308"]), r"line 2, column 't': the time stamp is -1e\+308"),
    "points": (
        log_text(["10.00.00", "10.00.01", "10.00.02"]),
        "line 2, column 't': '10.00.00' is not a number; convert dates",
    ),
    "the file runs backwards": (
        "t,u,y\n" + "".join(f"{9 - k},1,2\n" for k in range(10)),
        r"line 3, column 't': the time stamp 8 goes back .*; the file runs backwards: sort",
    ),
    **{
        f"begun anew after each {period}": (
            "t,u,y\n" + "".join(f"{0.1 * (k % period):.1f},{k % 7},{k % 3}\n" for k in range(300)),
            r"the time stamp 0 goes back .*; the clock begins anew",
        )
        for period in (3, 5, 10, 50)
    },
    **{
        f"within the {lap}": (
            "t,u,y\n" + "".join(f"{step * (k + 7) % length},{k % 7},{k % 3}\n" for k in range(300)),
            rf"the time stamp \d+ goes back .*; the clock begins anew after one {lap}: if it counts within the {lap}",
        )
        for step, length, lap in ((1, 60, "minute"), (60, 3600, "hour"), (600, 86400, "day"))
    },
    "too coarse for rows that are alike": (
        "t,u,y\n" + "".join(f"{k // 3},{k // 30},{k // 4}\n" for k in range(60)),
        "line 3, column 't': the time stamp 0 repeats the one before",
    ),
    "back, under the letter T": (
        log_text(["0.1" if k == 30 else f"{0.5 * k}" for k in range(40)], "T"),
        r"line 32, column 'T': the time stamp 0\.1 goes back",
    ),
}


@every(("text", "message"), DISORDERED.values(), ids=DISORDERED)
def test_stamps_that_are_not_increasing_times_are_refused(write: Write, text: str, message: str) -> None:
    with pytest.raises(LogError, match=message):
        read_log(write(text), input="u", output="y")


@every("name", ["t", "T", "time", "Time", "TIMESTAMP", "time [s]", "t (s)", "Time(s)", "t/s", "time_s", " time "])
def test_a_column_called_time_is_found(write: Write, name: str) -> None:
    log = read_log(write(log_text(["0", "0.5", "1"], name)), input="u", output="y")
    assert log.dt == 0.5
    assert log.time is not None
    assert log.time.tolist() == [0.0, 0.5, 1.0]


@every(
    ("name", "dt"),
    [
        ("t [ms]", 5e-4),
        ("time_us", 5e-7),
        ("Time (min)", 30.0),
        ("Time in ms", 5e-4),
        ("t [µs]", 5e-7),
        ("t_millis", 5e-4),
        ("millis", 5e-4),
        ("time [usec]", 5e-7),
        ("timestamp_nanoseconds", 5e-10),
    ],
)
def test_a_unit_in_the_name_counts(write: Write, name: str, dt: float) -> None:
    log = read_log(write(log_text(["0", "0.5", "1"], name)), input="u", output="y")
    assert math.isclose(log.dt, dt, rel_tol=1e-12)
    assert log.time is not None
    np.testing.assert_allclose(log.time, [0.0, dt, 2 * dt], rtol=1e-12)


def test_names_that_are_not_time() -> None:
    assert (
        time_candidates(
            ["temperature", "timer", "tt", "t2", "time [V]", "millisecond_counter", "timer_ms", "0", "dt", "u_t"]
        )
        == []
    )
    assert unit_in_seconds("s") == unit_in_seconds("clock") == unit_in_seconds("t [rev]") == 1.0


def in_digits(form: str, step: float, count: int) -> NDArray[np.float64]:
    begin = datetime(2024, 5, 1, 23, 58)
    return np.array([float(f"{begin + timedelta(seconds=step * k):{form}}") for k in range(count)])


@every("step", [1.0, 10.0, 30.0, 60.0, 0.5])
def test_dates_and_clock_times_written_as_one_number_are_no_count(step: float) -> None:
    for name in ("t", "time_ms"):
        unit = unit_of_stamps(name, in_digits("%Y%m%d%H%M%S.%f", step, 500))
        assert unit.refused
        assert "YYYYMMDDhhmmss" in unit.doubt
        assert math.isnan(unit.seconds)  # no sampling time may follow from it
    clock = unit_of_stamps("t", in_digits("%H%M%S.%f", step, 500))  # over midnight
    assert clock.refused
    assert "hhmmss" in clock.doubt


@given(st.integers(0, 2**32 - 1), st.sampled_from([1.0, 2.0, 5.0, 10.0, 20.0, 100.0, 0.1]))
def test_a_count_with_pauses_is_not_taken_for_clock_times(seed: int, step: float) -> None:
    """Also one with few rows, none of whose digits says that it is no clock time."""
    rng = np.random.default_rng(seed)
    pauses = step * rng.integers(0, 100, 30) * (rng.random(30) < 0.1)
    stamps = rng.integers(0, 100) * step + np.cumsum(step + pauses)
    steps = np.diff(stamps)
    carries = np.isclose(steps - step, 40.0) | np.isclose(steps - step, 4040.0)
    if not carries.any():
        assert not unit_of_stamps("t", stamps).refused


@every("origin", [45_413.0, 739_373.0], ids=["Excel", "MATLAB"])
@every("step", [0.2, 1.0, 60.0])
def test_dates_as_numbers_of_days_are_no_seconds(origin: float, step: float) -> None:
    days = origin + step / 86400.0 * np.arange(500.0)
    unit = unit_of_stamps("Date", days)
    assert unit.refused
    assert "name the column Date [d]" in unit.remedy
    assert not unit_of_stamps("Date [d]", days).refused
    assert unit_of_stamps("Date [d]", days).seconds == 86400.0
    assert not unit_of_stamps("t", origin + step * np.arange(500.0)).refused  # since midnight, say


def test_without_time_and_dt_both_are_named_and_options_where_a_command_may_read(write: Write) -> None:
    path = write("x,u,y\n0,1,2\n1,2,3\n")
    with pytest.raises(LogError, match=r"name the time column \(time=...\) or give the sampling time \(dt=...\)"):
        read_log(path, input="u", output="y")
    with pytest.raises(LogError, match=r"name the time column \(time, --time\) or give the sampling time \(dt, --dt\)"):
        open_recording(path, input="u", output="y")


@every(
    ("given", "message"),
    [
        ({"time": "t", "dt": 1.0}, "give either the time column"),
        *(({"dt": dt}, r"\(dt=...\) must be finite and positive") for dt in (0.0, -0.1, math.nan, math.inf)),
    ],
)
def test_a_sampling_time_that_is_none_or_beside_a_time_is_refused(
    write: Write, given: dict[str, Any], message: str
) -> None:
    with pytest.raises(InvalidArgumentError, match=message):
        read_log(write(log_text(["0", "1"])), input="u", output="y", **given)


@every("dt", ["0.1", True, 1j, [0.1]])
def test_dt_must_be_a_number(dt: object) -> None:
    with pytest.raises(ArgumentTypeError, match=r"\(dt, --dt\) must be a number"):
        check_dt(dt)


@pytest.mark.parametrize(("values", "step"), [([0.0, 1.0], 1.0), ([0.25, 7.0], 0.01), ([1 / 3, 2.0], 2.0**-50)])
def test_the_resolution_of_stamps_is_found(values: list[float], step: float) -> None:
    resolution = StampResolution()
    resolution.add(np.array(values))
    assert resolution.step == step


@every(("name", "core"), [("ticks", "ticks"), ("head.rig time", "rig_time"), ("at[0]", "at")])
def test_the_name_that_states_a_unit_is_made_of_the_column_s_own(name: str, core: str) -> None:
    assert f"name the column {core}_ms" in unit_of_stamps(name, 1000.0 * np.arange(5.0)).remedy


def test_a_row_that_is_written_twice_counts_once(write: Write) -> None:
    rows = [f"{0.5 * k},{k % 3},{k % 7}\n" for k in range(60) for _ in range(1 + (k % 20 == 7))]
    with pytest.warns(
        UserWarning, match="3 rows repeat the previous one, with the same time stamp; repetitions are left out"
    ):
        log = read_log(write("t,u,y\n" + "".join(rows)), input="u", output="y")
    assert (log.dt, len(log)) == (0.5, 60)
    assert log.output.tolist() == [k % 7 for k in range(60)]


WARM = [20.0 + (k % 3) - 0.1 * (k % 7) for k in range(40)]  # a temperature that rises and falls


@every("names", [("Zeit", "u", "T"), ("t", "u", "T [°C]"), ("time", "u", "T"), ("t", "u", "T")])
def test_a_temperature_under_the_letter_t_is_the_output_and_not_the_time(write: Write, names: tuple[str, ...]) -> None:
    rows = [",".join(names), *(f"{0.5 * k},{k % 2},{warm}" for k, warm in enumerate(WARM))]
    log = read_log(write("\n".join(rows)), input="u", output="T", time="Zeit" if names[0] == "Zeit" else None)
    assert log.dt == 0.5
    assert log.output.tolist() == pytest.approx(WARM)


def test_the_index_of_a_table_is_the_time_beside_a_temperature_with_the_letter_of_time() -> None:
    index = pandas.Index(0.5 * np.arange(40), name="hours")
    table = pandas.DataFrame({"u": np.arange(40) % 2, "T": WARM}, index=index)
    assert read_log(table, input="u", output="T").dt == 0.5


JITTERED = np.cumsum(np.random.default_rng(1).uniform(0.4, 0.6, 40))
BY_THE_LETTER = {
    "beside a temperature": ("t,u,y,T", [f"{0.5 * k},{k % 2},{k % 3},{warm}" for k, warm in enumerate(WARM)], 0.5),
    "with jitter": (
        "T,u,y",
        [f"{stamp:.4f},{k % 2},{k % 3}" for k, stamp in enumerate(JITTERED)],
        pytest.approx(0.5, rel=0.1),
    ),
}


@every(("names", "rows", "dt"), BY_THE_LETTER.values(), ids=BY_THE_LETTER)
def test_a_clock_under_the_letter_t_is_the_time(write: Write, names: str, rows: list[str], dt: Any) -> None:
    assert read_log(write("\n".join([names, *rows])), input="u", output="y").dt == dt


RISING = {"in a line": lambda k: 20.0 + 0.1 * k, "to a limit": lambda k: 20.0 + 60.0 * (1.0 - np.exp(-k / 8.0))}
NO_NAME = "no column is called t, time or timestamp; name the time column"
NOT_TOLD = {
    "it has another role": (
        log_text(["0", "0.1", "0.2"]),
        "t",
        "no other column is called t, time or timestamp; name the time column",
        {},
    ),
    "two have its name": (
        "t,timestamp,u,y\n0,5,1,2\n1,6,2,3\n",
        "u",
        "several columns could be the time: 't', 'timestamp'; name the time column",
        {"timestamp": 1.0},
    ),
    "a temperature": (
        "\n".join(["Zeit,u,y,T", *(f"{0.5 * k},{k % 2},{k % 3},{warm}" for k, warm in enumerate(WARM))]),
        "u",
        NO_NAME,
        {},
    ),
    **{
        f"a temperature that rises {how}, beside {name}": (
            "\n".join([f"{name},u,y,T", *(f"{0.5 * k},{k % 2},{k % 3},{rise(k):.3f}" for k in range(40))]),
            "u",
            "name the time column",
            {name: 0.5},
        )
        for name in ("Zeit", "row")
        for how, rise in RISING.items()
    },
    "text": ("\n".join(["Zeit,u,y,T", *(f"{0.5 * k},{k % 2},{k % 3},warm" for k in range(40))]), "u", NO_NAME, {}),
    "a column that rises is suggested": (
        "\n".join(["Zeit [s],u,y", *(f"{0.5 * k},{k % 2},{k % 3}" for k in range(40))]),
        "u",
        r"name the time column \(time=...\), perhaps 'Zeit \[s\]', or give .* there are: Zeit \[s\], u, y$",
        {"Zeit [s]": 0.5},
    ),
    "none rises": (
        "\n".join(["u,y", *(f"{k % 2},{k % 3}" for k in range(40))]),
        "u",
        r"\(time=...\) or give the sampling time \(dt=...\); there are: u, y$",
        {},
    ),
}


@every(("text", "chosen", "message", "remedies"), NOT_TOLD.values(), ids=NOT_TOLD)
def test_a_time_that_no_name_tells_is_asked_for(
    write: Write, text: str, chosen: str, message: str, remedies: dict[str, float]
) -> None:
    path = write(text)
    with pytest.raises(LogError, match=message):
        read_log(path, input=chosen, output="y")
    for name, dt in remedies.items():
        assert read_log(path, input=chosen, output="y", time=name).dt == dt
