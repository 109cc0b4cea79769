"""Identification of every rig of a fleet: rows, failures, repetition."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import polars
import pyarrow
import pytest
from pyarrow import parquet

import replant as rp
from replant.errors import InvalidArgumentError, LogError, SystemRefusedError
from replant.estimation.settings import Request
from replant.fleet import worker
from replant.fleet.job import Job
from replant.fleet.store import Store
from replant.numerics.operating_system import ENDING
from replant.online.runs.run import Arrays, run_source
from support.cases import every
from support.fleets import DT, as_csv, as_parquet, as_table, recorded, small_fleet
from support.full_disk import full_disk

COLUMNS = {"input": "u", "output": "y", "poles": 2}


def fitted(logs: Path, out: Path, by: str = "file", **more: object) -> rp.fleet.Fleet:
    return rp.fleet.fit(logs, by=by, out=out, **{**COLUMNS, "method": "fit", **more})


def bytes_of(out: Path) -> list[bytes]:
    return [(out / name).read_bytes() for name in ("rigs.parquet", "models.jsonl")]


def test_a_row_says_what_fit_says(tmp_path: Path) -> None:
    found = fitted(small_fleet(tmp_path / "logs", 2), tmp_path / "out")
    log = rp.read_log(tmp_path / "logs" / "rig1.csv", input="u", output="y")
    alone = rp.fit(log, poles=2)
    row = found.to_pandas().set_index("rig").loc["rig1.csv"]
    assert [row[name] for name in ("a1", "a0", "b0")] == alone.parameters.tolist()
    assert [row[f"{name}_std"] for name in ("a1", "a0", "b0")] == alone.uncertainty.std.tolist()
    assert row["covariance"].tolist() == alone.covariance.ravel().tolist()
    assert (row["fit"], row["verdict"], row["samples"]) == (alone.simulation.fit, alone.verdict.status, alone.samples)
    assert row["reasons"] == "; ".join(alone.verdict.reasons)
    assert row["dc_gain"] == alone.transfer_function.dc_gain
    assert row["damping"] == alone.transfer_function.modes[0].damping
    poles = sorted(alone.transfer_function.poles, key=lambda pole: pole.imag)
    assert [row["pole1_imag"], row["pole2_imag"]] == [pole.imag for pole in poles]
    assert (row["begin"], row["end"]) == (0.0, pytest.approx(599 * DT))
    assert (row["source"], row["files"], row["output_std"]) == ("rig1.csv", 1, pytest.approx(log.output.std()))
    model = found.model("rig1.csv")
    assert model.parameters.tolist() == alone.parameters.tolist()
    assert (model.input_name, model.provenance.source) == ("u", "rig1.csv")


def test_a_rig_without_an_estimate_has_no_coefficients(tmp_path: Path) -> None:
    log = recorded(0)
    as_csv(tmp_path / "logs" / "rig0.csv", replace(log, u=np.ones_like(log.u)))
    (row,) = fitted(tmp_path / "logs", tmp_path / "out", method="run").table().to_pylist()
    assert (row["verdict"], row["samples"], row["dt"]) == ("not excited", 600, pytest.approx(DT))
    assert {row[name] for name in ("a1", "a0", "b0", "pole1_real", "pole1_imag", "dc_gain", "fit")} == {None}


def test_a_row_says_what_run_says(tmp_path: Path) -> None:
    found = fitted(small_fleet(tmp_path / "logs", 1), tmp_path / "out", method="run")
    alone = rp.run(rp.read_log(tmp_path / "logs" / "rig0.csv", input="u", output="y"), poles=2)
    row = found.to_pandas().iloc[0]
    assert [row[name] for name in ("a1", "a0", "b0")] == alone.parameters.tolist()
    assert row["verdict"] == alone.verdict.status


@pytest.mark.slow
def test_a_run_without_its_history_is_the_same_run(tmp_path: Path) -> None:
    """With gaps, outliers and a change of the plant, in several chunks."""
    record = recorded(5, 2500)
    y = record.y.copy()
    y[500:520] = np.nan
    y[1000] += 50.0
    y[1500:] *= 1.3
    request = Request(rp.Structure(2), DT, preprocess=rp.Preprocess("identity", "mean", "mean"))
    kept, lean = (run_source(request, Arrays(record.u, y), with_history=keep) for keep in (True, False))
    assert lean.model == kept.model
    assert (lean.verdict.reasons, lean.rejected, lean.history) == (kept.verdict.reasons, kept.rejected, None)


def test_a_long_record_is_run_without_being_held(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = as_parquet(tmp_path / "logs" / "a.parquet", recorded(0, 3000), row_group_size=500)
    held = fitted(file, tmp_path / "held", method="run").table()
    monkeypatch.setattr("replant.fleet.worker.MOST_HELD", 1000)
    streamed = fitted(file, tmp_path / "streamed", method="run").table()
    for name in ("a1", "a0", "b0", "samples", "begin", "end", "output_held"):
        assert streamed.column(name).to_pylist() == pytest.approx(held.column(name).to_pylist(), rel=1e-9)


@pytest.mark.parametrize("most_held", [100, 10_000])
def test_a_part_of_a_record_with_dates_begins_at_its_date(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_held: int
) -> None:
    record = recorded(0, 400)
    stamps = np.datetime64("1970-01-01T01:00:00") + (1000 * record.t).round().astype("timedelta64[ms]")
    (tmp_path / "logs").mkdir()
    pandas.DataFrame({"t": stamps, "u": record.u, "y": record.y}).to_csv(tmp_path / "logs" / "a.csv", index=False)
    monkeypatch.setattr("replant.fleet.worker.MOST_HELD", most_held)
    row = fitted(tmp_path / "logs", tmp_path / "out", method="run", begin=2.0, end=12.0).table().to_pylist()[0]
    assert (row["begin"], row["end"]) == pytest.approx((3602.0, 3612.0 - DT))


def test_the_table_is_one_for_pandas_polars_and_duckdb(tmp_path: Path) -> None:
    import duckdb  # here: when Python ends, it names types of its own that the search for garbage does not reach

    fitted(small_fleet(tmp_path / "logs", 3), tmp_path / "out")
    path = tmp_path / "out" / "rigs.parquet"
    by_pandas, by_polars = pandas.read_parquet(path), polars.read_parquet(path)
    by_duckdb = duckdb.sql(f"select rig, a0 from '{path}' order by rig").fetchall()
    assert by_pandas["rig"].tolist() == by_polars["rig"].to_list() == [rig for rig, _ in by_duckdb]
    assert by_pandas["a0"].tolist() == by_polars["a0"].to_list() == [a0 for _, a0 in by_duckdb]
    timing = pandas.read_parquet(tmp_path / "out" / "timing.parquet")
    assert timing["rig"].tolist() == by_pandas["rig"].tolist()
    assert (timing["seconds"] > 0.0).all()
    lines = (tmp_path / "out" / "models.jsonl").read_text().splitlines()
    assert [json.loads(line)["rig"] for line in lines] == by_pandas["rig"].tolist()


def test_files_of_one_rig_are_joined_in_the_order_of_time(tmp_path: Path) -> None:
    whole = recorded(3, 900)
    as_parquet(tmp_path / "whole" / "rig=a" / "all.parquet", whole)
    for kind, write in (("parquet", as_parquet), ("csv", as_csv)):
        for name, part in (("z", whole.part(0, 300)), ("m", whole.part(300, 700)), ("a", whole.part(700, 900))):
            write(tmp_path / kind / "rig=a" / f"{name}.{kind}", part)
    expected = fitted(tmp_path / "whole", tmp_path / "out", by="rig").table().to_pylist()[0]
    for kind in ("parquet", "csv"):
        row = fitted(tmp_path / kind, tmp_path / f"out-{kind}", by="rig").table().to_pylist()[0]
        assert row["files"] == 3
        assert {**row, "files": 1, "source": expected["source"]} == expected


@pytest.mark.parametrize("kind", ["parquet", "csv"])
def test_files_of_dates_are_joined_and_their_time_range_is_that_of_the_dates(tmp_path: Path, kind: str) -> None:
    whole = recorded(3, 600)
    stamps = np.datetime64("2026-03-01T12:00:00") + (1000 * whole.t).round().astype("timedelta64[ms]")
    for name, rows in (("b", slice(0, 300)), ("a", slice(300, 600))):
        path = tmp_path / "logs" / "r" / f"{name}.{kind}"
        path.parent.mkdir(parents=True, exist_ok=True)
        columns = {"t": stamps[rows], "u": whole.u[rows], "y": whole.y[rows]}
        if kind == "parquet":
            parquet.write_table(pyarrow.table(columns), path)
        else:
            pandas.DataFrame(columns).to_csv(path, index=False)
    row = fitted(tmp_path / "logs", tmp_path / "out", by="folder").table().to_pylist()[0]
    noon = np.datetime64("2026-03-01T12:00:00").astype("int64")
    assert (row["begin"], row["end"]) == (noon, pytest.approx(noon + 599 * DT))
    assert (row["verdict"], row["samples"], row["notes"]) == ("trusted", 600, "")


@pytest.mark.parametrize("times", ["12:00:0{k}.{tenth}", "01/02/2026 12:00:0{k}.{tenth}"])
def test_text_files_whose_date_is_not_known_are_not_joined(tmp_path: Path, times: str) -> None:
    (tmp_path / "logs" / "r").mkdir(parents=True)
    for k in range(2):
        lines = [f"{times.format(k=k, tenth=tenth)},1,2" for tenth in range(9)]
        (tmp_path / "logs" / "r" / f"{k}.csv").write_text("\n".join(["t,u,y", *lines]))
    (row,) = fitted(tmp_path / "logs", tmp_path / "out", by="folder").table().to_pylist()
    assert "with whole dates (year-month-day" in row["reasons"]


def test_files_that_overlap_in_time_are_a_rig_that_fails(tmp_path: Path) -> None:
    for name in ("a", "b"):
        as_csv(tmp_path / "logs" / "r" / f"{name}.csv", recorded(3, 300))
    as_csv(tmp_path / "logs" / "s" / "a.csv", recorded(3, 300))
    rows = fitted(tmp_path / "logs", tmp_path / "out", by="folder").table().to_pylist()
    assert [row["verdict"] for row in rows] == ["failed", "trusted"]
    assert "of the 2 files joined in the order of time" in rows[0]["reasons"]


def test_two_rigs_in_one_file_are_each_as_alone(tmp_path: Path) -> None:
    records = {"a": recorded(1), "b": recorded(2)}
    tables = [as_table(record, rig=[name] * 600) for name, record in records.items()]
    mixed = pyarrow.concat_tables([tables[0].slice(0, 300), *tables[1:], tables[0].slice(300)])
    (tmp_path / "logs").mkdir()
    parquet.write_table(mixed, tmp_path / "logs" / "both.parquet", row_group_size=250)
    found = fitted(tmp_path / "logs", tmp_path / "out", by="rig")
    for name, record in records.items():
        alone = rp.fit(record.u, record.y, DT, poles=2, preprocess=rp.Preprocess("identity", "mean", "mean"))
        assert found.model(name).parameters.tolist() == alone.parameters.tolist()


def test_what_fails_is_a_row_with_its_reason(tmp_path: Path) -> None:
    logs = small_fleet(tmp_path / "logs", 3)
    (logs / "bad.parquet").write_bytes(b"no Parquet")
    (logs / "words.csv").write_text("t,u,y\n0,1,2\n1,one,2\n")
    as_csv(logs / "short.csv", recorded(0, 3))
    (logs / "other.csv").write_text("t,v,w\n0,1,2\n1,2,3\n")
    (logs / "gone.csv").symlink_to(tmp_path / "nowhere.csv")
    as_parquet(logs / "fine.parquet", recorded(1))
    rows = {row["rig"]: row for row in fitted(logs, tmp_path / "out").table().to_pylist()}
    failed = {name: row["reasons"] for name, row in rows.items() if row["verdict"] == "failed"}
    assert set(failed) == {"bad.parquet", "words.csv", "short.csv", "other.csv"} | ({"gone.csv"} & set(rows))
    assert "line 3" in failed["words.csv"]
    assert "no column 'u'" in failed["other.csv"]
    assert rows["fine.parquet"]["verdict"] == "trusted"
    assert rows["bad.parquet"]["a0"] is None


def test_a_file_that_vanishes_after_the_plan_is_a_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    logs = small_fleet(tmp_path / "logs", 2)
    prepared = Store.missing
    monkeypatch.setattr(
        Store, "missing", lambda *args: ((logs / "rig0.csv").unlink(missing_ok=True), prepared(*args))[1]
    )
    rows = fitted(logs, tmp_path / "out").table().to_pylist()
    assert [row["verdict"] for row in rows] == ["failed", "trusted"]
    assert "no such file" in rows[0]["reasons"]


def test_an_unexpected_error_of_one_rig_is_not_the_end_of_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:

    original = worker.opened

    def failing(rig: object, job: object) -> object:
        if rig.name == "rig0.csv":
            raise ZeroDivisionError("oh")
        return original(rig, job)

    monkeypatch.setattr(worker, "opened", failing)
    rows = fitted(small_fleet(tmp_path / "logs", 2), tmp_path / "out").table().to_pylist()
    assert rows[0]["reasons"] == "unexpected ZeroDivisionError: oh"
    assert rows[1]["verdict"] == "trusted"


# --- what is done again


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The rigs identified, in this process."""
    seen: list[str] = []
    original = worker.identify
    monkeypatch.setattr(worker, "identify", lambda rig, job: (seen.append(rig.name), original(rig, job))[1])
    return seen


def test_what_is_done_is_not_done_again(tmp_path: Path, counted: list[str]) -> None:
    logs, out = small_fleet(tmp_path / "logs", 3), tmp_path / "out"
    fitted(logs, out)
    first = bytes_of(out)
    assert sorted(counted) == ["rig0.csv", "rig1.csv", "rig2.csv"]
    counted.clear()
    fitted(logs, out)
    assert (counted, bytes_of(out)) == ([], first)
    as_csv(logs / "rig1.csv", recorded(50))
    as_csv(logs / "new.csv", recorded(51))
    (logs / "rig0.csv").unlink()
    found = fitted(logs, out)
    assert sorted(counted) == ["new.csv", "rig1.csv"]
    assert found.table().column("rig").to_pylist() == ["new.csv", "rig1.csv", "rig2.csv"]
    counted.clear()
    fitted(logs, out, poles=1)
    assert sorted(counted) == ["new.csv", "rig1.csv", "rig2.csv"]
    with contextlib.closing(sqlite3.connect(out / "fleet.sqlite")) as store:
        assert store.execute("SELECT count(*) FROM rig").fetchone() == (3,)


@pytest.mark.parametrize("where", [0.0, 0.3, 0.5, 0.9])
def test_what_a_damaged_file_does_not_tell_for_sure_is_done_again(
    tmp_path: Path, counted: list[str], where: float
) -> None:
    logs, out = small_fleet(tmp_path / "logs", 3), tmp_path / "out"
    fitted(logs, out)
    first = bytes_of(out)
    stored = bytearray((out / "fleet.sqlite").read_bytes())
    stored[int(where * len(stored)) : int(where * len(stored)) + 200] = b"x" * 200
    (out / "fleet.sqlite").write_bytes(stored)
    (out / f".half{ENDING}").write_bytes(b"half")
    counted.clear()
    fitted(logs, out)
    assert bytes_of(out) == first
    assert set(counted) <= {"rig0.csv", "rig1.csv", "rig2.csv"}
    assert not list(out.glob(".*"))


def test_a_cell_that_is_damaged_is_done_again(tmp_path: Path, counted: list[str]) -> None:
    logs, out = small_fleet(tmp_path / "logs", 3), tmp_path / "out"
    fitted(logs, out)
    first = bytes_of(out)
    with contextlib.closing(sqlite3.connect(out / "fleet.sqlite")) as store, store:
        store.execute(
            "UPDATE rig SET cells = CAST(substr(cells, 1, 300) || x'00' || substr(cells, 302) AS BLOB) WHERE rowid = 2"
        )
    counted.clear()
    fitted(logs, out)
    assert (len(counted), bytes_of(out)) == (1, first)


def test_a_full_disk_ends_the_run_and_the_next_one_goes_on(tmp_path: Path, counted: list[str]) -> None:
    logs, out = small_fleet(tmp_path / "logs", 4), tmp_path / "out"
    fitted(logs, tmp_path / "other")
    with full_disk(4096), pytest.raises(SystemRefusedError, match=r"cannot be written: .*File too large"):
        fitted(logs, out)
    assert not (out / "rigs.parquet").exists()
    fitted(logs, out)
    assert bytes_of(out) == bytes_of(tmp_path / "other")


def test_lack_of_memory_is_no_row(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def greedy(*args: object) -> None:
        raise MemoryError

    monkeypatch.setattr("replant.fleet.worker.opened", greedy)
    with pytest.raises(SystemRefusedError, match=r"rig rig0.csv: out of memory.*or use the method run"):
        fitted(small_fleet(tmp_path / "logs", 1), tmp_path / "out")


def test_one_run_at_a_time_writes_a_folder(tmp_path: Path) -> None:
    logs, out = small_fleet(tmp_path / "logs", 1), tmp_path / "out"
    job = Job("u", "y", rp.Structure(2), "fit")
    with Store(out, job).alone(), pytest.raises(SystemRefusedError, match="another run writes there"):
        fitted(logs, out)


@every(
    ("options", "says"),
    [
        ({"method": "guess"}, "method"),
        ({"method": "fit", "optimizer": "adam"}, "only the method run takes an optimizer"),
        ({"dt": 0.1, "time": "t"}, "give either the time column"),
        ({"executor": "cluster"}, "is not an executor; give threads:N"),
    ],
)
def test_options_that_cannot_be_used_are_refused(tmp_path: Path, options: dict, says: str) -> None:
    with pytest.raises(InvalidArgumentError, match=says):
        fitted(small_fleet(tmp_path / "logs", 1), tmp_path / "out", **options)


def test_a_rig_without_a_model_is_told(tmp_path: Path) -> None:
    found = fitted(small_fleet(tmp_path / "logs", 1), tmp_path / "out")
    with pytest.raises(InvalidArgumentError, match="no rig 'x' with a model"):
        found.model("x")
    with pytest.raises(LogError, match="no results"):
        rp.fleet.load(tmp_path)
    assert os.fspath(rp.fleet.load(tmp_path / "out").folder) == os.fspath(tmp_path / "out")
