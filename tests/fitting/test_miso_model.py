"""A model of several inputs: its file, its simulation, and its validation on other records."""

from __future__ import annotations

import json
from dataclasses import replace
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


def test_a_row_that_the_record_knows_better_is_neither_confirmed_nor_of_another_plant(model: rp.RowModel) -> None:
    """A gain is a quarter off: as much as the model says, or fifty times as much."""
    parameters = model.parameters * [1.0, 1.0, 1.25, 1.0, 1.0]
    for part, status in ((0.25, "converging"), (0.005, "inconsistent")):
        off = replace(model, parameters=parameters, covariance=np.diag((part * parameters) ** 2))
        verdict = off.validate(*record(1)).verdict
        assert verdict.status == status
        assert ("than the uncertainty of the model allows" in verdict.reasons[0]) == (status == "converging")


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


@pytest.mark.slow
def test_prediction_uses_the_colour_of_the_residual() -> None:
    u, y = record(6, 0.0)
    white = 0.1 * np.random.default_rng(7).standard_normal(y.size)
    noise = np.zeros(y.size)
    for k in range(1, y.size):
        noise[k] = 0.95 * noise[k - 1] + white[k]
    y = y + noise
    model = rp.fit(u, y, DT, poles=(2, 1), delay=(0.0, 0.3)).model
    predicted = model.predict(u, y)
    errors = [np.nanstd(y - model.predict(u, y, horizon)) for horizon in (1, 3)]
    assert errors[0] == pytest.approx(0.1, rel=0.06)  # the innovation
    assert errors[1] == pytest.approx(0.1 * np.sqrt(1 + 0.95**2 + 0.95**4), rel=0.08)
    found = model.validate(u, y)
    np.testing.assert_array_equal(model.predict(u, y, SAMPLES), found.output)
    assert np.isnan(predicted).sum() == 6  # they answer to inputs from before the record
    assert rp.fit_percent(y, predicted) == pytest.approx(found.one_step, abs=0.5)
    np.testing.assert_allclose(model.predict(u, y, 2, DT * np.arange(SAMPLES)), model.predict(u, y, 2), atol=1e-6)
    np.testing.assert_array_equal(replace(model, noise=None).predict(u, y), found.output)
    np.testing.assert_array_equal(model.simulate(u, y=y), found.output)


def test_a_missing_output_is_predicted_as_far_as_the_others_tell(model: rp.RowModel) -> None:
    u, y = record(8)
    model = replace(model, noise=rp.NoiseModel([1.0, -0.5], 0.03, 0.04, DT))
    lost = y.copy()
    lost[1000:1010] = np.nan
    output, predicted = model.validate(u, lost).output, model.predict(u, lost)
    assert predicted[1000] == pytest.approx(output[1000] + 0.5 * (y[999] - output[999]))
    np.testing.assert_array_equal(predicted[1001:1011], output[1001:1011])
    assert predicted[1011] == pytest.approx(output[1011] + 0.5 * (y[1010] - output[1010]))


def test_the_score_is_the_fit_of_a_validation(model: rp.RowModel) -> None:
    u, y = record(1)
    t = DT * np.arange(SAMPLES)
    assert model.score(u, y) == model.validate(u, y).fit
    assert model.score(u, y, t) == model.validate(u, y, t).fit == pytest.approx(model.score(u, y))
    log = rp.Log(u[:, 0], y, DT, others={"fan": u[:, 1]}, more_inputs=("fan",))
    assert model.score(log) == model.score(u, y)


def test_an_unstable_row_predicts_one_step_ahead_only() -> None:
    """The error of one whose unstable pole is reflected is the noise by e^(p dt): that of the best predictor."""
    unstable = rp.RowModel((rp.Structure(1), rp.Structure(1)), [-1.0, 1.0, 2.0, 2.0], dt=0.1, input_levels=[0.0, 3.0])
    rng = np.random.default_rng(9)
    r, v = rng.choice([-1.0, 1.0], (200, 2)).repeat(10, axis=0).T
    noise, grown, decayed = 0.1 * rng.standard_normal(r.size), np.exp(0.1), np.exp(-0.2)
    x, y, u = np.zeros(2), np.zeros(r.size), np.column_stack([r, v + 3.0])
    for k in range(r.size):
        y[k] = 7.0 + x.sum() + noise[k]
        u[k, 0] -= 4.0 * (y[k] - 7.0)
        x = np.array([grown * x[0] + (grown - 1.0) * u[k, 0], decayed * x[1] + (1.0 - decayed) * v[k]])
    assert np.std(y - unstable.predict(u, y)) == pytest.approx(0.1 * grown, rel=0.05)
    y[50], u[60, 1] = np.nan, np.nan
    assert np.flatnonzero(np.isnan(unstable.predict(u, y))).tolist() == [50, 60]
    with pytest.raises(rp.InvalidArgumentError, match="horizon must be 1 for an unstable model, got 2"):
        unstable.predict(u, y, 2)
    with pytest.raises(rp.InvalidArgumentError, match="an unstable model runs away"):
        unstable.score(u, y)


@every(
    "arguments, words",
    [
        ({"horizon": 0}, "horizon must be"),
        ({"u": np.zeros((20, 3))}, "u must have a column for each of 2 inputs"),
        ({"y": np.zeros(19)}, "u has 20 rows and y 19 samples"),
        ({"t": np.zeros(20)}, "t must be finite and strictly increasing"),
        ({"t": 0.5 * np.arange(20)}, r"samples 0\.05 s apart, t is usually 0\.5 s"),
    ],
)
def test_what_cannot_be_predicted_is_refused(model: rp.RowModel, arguments: dict[str, Any], words: str) -> None:
    given = {"u": np.arange(40.0).reshape(20, 2) % 7, "y": np.arange(20.0) % 3, **arguments}
    with pytest.raises(rp.InvalidArgumentError, match=words):
        model.predict(**given)


@pytest.mark.slow
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


@pytest.mark.slow
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


def test_the_row_has_what_its_parts_have(model: rp.RowModel) -> None:
    parts = [model.of_input(number) for number in range(2)]
    for name in ("step", "bode"):
        for ours, theirs in zip(getattr(model, name)(), (getattr(part, name)() for part in parts), strict=True):
            assert repr(ours) == repr(theirs)
    at_once = replace(model, structures=tuple(replace(each, delay=0.0) for each in model.structures))
    assert [[*each.den] for each in at_once.to_scipy()] == [[*g.den] for g in model.transfer_functions]
    assert model.to_sympy() == tuple(part.to_sympy() for part in parts)
    shown = model._repr_html_()
    assert shown.count("<table>") == 2
    assert shown.count(f"<b>{model.verdict.status}</b>") == 1
    assert all(part._repr_html_().count("<td") and f"{part.input_name} → {part.output_name}" in shown for part in parts)
    matrix = rp.MatrixModel((model, replace(model, output_name="y2")))
    assert matrix._repr_html_().count("<table>") == 4


@pytest.mark.parametrize("dt", [DT, 2.0 * DT])
def test_a_log_is_simulated_as_its_inputs_are(model: rp.RowModel, dt: float) -> None:
    u, y = record(4)
    t = dt * np.arange(len(u))
    log = rp.Log(u[:, 1], y, dt, input_name="u2", others={"u1": u[:, 0]}, more_inputs=("u1",))
    assert model.simulate(log) == pytest.approx(model.simulate(u, t), abs=1e-9)
    one = rp.Log(u[:, 0], y, dt)
    assert model.of_input(0).simulate(one) == pytest.approx(model.of_input(0).simulate(u[:, 0], t), abs=1e-9)
    for each, of in ((model, log), (model.of_input(0), one)):
        with pytest.raises(rp.InvalidArgumentError, match="a log has its own time"):
            each.simulate(of, t)
