"""Feedback is found where it is, not in open loop, and a wrong model is not taken for it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, kstest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import run_model
from replant.estimation.solver.feedback_test import Feedback
from replant.kernels.schema import LAGS
from replant.numerics.autoregression import in_a_row
from replant.numerics.levels import ALPHA
from replant.verdict.evidence import Evidence
from replant.verdict.loop import answer, colour_left
from support.builders import G1, binary
from support.loops import DT, coloured, controlled, steps

SAMPLES = 700
TRUE = np.array([0.5, 1.25])


def answer_to(
    y: np.ndarray, u: np.ndarray, model: np.ndarray = TRUE, x: np.ndarray | None = None, *, direct: bool = False
) -> Feedback:
    """How x, or else the input, answers the residual of a model."""
    structure, record = rp.Structure(1, int(direct), feedthrough=direct), Record(u, y, np.array([DT]))
    run = run_model(structure, model, record, DT)
    assert run is not None
    assert run.is_direct == direct
    evidence = Evidence(structure, DT, record, model, None, model, 0, u.size)
    return answer(evidence, run, u if x is None else x, first=int(direct))


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_in_open_loop_it_is_hardly_ever_found(colour: float) -> None:
    """60 records, the model right or wrong by a third: by chance one of 100 such tables has an alarm."""
    assert binom.sf(0, 60, ALPHA) < 0.01
    chances = []
    for seed in range(60):
        u = binary(seed, SAMPLES, 5)
        y = G1.simulate(u, DT) + 0.3 * coloured(seed, SAMPLES, colour)
        chances.append(answer_to(y, u, TRUE * (0.7 if seed % 2 else 1.0)).chance)
    assert np.count_nonzero(np.array(chances) < ALPHA) <= 1
    assert kstest(chances, "uniform", alternative="greater").pvalue > 1e-3  # no more small ones than by chance


@pytest.mark.parametrize(("colour", "integral"), [(0.0, 0.0), (0.0, 1.0), (0.8, 1.0)])
def test_in_closed_loop_it_is_found(colour: float, integral: float) -> None:
    for seed in range(3):
        noise = 0.1 * coloured(seed, SAMPLES, colour)
        loop = controlled(G1, steps(seed, SAMPLES), noise, gain=2.0, integral=integral)
        assert answer_to(loop.y, loop.u).found
        assert not answer_to(loop.y, loop.u).is_direct(rp.Structure(1), TRUE)
        assert not answer_to(loop.y, loop.u, x=loop.r).found  # the reference answers nothing


def test_a_direct_path_that_the_model_lacks_looks_like_an_answer_at_once() -> None:
    u = binary(3, SAMPLES)
    y = G1.simulate(u, DT) + 0.2 * u + 0.1 * coloured(3, SAMPLES, 0.0)
    found = answer_to(y, u)
    assert found.found
    assert found.is_at_once
    assert not answer_to(y, u, np.array([0.5, 0.2, 1.35]), direct=True).found
    assert found.is_direct(rp.Structure(1), TRUE)
    assert not found.is_direct(rp.Structure(1), np.array([0.5, -1.25]))  # a controller's, of a plant of the other sign


def test_where_nothing_can_be_told_nothing_is_found() -> None:
    u = binary(1, SAMPLES, 5)
    y = G1.simulate(u, DT) + coloured(1, SAMPLES, 0.0)
    assert answer_to(y[:100], u[:100]).chance == 1.0  # too few samples
    assert answer_to(y, u, x=np.ones(SAMPLES)).chance == 1.0
    assert not answer_to(y, u, x=np.sin(0.1 * np.arange(SAMPLES))).found  # its past tells its future
    assert not answer_to(G1.simulate(u, DT), u).found


def test_colour_that_the_noise_model_takes_is_none() -> None:
    noise, past = coloured(1, 5000, 0.9), np.minimum(np.arange(5000), LAGS)
    assert colour_left(noise, past) < 1.0 < colour_left(noise[20:] + noise[:-20], past[20:])


def test_colour_beside_holes_that_the_noise_model_takes_is_none() -> None:
    """Of 20 records with 15 % of the outputs missing: the statistic over its limit at 1e-4 stays below 1."""
    for seed in range(20):
        noise, there = coloured(seed, 3000, 0.98), np.random.default_rng(seed).random(3000) > 0.15
        assert colour_left(np.where(there, noise, np.nan), np.minimum(in_a_row(there), LAGS)) < 1.0


def test_the_rounding_of_a_coarse_sensor_answers_nothing() -> None:
    """It follows from the input's past, though by no linear rule; noise of a step makes it white."""
    plant, rng, levels = rp.TransferFunction([60.0], [1.0, 16.0, 60.0]), np.random.default_rng(3), []
    while len(levels) < 5000:
        levels += [rng.choice([-1.0, -0.5, 0.5, 1.0])] * int(rng.integers(5, 200))
    u, step = np.array(levels[:5000]), 0.03
    y = plant.simulate(u, 0.01)
    for noise in (0.003, 0.03):
        measured = np.round((y + noise * rng.standard_normal(u.size)) / step) * step
        found = rp.fit(u, measured, 0.01, poles=2)
        assert found.verdict.status == "trusted", found.verdict.reasons
