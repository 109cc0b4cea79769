"""What a newcomer types first: a table, three arrays, words of other tools; each works or is answered in one line."""

from __future__ import annotations

import datetime
import decimal
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow
import pytest

import replant as rp
from replant.fitting.several_outputs import samples_of_outputs
from support.builders import G1, record
from support.cases import every

DT = 0.1
U, Y = record(G1, 1, 600, DT, hold=20, noise=0.05)
TABLE = pd.DataFrame({"t": DT * np.arange(600), "u": U, "y": Y, "pump": np.roll(U, 100), "note": "a"})
STAMPS = pd.date_range("2026-01-01", periods=600, freq="100ms")
WANTED = rp.fit(rp.Log(U, Y, DT), poles=1).parameters


@pytest.mark.parametrize(
    ("table", "more"),
    [
        (TABLE, {}),
        (TABLE.drop(columns="t"), {"dt": DT}),
        (TABLE.rename(columns={"t": "clock"}), {"t": "clock"}),
        (TABLE.set_index("t"), {}),
        (TABLE.drop(columns="t").set_index(pd.date_range("2026-01-01", periods=600, freq="100ms")), {}),
        (TABLE.assign(t=pd.date_range("2026-01-01", periods=600, freq="100ms")), {}),
        (TABLE.drop(columns="t").set_index(pd.date_range("2026-01-01", periods=600, freq="100ms", tz="UTC")), {}),
        (TABLE.assign(t=pd.date_range("2026-03-29 00:59:30", periods=600, freq="100ms", tz="Europe/Berlin")), {}),
        (TABLE.drop(columns="t").set_index(STAMPS).assign(received=STAMPS + pd.Timedelta("3s") * np.arange(600)), {}),
        (TABLE.assign(t=range(600)).set_index(STAMPS), {}),
        (TABLE.drop(columns="t").set_index(STAMPS.rename("when")).assign(start=STAMPS[0]), {"t": "when"}),
        (TABLE.drop(columns="t").set_index(pd.to_timedelta(DT * np.arange(600), unit="s")), {}),
        (TABLE.assign(t=1000.0 * TABLE["t"]).rename(columns={"t": "time [ms]"}), {"t": "time"}),
        (pyarrow.Table.from_pandas(TABLE, preserve_index=False), {}),
    ],
)
def test_a_table_is_fitted_by_the_names_of_its_columns(table: pd.DataFrame, more: dict[str, Any]) -> None:
    fitted = rp.fit(table, input="u", output="y", poles=1, **more)
    np.testing.assert_allclose(fitted.parameters, WANTED, rtol=1e-9)
    assert (fitted.model.input_name, fitted.model.output_name, list(fitted.others)) == ("u", "y", ["pump"])


@pytest.mark.parametrize(
    "t",
    [
        DT * np.arange(600),
        STAMPS,
        STAMPS.to_numpy(),
        pd.Series(STAMPS.tz_localize("Europe/Berlin")),
        pd.to_timedelta(DT * np.arange(600), unit="s"),
        [datetime.datetime(2026, 1, 1) + k * datetime.timedelta(milliseconds=100) for k in range(600)],
    ],
    ids=["seconds", "index", "datetime64", "zone", "timedelta", "datetime"],
)
def test_arrays_with_stamps_need_no_sampling_time(t: Any) -> None:
    for method in ("auto", "least_squares"):  # the latter takes a regular clock only
        wanted = rp.fit(U, Y, DT, poles=1, method=method).parameters
        np.testing.assert_allclose(rp.fit(U, Y, t=t, poles=1, method=method).parameters, wanted, rtol=1e-9)
    np.testing.assert_allclose(rp.fit(U, Y, DT, t=t, poles=1).parameters, WANTED, rtol=1e-6)
    validated = rp.fit(U, Y, DT, poles=1).model.validate(U, Y, t=t)
    assert validated.fit == pytest.approx(rp.fit(U, Y, DT, poles=1).model.validate(U, Y).fit, abs=1e-6)


EPOCH_MS = 1_715_680_000_000 + 100 * np.arange(600)


@every("calls", [lambda t: rp.fit(U, Y, t=t, poles=1), lambda t: rp.search(U, Y, t=t, poles=[1]),
                 lambda t: rp.Identifier(poles=1, dt=DT).update_many(U, Y, t),
                 lambda t: rp.Identifier(poles=(1, 1), dt=DT).update_many(np.column_stack([U, Y]), Y, t)])  # fmt: skip
@every(("counts", "words"), [(1, "milli"), (1_000, "micro"), (1_000_000, "nano")])
def test_counts_since_1970_are_not_taken_for_seconds(calls: Any, counts: int, words: str) -> None:
    """By the rule of a file's column whose name states no unit."""
    with pytest.raises(rp.InvalidArgumentError, match=rf"{words}seconds since 1970, from 2024-05-14 on: give t / 1"):
        calls(EPOCH_MS * counts)


def test_a_stamp_that_is_misread_later_costs_its_sample_alone() -> None:
    ident = rp.Identifier(poles=1, dt=DT)
    ident.update_many(U[:300], Y[:300], DT * np.arange(300))
    ident.update_many(U[300:301], Y[300:301], EPOCH_MS[:1])
    ident.update_many(U[301:], Y[301:], DT * np.arange(301, 600))
    assert (ident.samples, sum(ident.rejected.values())) == (599, 1)


@every("stamps", [STAMPS, STAMPS.to_numpy(), STAMPS.tz_localize("UTC"), pd.to_timedelta(DT * np.arange(600), unit="s")])
@every("orders", [1, (1, 1)])
def test_dates_are_taken_in_chunks(stamps: Any, orders: Any) -> None:
    inputs = U if orders == 1 else np.column_stack([U, np.roll(U, 57)])
    numbers, dates = (rp.Identifier(poles=orders, dt=DT) for _ in range(2))
    for some in (slice(0, 250), slice(250, 600)):
        numbers.update_many(inputs[some], Y[some], DT * np.arange(600)[some])
        dates.update_many(inputs[some], Y[some], stamps[some])
    assert dates.samples == 600
    np.testing.assert_allclose(dates.parameters, numbers.parameters, rtol=1e-4, atol=1e-6)


def test_an_index_that_contradicts_the_sampling_time_is_noted() -> None:
    table = TABLE.drop(columns="t").set_index(STAMPS)
    with pytest.warns(UserWarning, match="column 'index' steps by 0.1 s, but dt is 1 s; dt is used"):
        rp.fit(table, input="u", output="y", dt=1.0, poles=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rp.fit(table, input="u", output="y", dt=DT, poles=1)


def test_series_with_different_indices_are_not_paired_by_position() -> None:
    u, y = pd.Series(U, STAMPS), pd.Series(Y, STAMPS)
    later = y.shift(freq="1s")
    for call in (lambda: rp.fit(u, later, DT, poles=1), lambda: rp.Identifier(poles=1, dt=DT).update_many(u, later)):
        with pytest.raises(rp.InvalidArgumentError, match=r"different indices: .*u, y = u.align\(y, join='inner'\)"):
            call()
    np.testing.assert_allclose(rp.fit(u, y, DT, poles=1).parameters, WANTED, rtol=1e-9)
    np.testing.assert_allclose(rp.fit(u, Y, DT, poles=1).parameters, WANTED, rtol=1e-9)


@every(
    ("u", "words"),
    [
        ([None, *U[1:].tolist()], r"np.asarray\(u, float\) makes numbers of them, and NaN of None"),
        ([*map(decimal.Decimal, U.tolist())], r"np.asarray\(u, float\) makes numbers of them"),
        (iter(U), r"an iterator: give np.asarray\(list\(u\), float\)"),
    ],
)
def test_objects_are_answered_with_what_makes_numbers_of_them(u: Any, words: str) -> None:
    with pytest.raises(rp.ArgumentTypeError, match=words):
        rp.fit(u, Y, DT, poles=1)


def test_the_sampling_time_of_stamps_with_holes_is_their_usual_interval() -> None:
    kept = np.arange(600) % 7 != 3
    t = (DT * np.arange(600))[kept]
    found, wanted = rp.fit(U[kept], Y[kept], t=t, poles=1), rp.fit(U[kept], Y[kept], DT, t=t, poles=1)
    assert found.dt == DT
    np.testing.assert_allclose(found.parameters, wanted.parameters, rtol=1e-9)
    assert rp.run(U[kept], Y[kept], t=t, poles=1).settings.dt == DT
    with pytest.raises(rp.InvalidArgumentError, match="one stamp for each of 600 samples, got 599"):
        rp.fit(U, Y, t=DT * np.arange(599), poles=1)
    with pytest.raises(rp.InvalidArgumentError, match="t needs two stamps or more for a sampling time"):
        rp.fit(U[:1], Y[:1], t=[0.0], poles=1)


def test_columns_may_have_labels_that_are_no_words_and_one_label_may_stand_twice() -> None:
    numbered = TABLE[["t", "u", "y"]].set_axis([2, 0, 1], axis=1)
    fitted = rp.fit(numbered, input=0, output=1, t=2, poles=1)
    np.testing.assert_allclose(fitted.parameters, WANTED, rtol=1e-9)
    twice = TABLE.assign(z=U).set_axis(["t", "u", "y", "z", "note", "z"], axis=1)
    np.testing.assert_allclose(rp.fit(twice, input="u", output="y", poles=1).parameters, WANTED, rtol=1e-9)
    problem = "input: 2 columns are called 'z'; give the number of one, 3 or 5"
    with pytest.raises(rp.InvalidArgumentError, match=problem):
        rp.fit(twice, input="z", output="y", poles=1)
    np.testing.assert_allclose(rp.fit(twice, input=5, output="y", poles=1).parameters, WANTED, rtol=1e-9)


def test_a_table_becomes_a_log_by_the_same_call_as_a_file() -> None:
    log = rp.read_log(TABLE.rename(columns={"u": "u [V]"}), input="u", output="y", begin=10.0)
    assert (len(log), log.input_name, log.dt) == (500, "u [V]", DT)
    np.testing.assert_array_equal(rp.read_log(TABLE, input="u", output="y").others["pump"], np.roll(U, 100))


def test_what_is_said_of_a_table_is_said_of_the_line_that_gave_it() -> None:
    repeated = pd.concat([TABLE[:50], TABLE[49:]])
    for call in (rp.fit, lambda table, poles, **names: rp.read_log(table, **names)):
        with pytest.warns(UserWarning, match="the table: a row repeats") as caught:
            call(repeated, input="u", output="y", poles=1)
        assert [each.filename for each in caught] == [__file__]


NUMBERS, TIMES = TABLE["u"].astype(object), pd.Series(STAMPS.to_pydatetime(), dtype=object)


@every(
    ("column", "cells", "row", "cell", "read"),
    [
        *(
            ("v", NUMBERS, 7, cell, lambda table: rp.fit(table, input="v", output="y", poles=1))
            for cell in ("?", 1j, 10**400, datetime.time(8), pd.Timestamp("2026-01-01"), (1.0, 2.0))
        ),
        *(
            ("t", TIMES, 9, stamp, lambda table: rp.read_log(table, input="u", output="y", time="t"))
            for stamp in ("2026-01-01 00:00:01", None, pd.NaT, 3.0)
        ),
    ],
)
def test_a_cell_that_is_no_number_and_a_stamp_that_is_no_time_are_named_with_their_row(
    column: str, cells: pd.Series, row: int, cell: Any, read: Any
) -> None:
    cells = cells.copy()
    cells.iloc[row] = cell
    words = rf"the table: row {row + 1}, column '{column}': .* is neither a number nor a date"
    with pytest.raises(rp.ArgumentTypeError, match=words):
        read(TABLE.assign(**{column: cells}))


@every("kind", [object, "Float64", "boolean"])
def test_a_missing_cell_is_a_missing_sample_whatever_stands_for_it(kind: Any) -> None:
    column = pd.Series(np.arange(600) % 2, dtype=kind)
    column.iloc[7] = pd.NA
    log = rp.read_log(TABLE.assign(v=column), input="u", output="v")
    assert np.flatnonzero(np.isnan(log.output)).tolist() == [7]


def test_a_label_that_is_a_tuple_is_one_column() -> None:
    columns = pd.MultiIndex.from_tuples([("rig", "t"), ("rig", "u"), ("rig", "y"), ("rig", "z")])
    table = TABLE[["t", "u", "y", "y"]].set_axis(columns, axis=1)
    names = {"input": ("rig", "u")}
    np.testing.assert_allclose(rp.fit(table, **names, output=("rig", "y"), poles=1).parameters, WANTED, rtol=1e-9)
    assert rp.search(table, **names, output=("rig", "y"), poles=(1, 2)).best.structure.poles == 1
    both = rp.fit(table, t=("rig", "t"), **names, output=[("rig", "y"), ("rig", "z")], poles=1)
    assert both.model.output_names == ("rig.y", "rig.z")
    each = samples_of_outputs(table, None, None, None, None, ("rig", "u"), [("rig", "y"), ("rig", "z")])
    assert [list(one.others) for one in each] == [[], []]


def test_polars_too() -> None:
    polars = pytest.importorskip("polars")
    lazy = polars.LazyFrame({"t": DT * np.arange(600), "u": U, "y": Y})
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # polars has one of the work that it is to look at the columns
        for output in ("y", ["y", "u"]):
            with pytest.raises(rp.ArgumentTypeError, match=r"the table is not computed yet: give table.collect\(\)"):
                rp.fit(lazy, input="u", output=output, poles=1)
    fitted = rp.fit(polars.DataFrame({"t": DT * np.arange(600), "u": U, "y": Y}), input="u", output="y", poles=1)
    np.testing.assert_allclose(fitted.parameters, WANTED, rtol=1e-9)


def test_run_and_search_take_the_same_table() -> None:
    assert rp.search(TABLE, input="u", output="y", poles=(1, 2)).best.structure.poles == 1
    assert rp.run(TABLE, input="u", output="y", poles=1).model.input_name == "u"


@every(
    "call",
    [
        rp.Model(rp.Structure(1), [1.0, 2.0], DT).validate,
        rp.RowModel((rp.Structure(1),) * 2, [1.0, 2.0, 3.0, 4.0], DT).validate,
        rp.MatrixModel([rp.RowModel((rp.Structure(1),) * 2, [1.0, 2.0, 3.0, 4.0], DT)]).validate,
        lambda table: rp.Identifier(poles=1, dt=DT).update_many(table, table),
        lambda table: rp.Identifier(poles=1, dt=DT).update(table, 0.0),
        lambda table: rp.fit_percent(table, table),
        lambda table: rp.compare([rp.Model(rp.Structure(1), [1.0, 2.0], DT)], table),
        rp.from_rest,
        rp.detrend,
    ],
)
def test_what_takes_no_table_says_what_makes_a_log_of_it(call: Any) -> None:
    stamped = TABLE.rename(columns={"t": "timestamp"})
    for table in (TABLE, TABLE[["t", "u"]], stamped, pyarrow.Table.from_pandas(TABLE[["u", "y"]])):
        with pytest.raises((rp.ArgumentTypeError, rp.InvalidArgumentError)) as caught:
            call(table)
        assert "got a table: rp.read_log(table, input=..., output=...) makes a Log of it" in str(caught.value)
        assert "timestamp()" not in str(caught.value)
    model = rp.Model(rp.Structure(1), [1.0, 2.0], DT)
    assert model.validate(rp.read_log(TABLE, input="u", output="y")).samples == 600


def test_one_column_of_outputs_is_an_output_and_a_row_of_samples_is_turned() -> None:
    np.testing.assert_array_equal(rp.fit(U, Y[:, None], DT, poles=1).parameters, rp.fit(U, Y, DT, poles=1).parameters)
    for u, y, turned in ((U[None], Y[None], r"u\.T"), (U[None], Y, r"u\.T"), (U, Y[None], r"y\.T")):
        with pytest.raises(rp.InvalidArgumentError, match=rf"got shape \(1, 600\); give the transpose, {turned}$"):
            rp.fit(u, y, DT, poles=1)


def test_a_file_without_names_of_columns_is_answered_with_how_to_read_it(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    TABLE.to_csv(path, index=False)
    for named in ({}, {"input": "u", "output": "y"}):
        for given in (path, str(path)):
            with pytest.raises(rp.ArgumentTypeError, match=r"rp\.read_log\(path, input=\.\.\., output=\.\.\.\)$"):
                rp.fit(given, poles=1, **named)
    for named in ({}, {"input": "u"}):
        with pytest.raises(rp.ArgumentTypeError, match=r"name columns of the log, .*; there are t, u, y, pump, note$"):
            rp.read_log(path, **named)


def test_an_irregular_clock_of_a_table_counts() -> None:
    late = TABLE.drop(index=range(100, 130))
    fitted = rp.fit(late, input="u", output="y", poles=1)
    assert fitted.usual_interval == pytest.approx(DT)
    np.testing.assert_allclose(fitted.parameters, WANTED, rtol=0.05)


def test_a_table_is_read_as_a_file_of_it_is(tmp_path: Path) -> None:
    """The input is written where it changes, three rows stand twice, and the clock counts milliseconds."""
    changes = np.append(True, np.diff(U) != 0.0)
    sparse = TABLE.assign(u=np.where(changes, U, np.nan)).rename(columns={"t": "time [ms]"})
    sparse["time [ms]"] *= 1000.0
    sparse = sparse.loc[[*range(100), 99, 99, 99, *range(100, 600)]].reset_index(drop=True)
    sparse.to_csv(tmp_path / "log.csv", index=False)
    with pytest.warns(UserWarning, match=r"log.csv: .*(held until the next|repeat)"):
        of_file = rp.fit(rp.read_log(tmp_path / "log.csv", input="u", output="y"), poles=1)
    with pytest.warns(UserWarning, match=r"the table: .*(held until the next|repeat)"):
        fitted = rp.fit(sparse, input="u", output="y", poles=1)
    np.testing.assert_array_equal(fitted.parameters, of_file.parameters)
    np.testing.assert_allclose(fitted.parameters, WANTED, rtol=1e-9)


def test_three_arrays_make_a_log() -> None:
    log = rp.Log(U, Y, DT)
    assert (len(log), log.dt, log.input_name, log.output_name, log.path.name) == (600, DT, "u", "y", "")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"order": 1}, "poles=2 is the number of poles"),
        ({"na": 1}, "poles=2"),
        ({"nb": 1}, "zeros=1"),
        ({"nk": 1}, "delay=0.2 is the dead time in s"),
        ({"Ts": 0.1}, "dt=0.1"),
        ({"pole": 1}, "did you mean poles?"),
        ({"poles": range(1, 3)}, "search chooses"),
        ({"poles": 1, "delay": [0.0, 1.0]}, "search chooses"),
        ({"structure": 1}, "write poles=1"),
        ({"poles": 1, "input": "u"}, "columns of a table"),
    ],
)
def test_words_of_other_tools_are_answered_with_ours(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises((rp.ArgumentTypeError, rp.InvalidArgumentError)) as caught:
        rp.fit(U, Y, DT, **arguments)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("call", [rp.fit, rp.search, rp.run, rp.Identifier])
def test_every_door_answers(call: Any) -> None:
    with pytest.raises(rp.ArgumentTypeError, match="there is no argument 'order': poles=2"):
        call(order=1)


ROWS_COUNTED = TABLE.drop(columns="t").set_index(pd.RangeIndex(600, name="row"))
NAMED = {"input": "u", "output": "y"}


@pytest.mark.parametrize(
    ("table", "arguments", "error", "words"),
    [
        (TABLE, {}, (rp.ArgumentTypeError, rp.InvalidArgumentError), "name columns of the table"),
        (TABLE, NAMED | {"input": "v"}, (rp.ArgumentTypeError, rp.InvalidArgumentError),
         "input must name a column, got 'v'; there are t, u, y"),
        (TABLE, NAMED | {"y": Y}, (rp.ArgumentTypeError, rp.InvalidArgumentError), "leave out y"),
        (TABLE, NAMED | {"reference": "r"}, (rp.ArgumentTypeError, rp.InvalidArgumentError),
         "reference must name a column"),
        (TABLE, NAMED | {"input": "note"}, rp.ArgumentTypeError,
         "the table: row 1, column 'note': 'a' is neither a number nor a date"),
        (ROWS_COUNTED, NAMED, rp.LogError,
         "the table: no column is called t, time or timestamp; name the time"),
        (TABLE.drop(columns="t"), NAMED, rp.LogError,
         r"name the time column \(t=...\) or give the sampling time \(dt=...\)"),
    ],
    ids=["no names", "no such input", "y beside it", "no such reference", "no number", "rows are counted", "no clock"],
)  # fmt: skip
def test_a_table_that_is_not_understood_is_answered(
    table: pd.DataFrame, arguments: dict[str, Any], error: Any, words: str
) -> None:
    with pytest.raises(error, match=words):
        rp.fit(table, poles=1, **arguments)


@every(
    ("more", "words"),
    [
        ({"t": "nope"}, "the time (t=...) must name a column, got 'nope'"),
        ({"t": "t", "dt": DT}, "give either the time column (t=...) or the sampling time (dt=...)"),
        ({"dt": -1.0}, "the sampling time (dt=...) must be finite and positive"),
        ({"t": "stop"}, "drop that row, or give the sampling time (dt=...) instead of a time column"),
    ],
)
def test_what_is_wrong_with_the_clock_is_said_in_the_names_of_arguments(
    more: dict[str, Any], words: str, tmp_path: Path
) -> None:
    table = TABLE.assign(stop=np.minimum(TABLE["t"], 0.4))
    table.to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(rp.ReplantError) as caught:
        rp.fit(table, input="u", output="y", poles=1, **more)
    assert words in str(caught.value)
    names = {"time" if name == "t" else name: value for name, value in more.items()}
    for given in (table, tmp_path / "log.csv"):
        with pytest.raises(rp.ReplantError) as caught:
            rp.read_log(given, input="u", output="y", **names)
        assert "--" not in str(caught.value)
        assert "(t=" not in str(caught.value)
