"""The regressor follows scikit-learn's rules, and finds the same plant as replant."""

from __future__ import annotations

import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, TimeSeriesSplit
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MaxAbsScaler
from sklearn.utils.estimator_checks import parametrize_with_checks

import replant as rp
from replant.sklearn import TransferFunctionRegressor
from support.builders import binary, record
from support.cases import every

PLANT = rp.TransferFunction([2.0], [1.0, 0.5])
DT = 0.1

ORDER = "rows are samples in time: the output depends on those before, in their order"
#: Checks of scikit-learn that must fail, with reasons.  The checks pass several columns, so one is named as the input.
FAILING = {"check_methods_sample_order_invariance": ORDER, "check_methods_subset_invariance": ORDER}


@parametrize_with_checks([TransferFunctionRegressor(column=0)], expected_failed_checks=lambda estimator: FAILING)
def test_scikit_learns_own_checks(estimator: TransferFunctionRegressor, check: Any) -> None:
    check(estimator)


def about_a_working_point(seed: int = 0, samples: int = 3000, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    u, y = record(PLANT, seed, samples, DT, hold=20, noise=noise)
    return 3.0 + u[:, None], 7.0 + y


@pytest.mark.parametrize("method", ["auto", "srivc", "least_squares"])
def test_fit_equals_replant_fit(method: str) -> None:
    X, y = about_a_working_point()
    model = TransferFunctionRegressor(dt=DT, method=method).fit(X, y)
    found = rp.fit(
        X[:, 0], y, DT, rp.Structure(1), method=method, preprocess=rp.Preprocess("identity", "mean", "mean")
    )  # fmt: skip
    assert model.transfer_function_ == found.transfer_function
    np.testing.assert_array_equal(model.parameters_, found.parameters)
    assert np.isnan(model.std_).all() == (method == "least_squares")
    assert model.fit_percent(X, y) == pytest.approx(found.simulation.fit, abs=0.5)  # which estimates the initial state


def test_a_prediction_is_the_free_run_about_the_working_point() -> None:
    X, y = about_a_working_point(noise=0.0)
    model = TransferFunctionRegressor(dt=DT).fit(X, y)
    # at rest at u_0 = mean(u), the output is y_0 = 7 + G(0) (u_0 - 3)
    assert model.output_offset_ == pytest.approx(7.0 + 4.0 * (X.mean() - 3.0), abs=1e-6)
    np.testing.assert_allclose(model.predict(np.full((50, 1), X.mean())), model.output_offset_)
    np.testing.assert_allclose(model.predict(X)[200:], y[200:], atol=1e-4)  # exp(-0.5 * 20) of the start is left
    raised = model.predict(np.full((2000, 1), X.mean() + 1.0))
    assert raised[-1] == pytest.approx(model.output_offset_ + 4.0)


def test_the_model_has_the_dead_time() -> None:
    delayed = rp.TransferFunction([2.0], [1.0, 0.5], delay=0.34)
    u = binary(3, 2000, 20)
    model = TransferFunctionRegressor(dt=DT, delay=0.34).fit(u[:, None], delayed.simulate(u, DT))
    assert model.transfer_function_.delay == 0.34
    np.testing.assert_allclose(model.parameters_, [0.5, 2.0], rtol=1e-6)


def test_score_follows_from_fit_percent() -> None:
    X, y = about_a_working_point()
    model = TransferFunctionRegressor(dt=DT).fit(X, y)
    assert model.score(X, y) == pytest.approx(1.0 - (1.0 - model.fit_percent(X, y) / 100.0) ** 2)
    assert model.score(X, y) > 0.95


def test_partial_fit_equals_the_identifier_updated_in_chunks() -> None:
    X, y = about_a_working_point()
    model, ident = TransferFunctionRegressor(dt=DT), rp.Identifier(
        rp.Structure(1), DT, preprocess=rp.Preprocess("identity", "mean", "mean")
    )  # fmt: skip
    for part in np.array_split(np.arange(y.size), 7):
        model.partial_fit(X[part], y[part])
    ident.update_many(X[:, 0], y)
    np.testing.assert_array_equal(model.parameters_, ident.parameters)
    np.testing.assert_array_equal(model.std_, ident.uncertainty.std)
    assert (np.abs(model.parameters_ - [0.5, 2.0]) < 4.0 * model.std_).all()
    whole = clone(model).fit(X, y)
    assert model.score(X, y) == pytest.approx(whole.score(X, y), abs=1e-3)


def test_during_start_up_the_model_is_that_of_the_samples_so_far() -> None:
    X, y = about_a_working_point(noise=0.01)
    model = TransferFunctionRegressor(dt=DT).partial_fit(X[:300], y[:300])
    np.testing.assert_allclose(model.parameters_, [0.5, 2.0], rtol=0.05)
    early = model.parameters_.copy()
    model.partial_fit(X[300:], y[300:])
    assert np.abs(model.parameters_ - [0.5, 2.0]).max() < np.abs(early - [0.5, 2.0]).max()


def test_a_single_row_predicts_its_own_output() -> None:
    model = TransferFunctionRegressor(dt=DT).partial_fit([[1.0]], [5.0])
    np.testing.assert_array_equal(model.predict([[1.0], [2.0]]), [5.0, 5.0])


def test_fit_and_new_parameters_make_partial_fit_start_anew() -> None:
    X, y = about_a_working_point()
    once = TransferFunctionRegressor(dt=DT).partial_fit(X[:2000], y[:2000])
    after_fit = TransferFunctionRegressor(dt=DT).fit(X, -y).partial_fit(X[:2000], y[:2000])
    np.testing.assert_array_equal(after_fit.parameters_, once.parameters_)
    other = TransferFunctionRegressor(dt=DT, poles=2).partial_fit(X, y).set_params(poles=1)
    np.testing.assert_array_equal(other.partial_fit(X[:2000], y[:2000]).parameters_, once.parameters_)


def test_a_partly_fitted_regressor_can_be_pickled() -> None:
    X, y = about_a_working_point(samples=1500)
    model = TransferFunctionRegressor(dt=DT).partial_fit(X[:1000], y[:1000])
    copy = pickle.loads(pickle.dumps(model))
    for each in (model, copy):
        each.partial_fit(X[1000:], y[1000:])
    np.testing.assert_array_equal(copy.parameters_, model.parameters_)


def test_memory_does_not_grow() -> None:
    X, y = about_a_working_point(samples=12_000)
    model = TransferFunctionRegressor(dt=DT)
    for part in np.array_split(np.arange(y.size), 4):
        model.partial_fit(X[part], y[part])
    assert len(model._recent) == 10_000


def test_one_column_of_several_is_the_input() -> None:
    X, y = about_a_working_point()
    wide = np.column_stack([np.cos(np.arange(y.size)), X[:, 0]])
    model = TransferFunctionRegressor(dt=DT, column=1).fit(wide, y)
    np.testing.assert_array_equal(model.parameters_, TransferFunctionRegressor(dt=DT).fit(X, y).parameters_)
    with pytest.raises(rp.InvalidArgumentError, match=r"one column, the input, got 2: .*column="):
        TransferFunctionRegressor(dt=DT).fit(wide, y)
    with pytest.raises(rp.InvalidArgumentError, match="2 columns, numbered from 0, and no column 2"):
        TransferFunctionRegressor(dt=DT, column=2).fit(wide, y)


def two_inputs(samples: int = 2000) -> tuple[np.ndarray, np.ndarray]:
    u = np.column_stack([binary(5, samples, 20), 3.0 + binary(6, samples, 20)])
    second = rp.TransferFunction([1.0], [1.0, 3.0], delay=0.3)
    y = 7.0 + PLANT.simulate(u[:, 0].copy(), DT) + second.simulate(u[:, 1] - 3.0, DT)
    return u, y + 0.05 * np.random.default_rng(7).standard_normal(samples)


TWO: dict[str, Any] = {"poles": (1, 1), "delay": (0.0, 0.3), "dt": DT}


def test_several_columns_are_several_inputs() -> None:
    u, y = two_inputs()
    model = TransferFunctionRegressor(**TWO).fit(u, y)
    direct = rp.fit(u, y, DT, poles=(1, 1), delay=(0.0, 0.3))
    assert (model.parameters_ == direct.parameters).all()
    assert (model.std_ == np.sqrt(np.diag(direct.covariance))).all()
    assert len(model.transfer_functions_) == 2
    assert model.score(u, y) > 0.99
    first, second = model.input_offset_
    assert model.output_offset_ == pytest.approx(7.0 + 4.0 * first + (second - 3.0) / 3.0, abs=0.1)
    assert clone(model).get_params() == model.get_params()


@pytest.mark.slow
def test_several_columns_are_learned_chunk_by_chunk() -> None:
    u, y = two_inputs()
    model, ident = TransferFunctionRegressor(**TWO), rp.Identifier(**TWO)
    for rows in (slice(0, 3), slice(3, 300), slice(300, 2000)):
        model.partial_fit(u[rows], y[rows])
        ident.update_many(u[rows], y[rows])
        assert np.isfinite(model.predict(u[rows])).all()
    assert (model.parameters_ == ident.parameters).all()
    assert model.score(u, y) > 0.99
    assert (
        pickle.loads(pickle.dumps(model)).partial_fit(u, y).parameters_ == model.partial_fit(u, y).parameters_
    ).all()


@every(
    "asked, columns, words",
    [
        ({}, 3, "X must have a column for each of 2 inputs, got 3"),
        ({"column": 0}, 2, "several inputs take no column"),
        ({"method": "srivc"}, 2, "several inputs take no method"),
        ({"zeros": (0,)}, 2, "zeros has 1 entry"),
    ],
)
def test_what_does_not_match_several_inputs_is_named(asked: dict[str, Any], columns: int, words: str) -> None:
    u, y = two_inputs(300)
    with pytest.raises(rp.ReplantError, match=words):
        TransferFunctionRegressor(**(TWO | asked)).fit(np.column_stack([u, y])[:, :columns], y)


@every(
    ("wrong", "name"),
    [({"poles": 0}, "poles"), ({"zeros": 3}, "zeros"), ({"dt": 0.0}, "dt"), ({"delay": -1.0}, "delay"),
     ({"method": "magic"}, "method"), ({"column": -1}, "column")],
)  # fmt: skip
def test_a_wrong_parameter_is_named_by_fit_not_by_the_constructor(wrong: dict[str, Any], name: str) -> None:
    X, y = about_a_working_point(samples=100)
    model = TransferFunctionRegressor(**{"dt": DT, **wrong})
    for learn in (model.fit, model.partial_fit):
        with pytest.raises(rp.InvalidArgumentError, match=name):
            learn(X, y)


def test_a_search_finds_the_structure_in_a_pipeline() -> None:
    """The gain compensates the scaling of the input: a linear pipeline in front changes nothing else."""
    X, y = record(rp.TransferFunction([3.0], [1.0, 0.8, 4.0]), 5, 2500, DT, hold=15, noise=0.02)
    pipeline = make_pipeline(MaxAbsScaler(), TransferFunctionRegressor(dt=DT))
    search = GridSearchCV(pipeline, {"transferfunctionregressor__poles": [1, 2]}, cv=TimeSeriesSplit(3))
    search.fit(4.0 * X[:, None], y)
    assert search.best_params_ == {"transferfunctionregressor__poles": 2}
    model = search.best_estimator_[-1].transfer_function_
    assert model.dc_gain == pytest.approx(0.75, rel=0.02)


def test_without_scikit_learn_the_message_says_what_to_install() -> None:
    script = (
        "import sys\nsys.modules['sklearn'] = None\nimport replant as rp\n"
        "try:\n    import replant.sklearn\n"
        "except rp.MissingDependencyError as error:\n    assert \"pip install 'replant[sklearn]'\" in str(error)\n"
        "else:\n    raise SystemExit('no error')"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_two_columns_are_two_inputs_with_poles_of_each() -> None:
    u = np.column_stack([binary(1, 400, 8), binary(2, 400, 13)])
    with pytest.raises(
        ValueError, match=r"choose one with column=, or give the number of poles of each, poles=\(1, 1\)"
    ):
        TransferFunctionRegressor(poles=1, dt=0.05).fit(u, u[:, 0])
    assert len(TransferFunctionRegressor(poles=(1, 1), dt=0.05).fit(u, u @ [1.0, 2.0]).transfer_functions_) == 2
