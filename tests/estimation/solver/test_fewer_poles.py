"""Surplus poles: a model with more poles explains no less."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem
from replant.estimation.solver.undetermined_poles import INFINITE, grown, with_poles
from support.cases import every

FINE = 20  # steps of the simulation in a sampling time


def plant(rng: np.random.Generator, poles: int, dt: float) -> rp.TransferFunction:
    """A plant with poles from a fiftieth of the sampling to twice as fast, a third of the pairs complex."""
    found: list[complex] = []
    while len(found) < poles:
        size = np.exp(rng.uniform(np.log(0.02), np.log(2.0))) / dt
        pair = np.exp(1j * rng.uniform(0.55, 0.9) * np.pi)
        found += [size * pair, size * pair.conjugate()] if rng.random() < 1 / 3 and poles - len(found) > 1 else [-size]
    den = np.poly(found).real
    return rp.TransferFunction([rng.uniform(0.5, 3.0) * den[-1]], den)


def record(seed: int, kind: str) -> tuple[np.ndarray, np.ndarray, float, int]:
    """Input, output, sampling time and number of poles; what the input does between samples is of a kind."""
    rng = np.random.default_rng(seed)
    dt, samples, poles = float(rng.choice([1e-3, 0.1, 5.0])), 1200, int(rng.integers(1, 4))
    t = np.arange(samples * FINE) * dt / FINE
    if kind == "sines":
        sizes = np.exp(rng.uniform(np.log(0.005), np.log(0.12), 8)) / dt
        u = np.sin(2.0 * np.pi * sizes * t[:, None] + rng.uniform(0.0, 6.28, 8)).sum(axis=1)
    elif kind == "straight":
        u = np.interp(t, t[::FINE], rng.standard_normal(samples))
    else:
        u = rng.standard_normal(samples).repeat(FINE)
    y = plant(rng, poles, dt).simulate(u, dt / FINE)[::FINE]
    return u[::FINE], y + rng.choice([0.02, 0.1]) * y.std() * rng.standard_normal(samples), dt, poles


@pytest.mark.slow
@every("kind, hold", [("held", "zoh"), ("straight", "foh"), ("sines", "zoh"), ("sines", "foh")])
@every("seed", range(6), quick=2)
def test_a_surplus_pole_explains_no_less(kind: str, hold: str, seed: int) -> None:
    """By a point of the fit: a minimum that lies elsewhere may be missed by the start from the smaller model, too."""
    u, y, dt, poles = record(seed, kind)
    fits = [rp.fit(u, y, dt, poles=n, filter=rp.RefinedFilter(hold)).simulation.fit for n in range(poles, 5)]
    assert (np.diff(fits) > -1.0).all(), fits


def test_a_pole_as_fast_as_the_sampling_is_kept_beside_a_surplus_one() -> None:
    """The input runs straight between samples and counts as held: the surplus pole would lead the output."""
    rng, dt = np.random.default_rng(1), 1e-3
    t = np.arange(4000 * FINE) * dt / FINE
    phases, rates = rng.uniform(0.0, 6.28, 8), 2.0 * np.pi * rng.uniform(5.0, 120.0, 8)
    u = np.sin(rates * t[:, None] + phases).sum(axis=1)
    y = rp.TransferFunction([520.0], [1.0, 535.0]).simulate(u, dt / FINE)[::FINE] + 0.05 * rng.standard_normal(4000)
    one, two = (rp.fit(u[::FINE], y, dt, poles=n) for n in (1, 2))
    assert one.simulation.fit > 80.0
    assert two.simulation.fit == pytest.approx(one.simulation.fit, abs=0.1)
    assert min(-two.transfer_function.poles.real) == pytest.approx(-one.transfer_function.poles[0].real, rel=0.01)


@every("poles", [2, 3, 4, 6, 8])
def test_a_grown_model_has_the_error_of_the_smaller_one(poles: int) -> None:
    less, more = rp.Structure(1), rp.Structure(poles)
    u, y, dt, _ = record(3, "held")
    held = Record(u, y, np.array([dt]))
    found = refine(less, held)
    assert found is not None
    problem = Problem(more, held)
    theta = without_nuisances(more, grown(less, found.theta, more, dt / INFINITE))
    cost = problem.run(problem.with_nuisances(theta)).cost
    assert cost == pytest.approx(Problem(less, held).run(found.theta).cost, rel=0.1)


def test_a_smaller_structure_has_the_zeros_that_it_may_have() -> None:
    assert with_poles(rp.Structure(3, 2, 0.5, bias=True), 2) == rp.Structure(2, 1, 0.5, bias=True)
    assert with_poles(rp.Structure(3, 3, feedthrough=True), 2) == rp.Structure(2, 2, feedthrough=True)
    assert with_poles(rp.Structure(3), 1) == rp.Structure(1)


@pytest.mark.parametrize(("seed", "poles"), [(2, 3), (0, 4)])
def test_the_covariance_of_surplus_poles_is_one(seed: int, poles: int, tmp_path: Path) -> None:
    """Rounding leaves few digits of it: the model can be saved and read nevertheless."""
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.choice([-1.0, 1.0], 60), 10)
    y = rp.TransferFunction([2.0], [1.0, 2.0]).simulate(u, 0.1) + 0.02 * generator.standard_normal(600)
    found = rp.fit(u, y, 0.1, poles=poles)
    assert found.covariance is not None
    spread = np.sqrt(np.diag(found.covariance))
    np.testing.assert_array_equal(found.covariance, found.covariance.T)
    assert np.abs(found.covariance / np.outer(spread, spread)).max() <= 1.0 + 1e-12
    found.model.save(tmp_path / "model.json")
    np.testing.assert_array_equal(rp.load_model(tmp_path / "model.json").covariance, found.covariance)
