"""A fleet of rigs with two inputs: a transfer function from each, in columns that are named by it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.errors import InvalidArgumentError
from replant.fleet import worker
from replant.fleet.job import Job, Shape
from replant.fleet.odd_rigs import oddness_of
from replant.fleet.statistics import Deviation, Quantity, quantities_of, unit_factor
from replant.fleet.store import schema
from support.cases import every
from support.fleets import two_inputs

DT, SAMPLES = 0.1, 600
ASKED = {"input": ("Q1", "Q2"), "output": "T1", "poles": (1, 1), "delay": (0.0, 0.3)}


def fitted(folder: Path, out: Path, **more: object) -> rp.fleet.Fleet:
    return rp.fleet.fit(folder, by="file", out=out, **{**ASKED, "method": "fit", **more})


def test_a_row_of_the_table_is_what_fit_says(tmp_path: Path) -> None:
    log = two_inputs(tmp_path / "logs" / "a.csv", 0)
    two_inputs(tmp_path / "logs" / "b.csv", 1)
    found = fitted(tmp_path / "logs", tmp_path / "out")
    alone = rp.fit(rp.read_log(log, input=["Q1", "Q2"], output="T1"), poles=(1, 1), delay=(0.0, 0.3))
    row = found.table().to_pylist()[0]
    assert [row[name] for name in alone.names] == alone.parameters.tolist()
    assert [row[f"{name}_std"] for name in alone.names] == np.sqrt(np.diag(alone.covariance)).tolist()
    assert row["covariance"] == alone.covariance.ravel().tolist()
    assert [row[f"dc_gain.{name}"] for name in ("Q1", "Q2")] == [g.dc_gain for g in alone.transfer_functions]
    assert [row[f"pole1_real.{name}"] for name in ("Q1", "Q2")] == [g.poles[0] for g in alone.transfer_functions]
    assert (row["fit"], row["samples"], row["verdict"]) == (alone.fit, alone.samples, alone.verdict.status)
    assert (row["input_std.Q1"], row["input_std.Q2"]) == pytest.approx((1.0, 1.0), abs=0.05)
    assert (row["begin"], row["end"]) == pytest.approx((0.0, DT * (SAMPLES - 1)))
    for fleet in (found, rp.fleet.load(tmp_path / "out")):
        assert isinstance(fleet.model("a.csv"), rp.RowModel)
        assert fleet.model("a.csv").parameters.tolist() == alone.parameters.tolist()
        assert fleet.shape == found.shape


def test_each_input_has_a_reference(tmp_path: Path) -> None:
    log = two_inputs(tmp_path / "logs" / "a.csv", 0)
    header, *rows = log.read_text().splitlines()
    r = np.random.default_rng(0).standard_normal((len(rows), 2)).tolist()
    lines = (f"{row},{first},{second}" for row, (first, second) in zip(rows, r, strict=True))
    log.write_text("\n".join([f"{header},r1,r2", *lines]))
    found = fitted(tmp_path / "logs", tmp_path / "out", reference=["r1", "r2"]).table().to_pylist()[0]
    names = {"input": ["Q1", "Q2"], "output": "T1", "reference": ["r1", "r2"]}
    alone = rp.fit(rp.read_log(log, **names), poles=(1, 1), delay=(0.0, 0.3))
    assert [found[name] for name in alone.names] == alone.parameters.tolist()
    assert "the reference explains nothing of any input" in found["reasons"]


def test_a_run_is_one_pass_over_each_log(tmp_path: Path) -> None:
    two_inputs(tmp_path / "logs" / "a.csv", 0)
    model = fitted(tmp_path / "logs", tmp_path / "out", method="run").model("a.csv")
    assert model.provenance.method == "recursive srivc"
    assert [g.dc_gain for g in model.transfer_functions] == pytest.approx([2.0, 2.5], rel=0.05)


def test_finished_rigs_are_kept_and_bytes_do_not_depend_on_the_executor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(3):
        two_inputs(tmp_path / "logs" / f"{k}.csv", k)
    fitted(tmp_path / "logs", tmp_path / "whole", executor="threads:2")
    held = tmp_path / "2.csv"
    (tmp_path / "logs" / "2.csv").rename(held)
    fitted(tmp_path / "logs", tmp_path / "out")
    held.rename(tmp_path / "logs" / "2.csv")
    done, once = [], worker.identify
    monkeypatch.setattr(worker, "identify", lambda rig, job: (done.append(rig.name), once(rig, job))[1])
    fitted(tmp_path / "logs", tmp_path / "out")
    assert done == ["2.csv"]
    for name in ("rigs.parquet", "models.jsonl"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.slow
def test_odd_rigs_are_named_by_the_input_whose_gain_is_off(tmp_path: Path) -> None:
    for k in range(16):
        gains = (2.0, 25.0) if k == 3 else (2.0 + 0.02 * k, 2.5)
        two_inputs(tmp_path / "logs" / f"rig{k:02}.csv", k, gains, moves=0.0 if k == 5 else 1.0)
    found = fitted(tmp_path / "logs", tmp_path / "out")
    said = dict(zip(found.table().column("rig").to_pylist(), oddness_of(found.table(), found.shape).words, strict=True))
    assert "the gain of Q2 is 10 times the fleet's" in said.pop("rig03.csv")
    assert said.pop("rig05.csv") == "the input Q2 does not move"
    assert set(said.values()) == {""}
    page = rp.fleet.write_page(found).read_text()
    assert "Q1 → T1, 1 pole; Q2 → T1, 1 pole; 16 rigs by file" in page
    data = json.loads(re.search(r'id="data"[^>]*>(.*?)</script>', page, re.DOTALL)[1])
    names = [column["name"] for column in data["columns"]]
    assert {"gain of Q1", "time constant of Q2 [s]", "a0.Q1", "b0.Q2"} <= set(names)


def test_columns_and_quantities_are_those_of_each_input() -> None:
    shape = Shape((rp.Structure(1), rp.Structure(2)), ("a", "b"))
    assert [each.label for each in quantities_of(shape)] == [
        "gain of a", "time constant of a", "gain of b", "natural frequency of b", "damping of b"
    ]  # fmt: skip
    poles = [name for name in schema(shape).names if name.startswith("pole") and "real" in name]
    assert poles == ["pole1_real.a", "pole1_real.b", "pole2_real.b"]


@every(
    "second, said",
    [
        (0.0, "the gain of a is 1000 times the fleet's, nearly: a power of ten"),
        (np.log(1000.0), "the gain of a is 1000 times the fleet's, nearly: a power of ten"),
        (0.5, ""),
    ],
)
def test_a_wrong_unit_leaves_the_other_gains_or_turns_them_likewise(second: float, said: str) -> None:
    off = zip((Quantity("gain", (), input="a"), Quantity("gain", (), input="b")), (np.log(1000.0), second), strict=True)
    assert unit_factor([Deviation(each, ratio, 0.01, 0, 0.0) for each, ratio in off]) == said


@every(
    "words, given",
    [
        ("input 'Q1' is given twice", {"input": ("Q1", "Q1")}),
        ("input must name a column, got none", {"input": (), "poles": (), "delay": ()}),
        ("poles has 3 entries and u 2 inputs", {"poles": (1, 1, 1)}),
        ("give the number of poles of each", {"poles": 1}),
        ("poles has 2 entries for one input: name the other inputs, too", {"input": "Q1"}),
        ("one input takes one reference, got 2", {"input": "Q1", "poles": 1, "delay": 0.0, "reference": ["a", "b"]}),
        ("several inputs take no optimizer yet", {"optimizer": "adam"}),
        ("several inputs take no input_map yet", {"input_map": "square"}),
    ],
)
def test_a_mistake_is_named(tmp_path: Path, words: str, given: dict[str, object]) -> None:
    two_inputs(tmp_path / "logs" / "a.csv", 0)
    with pytest.raises(InvalidArgumentError, match=re.escape(words)):
        fitted(tmp_path / "logs", tmp_path / "out", **{"method": "run", **given})


def test_a_job_of_one_input_has_the_digest_that_it_had() -> None:
    """Otherwise the finished rigs of older versions would be identified again."""
    assert "input='u', output='y', structure=Structure(poles=2, " in repr(Job("u", "y", rp.Structure(2)))
