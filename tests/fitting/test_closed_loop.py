"""Fits of records taken under a controller: with a reference, with a noise model, of plants that are not stable."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
import sys
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.signal import lfilter

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.solve import Solution, solve
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem
from replant.fitting.structure_search import search
from replant.online.runs.result import result_of_fit
from replant.report.results_as_text import as_json
from replant.signals import prbs, white_noise
from support.builders import irregular_record
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from accuracy.controlled import hard_loops, simple_loops

fit_module = importlib.import_module("replant.fitting.fit")

DT = 0.05
UNSTABLE = rp.TransferFunction([1.0], [1.0, -1.0])
TRUE_OVEN = np.array([1.0, 0.8]) / 300.0
INTEGRATOR = rp.TransferFunction([1.0], [1.0, 1.0, 0.0])


@dataclass(frozen=True)
class Loop:
    """A record of K samples: input, output, reference."""

    u: np.ndarray
    y: np.ndarray
    r: np.ndarray


def loop(
    plant: rp.TransferFunction, gain: float, samples: int, *, noise: float = 0.0, load: float = 0.0, seed: int = 0,
    pole: float = 0.0, dt: float = DT, steps: tuple[int, ...] = (),
) -> Loop:  # fmt: skip
    """u = gain (r - y) drives the plant, held; noise / (1 - pole/z) on the output, load / (1 - .95/z) on the input.

    The set-point is drawn anew every 20 samples, or rises by 1 at ``steps``.
    """
    a, n = plant.den[1:], plant.den.size - 1
    system = np.zeros((n + 1, n + 1))
    system[0, :n], system[1:n, : n - 1], system[0, n] = -a, np.eye(n - 1), 1.0
    step = expm(system * dt)
    row = np.zeros(n)
    row[n - plant.num.size :] = plant.num
    rng = np.random.default_rng([seed, 11])
    r = np.repeat(rng.uniform(-1.0, 1.0, samples // 20 + 1), 20)[:samples]
    if steps:
        r = np.searchsorted(steps, np.arange(samples), side="right").astype(float)
    v = noise * lfilter([math.sqrt(1 - pole**2)], [1.0, -pole], rng.standard_normal(samples))
    d = load * lfilter([0.3], [1.0, -0.95], rng.standard_normal(samples))
    x, u, y = np.zeros(n), np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        y[k] = row @ x + v[k]
        u[k] = gain * (r[k] - y[k])
        x = step[:n, :n] @ x + step[:n, n] * (u[k] + d[k])
    return Loop(u, y, r)


# --- plants that are not stable


@pytest.mark.parametrize("referenced", [False, True])
@pytest.mark.parametrize(
    ("plant", "gain", "parameters", "tolerance", "fit"),
    [
        # straight lines through its output cost (p dt)^2/6 of a pole p, and rounding is all that is left of the rest
        pytest.param(UNSTABLE, 3.0, [-1.0, 1.0], 2.0 * DT**2 / 6, 99.99, id="unstable"),
        pytest.param(INTEGRATOR, 1.0, [1.0, 0.0, 1.0], 1e-4, 99.9, id="integrator"),
    ],
)
def test_without_noise_a_plant_that_is_not_stable_is_found(
    plant: rp.TransferFunction, gain: float, parameters: list[float], tolerance: float, fit: float, referenced: bool
) -> None:
    done = loop(plant, gain, 2000)
    found = rp.fit(done.u, done.y, DT, rp.Structure(plant.den.size - 1), reference=done.r if referenced else None)
    np.testing.assert_allclose(found.parameters, parameters, atol=tolerance)
    assert found.simulation.fit > fit


def test_the_sign_of_a_pole_is_a_result_with_an_uncertainty() -> None:
    """Unstable under noise: told from a stable plant by many standard deviations, and within four of the truth."""
    for seed in range(5):
        done = loop(UNSTABLE, 3.0, 2000, noise=0.05, pole=0.9, seed=seed)
        found = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=done.r)
        std = found.uncertainty.std
        assert (np.abs(found.parameters - [-1.0, 1.0]) < 4.0 * std).all()
        assert found.parameters[0] + 4.0 * std[0] < 0.0
        assert not found.transfer_function.is_stable


def test_a_spurious_fast_unstable_pole_does_not_pay() -> None:
    """Of white noise the discretised all-pass (s - p)/(s + p) with p = 1.6/dt leaves two thirds of the power.

    Compared by the residual, too large a structure took one; compared by the error of the predicted output it does not.
    """
    u = prbs(1400, hold=8)
    plant = rp.TransferFunction([2.0], [1.0, 1.0], 0.4)
    y = plant.simulate(u, DT)
    y += white_noise(u.size, 0.1 * float(y.std()), seed=3)
    found = refine(rp.Structure(3, 2, delay=0.4), Record(u, y, np.array([DT])))
    poles = np.roots([1.0, *found.theta[:3]])
    assert poles.real.max() < 0.1
    problem = Problem(rp.Structure(1), Record(u, u * 0.0 + white_noise(u.size, 1.0), np.array([DT])))
    done = problem.run(np.array([-1.6 / DT, 0.0, 0.0, 0.0]))
    assert np.mean(done.error**2) < 0.75
    assert done.cost > 1.0


def test_the_search_keeps_unstable_models() -> None:
    done = loop(UNSTABLE, 3.0, 2000, noise=0.02)
    found = search(done.u, done.y, DT, poles=(1, 2), reference=done.r)
    assert found.best.structure.poles == 1
    np.testing.assert_allclose(found.best.parameters, [-1.0, 1.0], rtol=0.05)
    assert all(math.isfinite(candidate.fit) for candidate in found.candidates)
    # what is left of the output is the noise
    assert found.candidates[0].fit == pytest.approx(100 * (1 - 0.02 / done.y.std()), abs=2.0)


def test_the_report_and_json_of_an_unstable_model() -> None:
    done = loop(UNSTABLE, 3.0, 2000, noise=0.02)
    fitted = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=done.r)
    result = result_of_fit(fitted, done.u, done.y, 0.0)
    answer = json.loads(json.dumps(as_json(result), allow_nan=False))
    assert answer["poles"][0]["real"] == pytest.approx(1.0, abs=0.05)
    assert result.simulation.how == "predicted from input and past output"
    assert answer["poles"][0]["time_constant"] == pytest.approx(-1.0, abs=0.05)
    assert answer["fit"]["simulated"] > 90.0
    assert answer["fit"]["one_step"] == pytest.approx(answer["fit"]["simulated"], abs=1.0)


# --- reference and noise model


@pytest.mark.parametrize(
    "plant",
    [pytest.param(UNSTABLE, id="unstable"), pytest.param(INTEGRATOR, id="integrator", marks=pytest.mark.slow)],
)
def test_under_a_load_a_reference_takes_the_bias_away(plant: rp.TransferFunction) -> None:
    """The mean of 12 records within four of its standard deviations, and J as chi-square has it.

    The mean of 12 values with 12 less P degrees each: a standard deviation of sqrt(2 (12 - P) / 12); four of it.
    """
    gain, structure = (3.0, rp.Structure(1)) if plant is UNSTABLE else (1.0, rp.Structure(2))
    truth, errors, misfits = np.append(plant.den[1:], plant.num), [], []
    for seed in range(12):
        done = loop(plant, gain, 2000, load=0.3, seed=seed)
        found = rp.fit(done.u, done.y, DT, structure, reference=done.r)
        assert found.reference.used
        assert found.reference.finding == ""
        assert 0.0 < found.reference.explained <= 1.0
        assert found.noise.order > 0
        errors.append((found.parameters - truth) / found.uncertainty.std)
        misfits.append(found.reference.misfit)
    degrees = 12 - structure.coefficients
    assert found.reference.degrees == degrees
    assert (np.abs(np.mean(errors, axis=0)) < 4.0 / math.sqrt(12)).all()
    assert np.mean(misfits) == pytest.approx(degrees, abs=4.0 * math.sqrt(2.0 * degrees / 12))
    assert found.reference.misfit_limit > degrees


@pytest.mark.slow
@every("run", range(3))
def test_a_strong_load_leads_no_search_astray(run: int) -> None:
    """The reference explains no more of what is left than at the root that the steps reach from the truth.

    An oven whose door opens once an hour: a model that says nothing leaves the whole output to the noise model.
    """
    loop = next(each for each in hard_loops() if each.key == "K oven load")
    measured = dataclasses.replace(loop.record, samples=2880)(run)
    record = Record(measured.u, measured.y, np.array([loop.dt]), r=measured.r)
    found = refine(loop.structure, record)
    ideal = Problem(loop.structure, record).descend(np.append(TRUE_OVEN, [0.0, 0.0]), 60, (0, 2, 4, 7, 10))
    assert found.misfit <= 1.02 * ideal.relative_misfit


@pytest.mark.slow
@every("run", [4, 13, 24], quick=1)
def test_where_no_step_lowers_the_cost_at_the_axis_the_filtered_estimate_is_taken(run: int) -> None:
    """The cost has a bend where a pole crosses the axis; the least output error of these loops is 50 to 67 % off."""
    experiment = next(each for each in simple_loops() if each.key == "K integrator load-10")
    record = experiment.record(run)
    fitted = rp.fit(record.u, record.y, experiment.dt, experiment.structure)
    assert fitted.filtered
    assert fitted.parameters[:3] == pytest.approx([1.0, 0.0, 1.0], abs=0.1)


def test_the_noise_model_is_that_of_the_noise() -> None:
    """AR(0.9) on the output: its coefficient within five of its standard deviations, sqrt(1 - 0.81) / sqrt(K)."""
    done = loop(rp.TransferFunction([1.0], [1.0, 1.0]), 5.0, 4000, noise=0.1, pole=0.9)
    noise = rp.fit(done.u, done.y, DT, rp.Structure(1)).noise
    assert noise.order == 1
    assert noise.coefficients[1] == pytest.approx(-0.9, abs=5.0 * math.sqrt((1 - 0.81) / 4000))
    assert noise.variance == pytest.approx(0.01 * (1 - 0.81), rel=5.0 * math.sqrt(2.0 / 4000))
    assert noise.residual_variance == pytest.approx(0.01, rel=5.0 * math.sqrt(2.0 * 19 / 4000))  # (1+.81)/(1-.81) less


def test_white_noise_in_open_loop_has_order_zero() -> None:
    u = prbs(2000, hold=8)
    y = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]).simulate(u, DT) + white_noise(u.size, 0.05)
    noise = rp.fit(u, y, DT, rp.Structure(2)).noise
    assert noise.is_white
    assert noise.variance == noise.residual_variance == pytest.approx(0.0025, rel=0.2)


POOR = {
    "stands still": (lambda done: np.full(done.r.size, 3.0), "stands still"),
    "copy": (lambda done: 2.0 * done.u - 1.0, "copy of the input"),
    "nothing": (lambda done: np.random.default_rng(5).standard_normal(done.r.size), "explains nothing"),
}


@pytest.mark.parametrize("name", POOR)
def test_a_poor_reference_is_said_and_not_used(name: str) -> None:
    make, words = POOR[name]
    done = loop(rp.TransferFunction([1.0], [1.0, 1.0]), 5.0, 2000, noise=0.05)
    found = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=make(done))
    assert words in found.reference.finding
    assert "\n" not in found.reference.finding
    assert not found.reference.used
    assert math.isnan(found.reference.misfit)
    without = rp.fit(done.u, done.y, DT, rp.Structure(1))
    np.testing.assert_array_equal(found.parameters, without.parameters)
    reasons = result_of_fit(found, done.u, done.y, 0.0).verdict.reasons
    assert sum(found.reference.finding.partition(":")[0] in reason for reason in reasons) == 1


def test_one_step_of_the_set_point_is_a_reference() -> None:
    """Its transient excites a dozen Laguerre functions."""
    done = loop(UNSTABLE, 3.0, 1500, noise=0.02, steps=(500,))
    found = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=done.r)
    assert found.reference.used
    assert (np.abs(found.parameters - [-1.0, 1.0]) < 4.0 * found.uncertainty.std).all()
    assert found.uncertainty.std.max() < 0.02


def test_where_no_model_is_found_with_the_reference_the_fit_does_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def only_without(structure: rp.Structure, ready: Record, **how: bool) -> Solution | None:
        return solve(structure, ready, **how) if ready.r is None else None

    monkeypatch.setattr(fit_module, "solve", only_without)
    done = loop(rp.TransferFunction([1.0], [1.0, 1.0]), 5.0, 1000, noise=0.05)
    found = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=done.r)
    assert (found.method, found.reference.used) == ("srivc", False)
    assert "no model was found with the reference" in found.reference.finding


def test_the_unit_of_the_reference_does_not_matter() -> None:
    done = loop(UNSTABLE, 3.0, 2000, noise=0.05)
    one = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=done.r)
    other = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=1e6 * done.r - 300.0)
    np.testing.assert_allclose(other.parameters, one.parameters, rtol=1e-6)


def test_samples_without_a_reference_are_left_out() -> None:
    done = loop(UNSTABLE, 3.0, 2000, noise=0.02)
    r = done.r.copy()
    r[[0, 500, 501, 1999]] = np.nan
    found = rp.fit(done.u, done.y, DT, rp.Structure(1), reference=r)
    assert (found.samples, found.rejected["not finite"]) == (1996, 4)
    np.testing.assert_allclose(found.parameters, [-1.0, 1.0], rtol=0.05)


def test_least_squares_and_a_reference_of_another_length_are_refused() -> None:
    done = loop(UNSTABLE, 3.0, 200)
    with pytest.raises(rp.InvalidArgumentError, match="no use of a reference"):
        rp.fit(done.u, done.y, DT, rp.Structure(1), reference=done.r, method="least_squares")
    with pytest.raises(rp.InvalidArgumentError, match="one value for each of 200 samples, got 199"):
        rp.fit(done.u, done.y, DT, rp.Structure(1), reference=done.r[1:])
    with pytest.raises(rp.InvalidArgumentError, match="one value for each of 200 samples, got 199"):
        search(done.u, done.y, DT, reference=done.r[1:])


def test_a_clock_that_jitters_keeps_the_colour_of_the_noise() -> None:
    """The residuals beside each other are the same ones; where an interval is much longer enough others are left."""
    plant, generator = rp.TransferFunction([1.0], [1.0, 1.0]), np.random.default_rng(0)
    noise = lfilter([1.0], [1.0, -0.9], 0.01 * generator.standard_normal(3000))
    u, y, t = irregular_record(plant, 0, 3000, DT, jitter=0.8, hold=8)
    fitted = rp.fit(u, y + noise, DT, rp.Structure(1), t=t)
    assert fitted.noise.coefficients[1] == pytest.approx(-0.9, abs=0.05)
    u = prbs(3000, hold=8)
    t = DT * (np.arange(3000) + (np.arange(3000) // 100) * 0.6)  # every hundredth interval
    assert rp.fit(u, plant.simulate(u, DT) + noise, DT, rp.Structure(1), t=t).noise.order == 1
