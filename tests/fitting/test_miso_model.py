"""A model of several inputs: its file, its simulation, and its validation on other records."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import replant as rp
from replant.numerics.arguments import FloatArray
from support.cases import every

SCHEMA = json.loads(files("replant.fitting").joinpath("schema/model-2.json").read_text())
DT, SAMPLES = 0.05, 2400
FAST, SLOW = rp.TransferFunction([20.0], [1.0, 11.0, 10.0]), rp.TransferFunction([0.2], [1.0, 0.1], delay=0.3)
STRUCTURES = rp.Structure(2), rp.Structure(1, delay=0.3)


def record(seed: int, noise: float = 0.2, *plant: rp.TransferFunction, offset: float = 5.0) -> tuple[FloatArray, Any]:
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (SAMPLES // 10, 2)).repeat(10, axis=0)
    y = np.sum([g.simulate(column.copy(), DT) for g, column in zip(plant or (FAST, SLOW), u.T, strict=True)], axis=0)
    return u, offset + y + noise * rng.standard_normal(y.size)


@pytest.fixture(scope="module")
def model() -> rp.RowModel:
    return rp.fit(*record(0), DT, poles=(2, 1), delay=(0.0, 0.3)).model


def test_a_file_gives_the_model_back_to_the_bit(model: rp.RowModel, tmp_path: Path) -> None:
    named = model.of_log(("Q1 [%]", "Q2 [%]"), "T1", "heaters.csv", "ab" * 32)
    named.save(tmp_path / "row.json")
    again = rp.load_model(tmp_path / "row.json")
    assert again == named != model
    assert again.to_json() == named.to_json()
    jsonschema.Draft202012Validator(SCHEMA).validate(json.loads(again.to_json()))
    u, _ = record(1)
    assert (again.simulate(u) == model.simulate(u)).all()
    assert again.names == ("a1.Q1 [%]", "a0.Q1 [%]", "b0.Q1 [%]", "a0.Q2 [%]", "b0.Q2 [%]")


def test_each_kind_of_model_names_the_reader_of_the_other(model: rp.RowModel) -> None:
    one = rp.Model(rp.Structure(1), [1.0, 2.0], dt=DT)
    with pytest.raises(rp.ModelFileError, match="several inputs: read it by load_model"):
        rp.Model.from_json(model.to_json())
    with pytest.raises(rp.ModelFileError, match="one input: read it by load_model"):
        rp.RowModel.from_json(one.to_json())


@every(
    "change, words",
    [
        ({"num": [[1.0]]}, "'num' must have an item for each input"),
        ({"den": [[1.0, 2.0], [1.0, 2.0]]}, "'den' contradicts 'parameters'"),
        ({"delay": [0.0, 0.4]}, "'delay' contradicts 'structure'"),
        ({"structure": []}, "'structure' must have an item"),
        ({"structure": [1, 2]}, "'structure' must be an object"),
        ({"input": [{"name": "a", "level": 0.0}] * 2}, "'parameters' must be"),
        ({"parameters": {}}, "'parameters' must be a1.u1"),
        ({"covariance": [[1.0]]}, "'covariance' must be 5 lists"),
        ({"schema_version": 4}, "install a newer replant"),
        ({"input_hold": "sinc"}, "input_hold"),
    ],
)
def test_a_file_that_is_no_model_says_what_is_wrong(model: rp.RowModel, change: dict[str, Any], words: str) -> None:
    whole = json.loads(model.to_json()) | change
    with pytest.raises(rp.ModelFileError, match=words) as caught:
        rp.RowModel.from_json(json.dumps(whole))
    assert "\n" not in str(caught.value)


def test_the_simulation_begins_at_rest_in_absolute_units(model: rp.RowModel) -> None:
    model = rp.RowModel(
        STRUCTURES, [11.0, 10.0, 20.0, 0.1, 0.2], DT, input_levels=[3.0, 4.0], output_level=50.0,
        provenance=model.provenance,
    )  # fmt: skip
    held = np.tile([4.0, 4.0], (9, 1))
    assert model.simulate(held) == pytest.approx(np.full(9, 52.0))  # FAST has the gain 2
    u, _ = record(2)
    whole = model.simulate(u)
    alone = [model.of_input(which).simulate(column.copy()) for which, column in zip((0, "u2"), u.T, strict=True)]
    assert whole - 50.0 == pytest.approx(np.sum(alone, axis=0) - 100.0)
    t = DT * np.arange(len(u))
    assert model.simulate(u, t) == pytest.approx(whole, abs=1e-9)


def test_a_right_model_is_trusted_on_other_records_and_a_wrong_one_is_not(model: rp.RowModel) -> None:
    trusted = 0
    for seed in range(1, 21):
        found = model.validate(*record(seed, offset=7.0))
        trusted += found.verdict.status == "trusted"
        assert abs(found.offset - 2.0) < 0.5
    assert trusted >= 17  # each test has a level of 1 %, and the model errors of its own
    changed = rp.TransferFunction([26.0], [1.0, 11.0, 10.0]), SLOW
    verdict = model.validate(*record(1, 0.2, *changed)).verdict
    assert verdict.status == "inconsistent"
    assert "the inputs could explain a further" in verdict.reasons[0]


def test_a_log_of_several_inputs_is_fitted_and_validated_as_arrays_are(model: rp.RowModel) -> None:
    u, y = record(0)
    log = rp.Log(u[:, 0], y, DT, input_name="heater", others={"fan": u[:, 1]}, more_inputs=("fan",))
    found = rp.fit(log, poles=(2, 1), delay=(0.0, 0.3))
    assert found.model.input_names == ("heater", "fan")
    assert (found.parameters == model.parameters).all()
    other, z = record(1)
    again = rp.Log(other[:, 0], z, DT, others={"fan": other[:, 1]}, more_inputs=("fan",))
    assert found.model.validate(again).fit == model.validate(other, z).fit
    with pytest.raises(rp.InvalidArgumentError, match="u must have a column for each of 2 inputs"):
        model.validate(rp.Log(other[:, 0], z, DT))


def log_of(u: FloatArray, y: Any, *names: str) -> rp.Log:
    others = dict(zip(names[1:], u.T[1:], strict=True))
    return rp.Log(u[:, 0], y, DT, input_name=names[0], others=others, more_inputs=names[1:])


@every("given", [("heater", "fan"), ("Q1", "Q2"), ("Q1 [%]", "Q2 [%]"), ("Q1", "Q2 [V]")])
def test_a_log_gives_its_inputs_by_name(model: rp.RowModel, given: tuple[str, str]) -> None:
    named = model.of_log(("heater", "fan") if given[0] == "heater" else ("Q1 [%]", "Q2 [V]"), "y", "")
    u, y = record(1)
    fit = model.validate(u, y).fit
    assert named.validate(log_of(u, y, *given)).fit == fit
    assert named.validate(log_of(u[:, ::-1], y, *given[::-1])).fit == fit


@every(
    "given, words",
    [
        (("Q1", "fan"), "the log has no input Q2, but Q1, fan"),
        (("Q3", "Q4"), "the log has no input Q1, but Q3, Q4"),
        (("Q1",), "the log has no input Q2"),
        (("Q1", "Q2", "Q3"), "u must have a column for each of 2 inputs"),
    ],
)
def test_a_log_that_lacks_an_input_is_refused(model: rp.RowModel, given: tuple[str, ...], words: str) -> None:
    u, y = record(1)
    log = log_of(np.column_stack([u, u[:, 0]])[:, : len(given)], y, *given)
    with pytest.raises(rp.InvalidArgumentError, match=words):
        model.of_log(("Q1", "Q2"), "y", "").validate(log)
    if len(given) == 2:  # a model of arrays has no names
        assert model.validate(log).fit == model.validate(u, y).fit


def test_two_records_give_one_model_with_an_offset_each() -> None:
    logs = []
    for seed, offset in ((3, 0.0), (4, 90.0)):
        u, y = record(seed, offset=offset)
        logs.append(rp.Log(u[:, 0], y, DT, others={"fan": u[:, 1]}, more_inputs=("fan",)))
    both = rp.fit(logs, poles=(2, 1), delay=(0.0, 0.3))
    each = [rp.fit(log, poles=(2, 1), delay=(0.0, 0.3)) for log in logs]
    assert both.verdict.status == "trusted"
    assert both.samples == sum(one.samples for one in each)
    added = np.sum([np.linalg.inv(one.covariance) for one in each], axis=0)
    assert np.linalg.inv(both.covariance) == pytest.approx(added, rel=0.3, abs=0.05 * np.abs(added).max())


def test_a_signal_that_should_be_an_input_is_named() -> None:
    u, y = record(5)
    rest, fan = (np.random.default_rng(seed).choice([-1.0, 1.0], SAMPLES // 10).repeat(10) for seed in (9, 8))
    y = y + rp.TransferFunction([2.0], [1.0, 1.0]).simulate(fan, DT)
    columns = {"Q2": u[:, 1], "fan": fan, "rest": rest}
    log = rp.Log(u[:, 0], y, DT, input_name="Q1", others=columns, more_inputs=("Q2",))
    found = rp.fit(log, poles=(2, 1), delay=(0.0, 0.3)).verdict
    assert found.status == "inconsistent"
    assert any("column fan could explain a further" in reason for reason in found.reasons)
    assert not any("rest" in reason for reason in found.reasons)
    whole = rp.Log(u[:, 0], y, DT, input_name="Q1", others=columns, more_inputs=("Q2", "fan"))
    assert rp.fit(whole, poles=(2, 1, 1), delay=(0.0, 0.3, 0.0)).verdict.status == "trusted"


def test_the_row_in_python_control_answers_as_the_branches_do(model: rp.RowModel) -> None:
    control = pytest.importorskip("control")
    system = model.to_control(pade=3)
    assert (system.ninputs, system.noutputs) == (2, 1)
    for number, g in enumerate(model.transfer_functions):
        assert control.dcgain(system)[0, number] == pytest.approx(g.dc_gain)
