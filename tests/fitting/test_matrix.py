"""Several outputs: a matrix of transfer functions, each row estimated by itself on the same inputs."""

from __future__ import annotations

import json
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pandas as pd
import pytest

import replant as rp
from replant.numerics.arguments import FloatArray
from support.cases import every

DT = 0.1
PLANT = (
    (rp.TransferFunction([2.0], [1.0, 1.0]), rp.TransferFunction([0.5], [1.0, 0.2], delay=0.3)),
    (rp.TransferFunction([1.0], [1.0, 2.0]), rp.TransferFunction([0.25], [1.0, 0.5], delay=0.3)),
)
ASKED: dict[str, Any] = {"poles": (1, 1), "delay": (0.0, 0.3)}


def record(seed: int, samples: int = 600) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (samples // 10, 2)).repeat(10, axis=0)
    rows = [sum(g.simulate(column.copy(), DT) for g, column in zip(row, u.T, strict=True)) for row in PLANT]
    return u, np.column_stack(rows) + np.array([5.0, 40.0]) + 0.05 * rng.standard_normal((samples, 2))


U, Y = record(0)


@cache
def whole(call: Any) -> rp.MatrixFit:
    matrix = call(U, Y, DT, **ASKED)
    assert isinstance(matrix, rp.MatrixFit)
    return matrix


@cache
def alone(call: Any, number: int) -> Any:
    """What a call finds of an output by itself."""
    return call(U, Y[:, number].copy(), DT, **ASKED)


@pytest.fixture(scope="module")
def found() -> rp.MatrixFit:
    return whole(rp.fit)


def test_each_row_is_the_fit_of_its_output_alone(found: rp.MatrixFit) -> None:
    for number, row in enumerate(found.rows):
        assert (row.parameters == alone(rp.fit, number).parameters).all()
        np.testing.assert_array_equal(row.output, alone(rp.fit, number).output)
    assert [each.status for each in found.verdicts] == ["trusted", "trusted"]
    for row, true in zip(found.transfer_functions, PLANT, strict=True):
        for g, plant in zip(row, true, strict=True):
            assert g.dc_gain == pytest.approx(plant.dc_gain, rel=0.05)
    assert found.output.shape == Y.shape
    assert "y2: RowFit" in repr(found)


def test_the_model_simulates_and_validates_all_outputs(found: rp.MatrixFit) -> None:
    model = found.model
    u, y = record(1)
    simulated = model.simulate(u)
    for number, row in enumerate(model.rows):
        assert (simulated[:, number] == row.simulate(u)).all()
        parts = row.contributions(u)
        assert row.output_level + parts.sum(axis=1) == pytest.approx(simulated[:, number])
        assert row.of_input(1).simulate(u[:, 1].copy()) - row.output_level == pytest.approx(parts[:, 1])
    assert all(each.fit > 80.0 for each in model.validate(u, y))
    assert model.of_output("y2") is model.of_output(1) is model.rows[1]


def test_a_log_gives_inputs_and_outputs_by_name(found: rp.MatrixFit) -> None:
    model = rp.MatrixModel(
        [row.of_log(("Q1", "Q2"), row.output_name.replace("y", "T"), "") for row in found.model.rows]
    )
    u, y = record(1)
    wanted = [each.fit for each in model.validate(u, y)]
    columns = {"Q1": u[:, 0], "Q2": u[:, 1], "T1": y[:, 0], "T2 [degC]": y[:, 1]}
    for first, output in (("Q1", "T1"), ("Q2", "T2 [degC]")):
        more = tuple({"Q1", "Q2"} - {first})
        log = rp.Log(
            columns[first], columns[output], DT, input_name=first, output_name=output, more_inputs=more,
            others={name: each for name, each in columns.items() if name not in (first, output)},
        )  # fmt: skip
        assert [each.fit for each in model.validate(log)] == wanted
    lacking = rp.Log(
        u[:, 0], y[:, 0], DT, input_name="Q1", output_name="T1", others={"Q2": u[:, 1]}, more_inputs=["Q2"]
    )
    with pytest.raises(rp.InvalidArgumentError, match="the log has no output T2, but T1"):
        model.validate(lacking)
    with pytest.raises(rp.InvalidArgumentError, match="give a Log, or the inputs and the outputs"):
        model.validate(u)
    with pytest.raises(rp.InvalidArgumentError, match="a log has its own output and time"):
        model.validate(log, y)


def test_a_file_gives_the_matrix_back_to_the_bit(found: rp.MatrixFit, tmp_path: Path) -> None:
    model = found.model
    model.save(tmp_path / "matrix.json")
    again = rp.load_model(tmp_path / "matrix.json")
    assert again == model
    assert again.to_json() == model.to_json()
    schemas = [json.loads(files("replant.fitting").joinpath(f"schema/model-{k}.json").read_text()) for k in (2, 3)]
    whole = json.loads(model.to_json())
    jsonschema.Draft202012Validator(schemas[1]).validate(whole)
    for row in whole["rows"]:
        jsonschema.Draft202012Validator(schemas[0]).validate(row)
    with pytest.raises(rp.ModelFileError, match="several outputs: read it by load_model"):
        rp.RowModel.from_json(model.to_json())
    with pytest.raises(rp.ModelFileError, match="several inputs: read it by load_model"):
        rp.MatrixModel.from_json(model.rows[0].to_json())


def test_python_control_has_the_gains_of_the_matrix(found: rp.MatrixFit) -> None:
    control = pytest.importorskip("control")
    system = found.model.to_control(pade=2)
    assert (system.noutputs, system.ninputs) == (2, 2)
    gains = [[g.dc_gain for g in row] for row in found.transfer_functions]
    assert control.dcgain(system) == pytest.approx(np.array(gains))


def test_the_pictures_have_a_cell_for_each_pair(found: rp.MatrixFit) -> None:
    grid = found.model.plot()
    assert [[axis.get_title("left") for axis in row] for row in grid] == [
        ["u1 → y1", "u2 → y1"],
        ["u1 → y2", "u2 → y2"],
    ]
    for row, line in zip(found.transfer_functions, grid, strict=True):
        for g, axis in zip(row, line, strict=True):
            assert axis.lines[0].get_ydata()[-1] == pytest.approx(g.dc_gain, rel=0.01)
    columns = found.model.rows[0].plot()
    assert columns.shape == (3, 2)
    assert columns[1, 0].lines[0].get_ydata()[0] == pytest.approx(
        20.0 * np.log10(found.transfer_functions[0][0].dc_gain), abs=0.1
    )


def test_one_input_and_orders_of_each_output() -> None:
    u = U[:, 0].copy()
    y = np.column_stack([PLANT[0][0].simulate(u, DT), rp.TransferFunction([4.0], [1.0, 2.0, 4.0]).simulate(u, DT)])
    found = rp.fit(u, y, DT, poles=((1,), (2,)))
    assert isinstance(found, rp.MatrixFit)
    assert [row.parameters.size for row in found.rows] == [2, 3]
    assert found.rows[1].parameters == pytest.approx([2.0, 4.0, 4.0], rel=1e-6)
    assert rp.fit(u, y[:, [0, 0]] + [[0.0, 1.0]], DT, poles=1).rows[1].parameters == pytest.approx([1.0, 2.0])


HEATERS = pd.DataFrame({"t": DT * np.arange(600), "Q1": U[:, 0], "Q2": U[:, 1], "T1": Y[:, 0], "T2": Y[:, 1]})
NAMED: dict[str, Any] = {"input": ["Q1", "Q2"], "output": "T1"}


@pytest.mark.slow
def test_every_input_of_a_table_counts() -> None:
    ran, fitted = (call(HEATERS, **NAMED, **ASKED) for call in (rp.run, rp.fit))
    for row in (ran, fitted):
        assert row.model.input_names == ("Q1", "Q2")
    assert ran.parameters == pytest.approx(alone(rp.run, 0).parameters)
    assert fitted.parameters == pytest.approx(alone(rp.fit, 0).parameters)
    found = rp.search(HEATERS, **NAMED, poles=1, delays=((0.0,), (0.0, 0.3)))
    assert found.best.model.input_names == ("Q1", "Q2")
    assert found.delays[1] == pytest.approx(0.3, abs=0.02)
    with pytest.raises(rp.InvalidArgumentError, match="there are 2 inputs"):
        rp.run(HEATERS, **NAMED, poles=1)
    with pytest.raises(rp.InvalidArgumentError, match="several inputs take no structure"):
        rp.run(HEATERS, **NAMED, structure=rp.Structure(1))


@pytest.mark.slow
@pytest.mark.parametrize("call", [rp.fit, rp.run])
def test_fit_and_run_take_outputs_as_columns_or_by_name(call: Any) -> None:
    matrix = whole(call)
    table = call(HEATERS, input=["Q1", "Q2"], output=["T2", "T1"], **ASKED)
    assert matrix.model.output_names == ("y1", "y2")
    assert table.model.output_names == ("T2", "T1")
    assert table.model.input_names == ("Q1", "Q2")
    for row, number in zip((*matrix.rows, *table.rows), (0, 1, 1, 0), strict=True):
        one = alone(call, number)
        assert row.parameters == pytest.approx(one.parameters, rel=1e-9)
        assert row.verdict.status == one.verdict.status == "trusted"


@pytest.mark.slow
def test_a_search_takes_outputs_as_columns_or_by_name() -> None:
    grid: dict[str, Any] = {"poles": (1, 2), "zeros": 0}
    delays = ((0.0,), (0.0, 0.3))
    for found in (
        rp.search(U, Y, DT, **grid, delays=delays),
        rp.search(HEATERS, input=["Q1", "Q2"], output=["T1", "T2"], **grid, delays=delays),
    ):
        assert [row.delays[1] for row in found.rows] == pytest.approx([0.3, 0.3], abs=0.05)
        assert isinstance(found.best, rp.MatrixFit)
    u = U[:, 0].copy()
    y = np.column_stack([PLANT[0][0].simulate(u, DT), rp.TransferFunction([4.0], [1.0, 2.0, 4.0]).simulate(u, DT)])
    y += 0.01 * np.random.default_rng(0).standard_normal(y.shape)
    table = pd.DataFrame({"t": DT * np.arange(600), "Q1": u, "a": y[:, 0], "b": y[:, 1]})
    steps: list[tuple[int, int]] = []
    for found in (
        rp.search(u, y, DT, **grid, progress=lambda done, of: steps.append((done, of))),
        rp.search(table, input="Q1", output=["a", "b"], **grid),
    ):
        assert [row.model.structures[0].poles for row in found.best.rows] == [1, 2]
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    assert steps[-1] == (4, 4)


@every(
    "y, asked, words",
    [
        (Y, {"poles": (1, 1, 1)}, "poles has 3 entries and u 2 inputs"),
        (Y, {"poles": ((1, 1),) * 3}, "poles has 3 tuples and y 2 outputs"),
        (Y, {"poles": (1, 1), "reference": Y[:9]}, "reference must have one value for each of 600 samples"),
        (Y, {"poles": (1, 1), "method": "srivc"}, "several outputs take no method yet"),
        (Y[:9], {"poles": (1, 1)}, "u has 600 rows and y 9 samples"),
        (Y, {"poles": 1}, "there are 2 inputs"),
    ],
)
def test_what_does_not_match_is_named_in_a_line(y: Any, asked: dict[str, Any], words: str) -> None:
    with pytest.raises(rp.ReplantError, match=words) as caught:
        rp.fit(U, y, DT, **asked)
    assert "\n" not in str(caught.value)


@every(
    "outputs, words",
    [
        (["T1", "T1"], "name each column once, got 'T1', 'T1'"),
        (["T1", "T3"], "output must name a column, got 'T3'"),
        (["T1", "Q2"], "column 'Q2' is the output and an input: name each column once"),
        ([], "output must name a column"),
    ],
)
def test_outputs_of_a_table_that_are_none_are_named(outputs: list[str], words: str) -> None:
    with pytest.raises(rp.ReplantError, match=words):
        rp.fit(HEATERS, input=["Q1", "Q2"], output=outputs, **ASKED)


def test_rows_that_do_not_belong_together_are_refused(found: rp.MatrixFit) -> None:
    first, second = found.model.rows
    with pytest.raises(rp.InvalidArgumentError, match="outputs of different names"):
        rp.MatrixModel((first, first))
    with pytest.raises(rp.InvalidArgumentError, match="the same input_names"):
        rp.MatrixModel((first, second.of_log(("a", "b"), "y2", "")))
    with pytest.raises(rp.ArgumentTypeError, match="a RowModel for each output"):
        rp.MatrixModel(first)
    with pytest.raises(rp.InvalidArgumentError, match="which must be one of y1, y2"):
        found.model.of_output(2)
    with pytest.raises(rp.InvalidArgumentError, match="a column for each of 2 outputs, got 1"):
        found.model.validate(U, Y[:, :1])
