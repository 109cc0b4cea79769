"""A model in absolute units: simulation, prediction, responses with their bands, conversions."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant import rigs
from replant.fitting.responses import StepResponse, time_of
from support.cases import every

TRUE = rp.TransferFunction([2.0, 3.0], [1.0, 1.2, 4.0], delay=0.1)
DT = 0.05
REST = (1.5, 7.0)


def record(seed: int = 0, samples: int = 2000, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.choice([1.0, 3.0], samples // 25), 25)
    return u, REST[1] + TRUE.simulate(u - REST[0], DT) + noise * generator.standard_normal(u.size)


@pytest.fixture(scope="module")
def fitted() -> rp.FitResult:
    return rp.fit(*record(), DT, poles=2, zeros=1, delay=0.1)


@pytest.fixture(scope="module")
def model(fitted: rp.FitResult) -> rp.Model:
    return fitted.model


def test_it_simulates_another_record_in_absolute_units(model: rp.Model) -> None:
    u, y = record(seed=1, noise=0.0)
    rest = np.full(400, REST[0])
    simulated = model.simulate(np.concatenate([rest, u]))[rest.size :]
    assert rp.fit_percent(y, simulated) > 98.0
    assert simulated[0] == pytest.approx(REST[1], abs=0.05)


def test_what_a_simulation_begins_at_depends_on_no_working_point(fitted: rp.FitResult) -> None:
    u, y = record()
    other = rp.fit(u, y, DT, poles=2, zeros=1, delay=0.1, preprocess=rp.Preprocess("identity", "mean", "mean")).model
    np.testing.assert_allclose(other.simulate(u), fitted.model.simulate(u), rtol=1e-4)
    assert other.input_level != fitted.model.input_level


def test_stamps_of_a_regular_clock_change_nothing(model: rp.Model) -> None:
    u, y = record()
    t = DT * np.arange(u.size)
    np.testing.assert_allclose(model.simulate(u, t), model.simulate(u), rtol=1e-9)
    answering = slice(3, None)  # to inputs of the record
    np.testing.assert_allclose(model.simulate(u, t, y=y)[answering], model.simulate(u, y=y)[answering], rtol=1e-6)


def test_a_plant_that_integrates_begins_at_its_working_point() -> None:
    model = rp.Model(rp.Structure(1), [0.0, 2.0], dt=0.5, input_level=1.0, output_level=5.0)
    np.testing.assert_allclose(model.simulate([1.0, 2.0, 2.0]), [5.0, 5.0, 6.0])


@pytest.mark.parametrize("poles", [[0.0, -0.5], [-1e-4, -0.5]], ids=["integrator", "slower than the record"])
def test_a_plant_without_a_known_rest_begins_at_the_means_of_its_record(poles: list[float]) -> None:
    """Extrapolated to rest through a gain that nobody knows, the level was off by millions."""
    plant = rp.TransferFunction([2.0], np.poly(poles))
    u = np.tile(np.repeat([1.0, -1.0], 50), 20) + 2.0
    generator = np.random.default_rng(0)
    y = 50.0 + plant.simulate(u - 2.0, DT) + 0.02 * generator.standard_normal(u.size)
    ident = rp.Identifier(poles=2, dt=DT)
    ident.update_many(u, y)
    for model in (rp.fit(u, y, DT, poles=2).model, ident.model):
        assert model.output_level == pytest.approx(y.mean(), abs=1.0)
        assert model.input_level == pytest.approx(u.mean(), abs=0.1)
        assert abs(model.simulate(u)[0] - 50.0) < 6.0


def test_an_unstable_model_has_the_means_of_its_record_as_levels() -> None:
    plant = rp.TransferFunction([1.0], [1.0, -1.0])
    generator = np.random.default_rng(0)
    reference = np.repeat(generator.choice([-1.0, 1.0], 40), 50)
    u, y, x = np.zeros(2000), np.zeros(2000), 0.0
    for k in range(2000):
        y[k] = x + 0.01 * generator.standard_normal()
        u[k] = -3.0 * y[k] + reference[k]
        x = np.exp(DT) * x + (np.exp(DT) - 1.0) * u[k]
    model = rp.fit(u + 5.0, y + 30.0, DT, poles=1, reference=reference).model
    assert not plant.is_stable
    assert (model.input_level, model.output_level) == pytest.approx((5.0, 30.0), abs=0.3)
    other = model.validate(u + 5.0, y + 30.0, reference=reference)
    assert other.verdict.status == "trusted"
    assert model.validate(u + 5.0, y + 30.0).verdict.status == "inconsistent"  # without it nobody can tell


def test_the_input_is_held_between_stamps_however_far_they_are_apart() -> None:
    model = rp.Model(rp.Structure(1), [1.0, 1.0], dt=0.1)
    t, u = np.array([0.0, 1.0, 1.1, 5.0]), np.array([0.0, 1.0, 1.0, 1.0])
    np.testing.assert_allclose(model.simulate(u, t), [0.0, 0.0, 1 - np.exp(-0.1), 1 - np.exp(-4.0)], atol=1e-12)


def test_prediction_uses_the_colour_of_the_residual() -> None:
    u, y = record(noise=0.0)
    generator = np.random.default_rng(5)
    white = 0.1 * generator.standard_normal(u.size)
    noise = np.zeros(u.size)
    for k in range(1, u.size):
        noise[k] = 0.95 * noise[k - 1] + white[k]
    model = rp.fit(u, y + noise, DT, poles=2, zeros=1, delay=0.1).model
    errors = [np.std((y + noise - model.predict(u, y + noise, horizon))[100:]) for horizon in (1, 3, 1000)]
    assert errors[0] == pytest.approx(0.1, rel=0.06)  # the innovation
    assert errors[1] == pytest.approx(0.1 * np.sqrt(1 + 0.95**2 + 0.95**4), rel=0.08)
    assert errors[2] == pytest.approx(np.std(noise), rel=0.1)


def test_an_unstable_model_predicts_one_step_ahead_only() -> None:
    unstable = rp.Model(rp.Structure(1), [-1.0, 1.0], dt=0.1)
    u = np.sin(np.arange(60.0))
    y = unstable.transfer_function.simulate(u, 0.1)
    assert rp.fit_percent(y, unstable.predict(u, y)) > 99.0
    with pytest.raises(rp.InvalidArgumentError, match="horizon must be 1"):
        unstable.predict(u, y, 2)
    slow = rp.Model(rp.Structure(1), [1.0, 1.0], dt=0.1, noise=rp.NoiseModel([1.0, -0.5], 1.0, 2.0, 0.1))
    with pytest.raises(rp.InvalidArgumentError, match=r"samples 0\.1 s apart, t is usually 0\.5 s"):
        slow.predict(u, y, 2, 0.5 * np.arange(60))


@pytest.mark.parametrize("kind", ["step", "impulse"])
def test_bands_of_a_response_are_those_of_models_drawn_from_the_covariance(model: rp.Model, kind: str) -> None:
    response = getattr(model, kind)(6.0)
    drawn = np.random.default_rng(0).multivariate_normal(model.parameters, model.covariance, 400)
    outputs = [getattr(dataclasses.replace(model, parameters=each), kind)(6.0).output for each in drawn]
    spread = np.std(outputs, axis=0)
    shown = response.std > 0.1 * response.std.max()
    # a standard deviation from 400 draws has one of 3.5 %
    np.testing.assert_allclose(spread[shown], response.std[shown], rtol=0.16)


def test_the_step_response_ends_at_the_gain_and_the_impulse_response_is_its_slope(model: rp.Model) -> None:
    step, impulse = model.step(60.0), model.impulse(3.0)
    assert step.output[-1] == pytest.approx(model.transfer_function.dc_gain, rel=1e-6)
    slope = np.gradient(model.step(3.0).output, impulse.time)
    late = (impulse.time > 0.3) & (impulse.time < 2.9)  # at the ends the slope is one-sided
    np.testing.assert_allclose(impulse.output[late], slope[late], atol=2e-3)


def test_a_plant_without_lag_has_no_impulse_response() -> None:
    model = rp.Model(rp.Structure(1, 1, feedthrough=True), [1.0, 2.0, 3.0], dt=0.1)
    with pytest.raises(rp.InvalidArgumentError, match="use step"):
        model.impulse()


def test_frequency_responses_are_those_of_g(model: rp.Model) -> None:
    omega = [0.5, 2.0, 10.0]
    bode, nyquist = model.bode(omega), model.nyquist(omega)
    expected = model.transfer_function.response(omega)
    np.testing.assert_allclose(bode.magnitude * np.exp(1j * bode.phase), expected)
    np.testing.assert_allclose(nyquist.response, expected)
    assert model.uncertainty is not None
    np.testing.assert_array_equal(bode.relative_std, model.uncertainty.response(omega)[0])


@pytest.mark.parametrize("known", [True, False])
def test_everything_can_be_drawn_with_and_without_uncertainty(model: rp.Model, known: bool) -> None:
    drawn = model if known else dataclasses.replace(model, covariance=None)
    for each in (drawn.step(), drawn.impulse(), drawn.nyquist(), drawn.poles()):
        axis = each.plot()
        each.plot(axis)
        labels = {text.get_text() for text in axis.get_legend().get_texts()}
        assert known == any(label in labels for label in ("± 2σ", "2σ", "95 % region"))
    assert len(drawn.bode().plot()) == 2
    assert len(drawn.plot()) == 4
    assert len(drawn.validate(*record(seed=2)).plot()) == 4


def test_converted_with_its_dead_time(model: rp.Model) -> None:
    with pytest.raises(rp.InvalidArgumentError, match="pade"):
        model.to_control()
    system = model.to_control(pade=3)
    omega = np.array([0.1, 1.0, 10.0])
    np.testing.assert_allclose(system(1j * omega), model.transfer_function.response(omega), rtol=1e-4)
    at_one = complex(model.to_sympy().subs("s", 1j))
    assert at_one == pytest.approx(complex(model.transfer_function.response([1.0])[0]))


def test_equal_hashed_and_pickled(model: rp.Model) -> None:
    again = pickle.loads(pickle.dumps(model))
    assert again == model
    assert hash(again) == hash(model)
    later = dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, date="2000-01-01"))
    assert later == model
    for changes in ({"dt": 0.06}, {"covariance": None}, {"input_name": "v"}, {"noise": None}, {"output_level": 0.0}):
        assert dataclasses.replace(model, **changes) != model
    assert model != "model"


def test_read_by_people(model: rp.Model) -> None:
    assert repr(model).startswith("<Model (")
    assert model._repr_latex_().startswith(r"$\displaystyle G(s) = \frac{")
    assert "<table>" in model._repr_html_()
    hostile = dataclasses.replace(model, input_name="<script>")
    assert "<script>" not in hostile._repr_html_()


def test_an_identifier_gives_one_at_any_time() -> None:
    u, y = record()
    ident = rp.Identifier(poles=2, zeros=1, delay=0.1, dt=DT)
    with pytest.raises(rp.InvalidArgumentError, match="no model yet: 0 samples"):
        ident.model  # noqa: B018
    ident.update_many(u[:300], y[:300])
    assert ident.model.structure == ident.structure  # a provisional one
    ident.update_many(u[300:], y[300:])
    model = ident.model
    assert model.verdict.status == ident.assess().status == "trusted"
    assert rp.fit_percent(y, model.simulate(u, y=y)) == pytest.approx(model.simulated_fit, abs=0.1)
    assert rp.fit_percent(y, model.simulate(np.concatenate([np.full(400, u[0]), u]))[400:]) > 90.0


@every(
    ("arguments", "words"),
    [
        ({}, "poles=2"),
        ({"poles": 2, "structure": rp.Structure(2)}, "either a structure"),
        ({"y": None, "poles": 1}, "give a Log"),
        ({"dt": None, "poles": 1}, "give a Log"),
    ],
)
def test_what_is_missing_is_named(arguments: dict[str, Any], words: str) -> None:
    u, y = record(samples=100)
    with pytest.raises((rp.ArgumentTypeError, rp.InvalidArgumentError), match=words):
        rp.fit(u, **{"y": y, "dt": DT, **arguments})


def test_a_log_is_fitted_and_its_names_are_kept() -> None:
    from pathlib import Path

    u, y = record()
    log = rp.Log(u, y, DT, None, "voltage [V]", "speed [rpm]", Path("motor.csv"))
    model = rp.fit(log, poles=2, zeros=1, delay=0.1).model
    assert (model.input_name, model.output_name, model.provenance.source) == ("voltage [V]", "speed [rpm]", "motor.csv")
    assert model.score(log) == pytest.approx(model.simulated_fit)
    with pytest.raises(rp.InvalidArgumentError, match="leave out y, dt, t, reference"):
        rp.fit(log, y, poles=1)
    with pytest.raises(rp.InvalidArgumentError, match="leave out y, t and reference"):
        model.validate(log, y)
    with pytest.raises(rp.InvalidArgumentError, match=r"model.validate\(u, y\)"):
        model.validate(u)


@every(
    "changes",
    [{"dt": 0.0}, {"parameters": [1.0]}, {"parameters": [np.nan, 1.0]}, {"input_level": np.inf}, {"input_name": 3},
     {"covariance": [[1.0]]}, {"input_hold": "soh"}, {"rejected": (("outlier", -1),)}, {"input_map": "cube"}],
)  # fmt: skip
def test_a_model_that_cannot_be_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises((rp.InvalidArgumentError, rp.ArgumentTypeError), match=next(iter(changes))):
        rp.Model(**{"structure": rp.Structure(1), "parameters": [1.0, 2.0], "dt": 0.1, **changes})


def test_a_step_response_shows_a_fast_oscillation_beside_a_slow_mode() -> None:
    step = StepResponse.of(rigs.DEAP, None, time_of(rigs.DEAP))
    period = 1.0 / 12.2
    assert step.time[-1] > 50.0
    assert np.diff(step.time).max() < period / 7.0
    first = step.output[step.time < period]
    assert first.max() == pytest.approx(2.0 * 51.47 / 5891.0, rel=0.06)  # it overshoots as a lightly damped mode does
