"""The actuator experiment: every number of its table recomputed independently, and results on the full record."""

import itertools

import numpy as np
import pytest

import replant as rp
from replant.estimation.settings import Request
from replant.estimation.solver.least_squares import regressors
from replant.online.runs.run import run_online
from replant.paper.actuator import (
    DEFAULT,
    FILTERS,
    GAINS,
    NORMALISED,
    OFFLINE,
    OPTIMIZERS,
    SAMPLES,
    SCALING,
    Record,
    fit_normalised,
    fit_offline,
    identifier,
    measure_rig,
    run_default,
)
from replant.rigs import deap_rig, deap_voltage
from replant.verdict import simulate
from support.cases import every
from support.trace_by_hand import DT, TRUE, trace_by_hand


@pytest.mark.slow
@every(("method", "variant", "filters"), list(itertools.product(OPTIMIZERS, GAINS, FILTERS)))
def test_every_run_agrees_with_a_direct_one(actuator, method, variant, filters):
    record, row = actuator.record, actuator.row(method, variant, filters)
    ident, trace = trace_by_hand(record, method, variant, filters)
    true = np.array(list(TRUE.values()))
    before = np.vstack([np.zeros(5), trace.parameters[:-1, :5]])
    assert list(row.measures["J"].values()) == pytest.approx(((before - true) ** 2).sum(axis=0), rel=1e-6)
    assert list(row.errors.values()) == pytest.approx(100 * (ident.parameters[:5] / true - 1), rel=1e-6, abs=1e-6)
    model = rp.TransferFunction(ident.parameters[3:5], [1.0, *ident.parameters[:3]])
    expected = simulate(model, record.u**2 - 16.0, record.y, DT).fit
    assert row.free_run == pytest.approx(expected, rel=1e-6, abs=1e-6)
    tail = 100 * trace.parameters[-(len(trace) // 10) :, :5] / true
    t = np.arange(len(tail))
    for i, name in enumerate(TRUE):
        rough = (tail[:, i] - np.polyval(np.polyfit(t, tail[:, i], 1), t)).std()
        assert row.measures["roughness"][name] == pytest.approx(rough, rel=1e-5, abs=1e-9)
        outside = np.flatnonzero(abs(trace.parameters[:, i] / true[i] - 1) > 0.1)
        settled = None if outside[-1] == len(trace) - 1 else pytest.approx(DT * (outside[-1] + 2))
        assert row.measures["settled"][name] == settled


def test_least_squares_agrees_with_a_direct_fit(actuator):
    for filters in FILTERS:
        fitted = rp.fit(
            actuator.record.u,
            actuator.record.y,
            DT,
            rp.Structure(poles=3, zeros=1, bias=True),
            method="least_squares",
            filter=rp.StateVariableFilter(cutoff=50.0, method=filters),
            preprocess=actuator.record.rig.preprocess,
        )
        row = actuator.row(OFFLINE, filters=filters)
        expected = [100 * (value / true - 1) for value, true in zip(fitted.parameters, TRUE.values(), strict=False)]
        assert list(row.errors.values()) == pytest.approx(expected, rel=1e-9)
        assert row.free_run == pytest.approx(fitted.simulation.fit, rel=1e-9)
        assert list(row.measures) == ["error"]
        assert row.totals == {}


def test_normalised_least_squares_makes_the_mean_gradient_of_15_vanish(actuator):
    """The gradient (16), averaged over the record by the identifier's own error and regressor."""
    record = actuator.record
    for filters in FILTERS:
        goal = actuator.goals[filters]
        ident = identifier(record, "Gradient", "no buffer", filters)
        phi, target = regressors(ident.structure, DT, FILTERS[filters], record.rig.preprocess, record.u, record.y)
        scaled = phi / SCALING.regressor
        error = (target - phi @ goal) / (1 + (scaled**2).sum(axis=1))
        gradient = error @ scaled
        assert abs(gradient).max() < 1e-8 * (abs(error) @ abs(scaled)).max()
        expected = [100 * (value / true - 1) for value, true in zip(goal, TRUE.values(), strict=False)]
        assert list(actuator.row(OFFLINE, NORMALISED, filters).errors.values()) == pytest.approx(expected, rel=1e-9)


def test_the_buffered_runs_end_near_normalised_least_squares():
    """On the whole record, in the two coefficients that they have had time to learn."""
    record = measure_rig()
    goal = fit_normalised(record, "gbt")
    ident = identifier(record, "AMSGrad", "small gain", "gbt")
    ident.update_many(record.u, record.y)
    assert ident.parameters[[1, 3]] == pytest.approx(goal[[1, 3]], rel=0.005)


def test_the_default_is_replants_own(actuator):
    record, row = actuator.record, actuator.row(DEFAULT, "default", "own")
    structure = rp.Structure(poles=3, zeros=1, bias=True)
    result = run_online(Request(structure, DT, preprocess=record.rig.preprocess), record.u, record.y)
    expected = [100 * (value / true - 1) for value, true in zip(result.parameters, TRUE.values(), strict=False)]
    assert list(row.errors.values()) == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert row.free_run == pytest.approx(result.simulation.fit, rel=1e-6)
    history = result.history
    held = np.diff([0, *history.samples, record.u.size])
    rows = np.vstack([np.zeros(5), history.parameters[:, :5]])
    J = (held[:, None] * (rows - list(TRUE.values())) ** 2).sum(axis=0)
    assert list(row.measures["J"].values()) == pytest.approx(J, rel=1e-9)


@pytest.mark.slow
def test_the_default_ends_closer_than_the_best_of_the_articles_runs():
    """Ten times closer in a1 and b1, coefficient by coefficient against whichever of the twelve runs is best."""
    record, true = measure_rig(), np.array(list(TRUE.values()))
    errors = []
    for method, variant in itertools.product(OPTIMIZERS, GAINS):
        ident = identifier(record, method, variant, "gbt")
        ident.update_many(record.u, record.y)
        errors.append(abs(100 * (ident.parameters[:5] / true - 1)))
    best = dict(zip(TRUE, np.min(errors, axis=0), strict=True))
    own = {name: abs(error) for name, error in run_default(record).errors.items()}
    assert all(own[name] < best[name] for name in TRUE)
    assert all(10 * own[name] < best[name] for name in ("a1", "b1"))


@pytest.mark.slow
def test_the_default_runs_on_other_records_too(actuator):
    """Of the experiment's length, each with a voltage and a noise of its own."""
    assert len(actuator.elsewhere) == 5
    for seed, row in enumerate(actuator.elsewhere, start=1):
        rig = deap_rig(noise=1e-3, creep=5e-3)
        u = deap_voltage(actuator.record.u.size, seed=seed)
        request = Request(rp.Structure(poles=3, zeros=1, bias=True), DT, preprocess=rig.preprocess)
        parameters = run_online(request, u, rig.measure(u, seed=seed)).parameters
        expected = [100 * (value / true - 1) for value, true in zip(parameters, TRUE.values(), strict=False)]
        assert list(row.errors.values()) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.slow
def test_the_creep_is_what_weighs_on_the_default():
    """On the record where it is worst, the same voltage and noise without creep leave a hundredth of the error."""
    crept = measure_rig(seed=4)
    rig = deap_rig(noise=1e-3)
    still = Record(rig, crept.u, rig.measure(crept.u, seed=4))
    with_creep, without = (run_default(record).errors for record in (crept, still))
    assert abs(with_creep["a0"]) > 3.0
    assert all(abs(error) < 0.05 for error in without.values())


def test_every_configuration_is_there_once(actuator):
    keys = [(row.method, row.variant, row.filters) for row in actuator.rows]
    assert len(keys) == len(set(keys)) == 4 * 3 * 2 + 2 + 2 + 1
    assert len(actuator.online_rows()) == 12
    assert len({row.label for row in actuator.rows}) == len(keys)
    with pytest.raises(KeyError):
        actuator.row("Newton")


def test_gains_carry_the_sampling_time_where_the_article_says_so():
    """ "The difference of gains is equalized by the sampling time": a step of 5e-5 g_n for each."""
    for gain in GAINS.values():
        assert OPTIMIZERS["Gradient"](gain).settings(DT, np.ones(5))[0] == pytest.approx(5e-5 * gain)
        assert OPTIMIZERS["AMSGrad"](gain).step_size == OPTIMIZERS["Adam"](gain).step_size
        assert OPTIMIZERS["AMSGrad"](gain).step_size == pytest.approx(5e-5 * gain)
        integral = OPTIMIZERS["IntegralCost"](gain)
        assert DT * integral.gain == pytest.approx(5e-5 * gain)


def test_the_record_is_the_rigs_with_noise_and_creep():
    record = measure_rig(SAMPLES)
    assert record.u.size == record.y.size == 240_000
    assert record.true == TRUE
    np.testing.assert_array_equal(record.u, deap_voltage(SAMPLES))
    still = deap_rig(noise=0.0, creep=0.0).measure(record.u)
    crept = 5e-3 * np.log10(1 + DT * np.arange(SAMPLES))
    noise = record.y - still - crept
    assert noise.std() == pytest.approx(1e-3, rel=0.01)
    assert abs(noise.mean()) < 5 * 1e-3 / np.sqrt(SAMPLES)


def test_discretisation_decides_where_least_squares_ends():
    """Recovered on such a rig without noise: a1 6272 and b1 55.3 with the article's filters, true 5891 and 51.47."""
    fits = {
        name: dict(zip(TRUE, fitted.parameters, strict=False)) for name, fitted in fit_offline(measure_rig()).items()
    }
    assert fits["gbt"]["a1"] == pytest.approx(6272, rel=0.005)
    assert fits["gbt"]["b1"] == pytest.approx(55.3, rel=0.005)
    for name, true in TRUE.items():
        assert abs(fits["exact"][name] / true - 1) < 0.25 * abs(fits["gbt"][name] / true - 1)
    assert fits["exact"]["a1"] == pytest.approx(5891, rel=1e-3)
    assert fits["exact"]["b1"] == pytest.approx(51.47, rel=1e-3)
