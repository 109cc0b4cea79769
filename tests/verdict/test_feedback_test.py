"""Feedback is found where it is, not in open loop, and a wrong model is not taken for it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import ModelRun, run_model
from replant.numerics.levels import ALPHA
from replant.verdict.loop_tests import NONE, answer, colour_left
from support.builders import G1, binary
from support.loops import DT, coloured, controlled, steps

SAMPLES, ALL = 700, slice(0, 700)
TRUE = np.array([0.5, 1.25])


def run_of(y: np.ndarray, u: np.ndarray, model: np.ndarray = TRUE, **structure: bool) -> ModelRun:
    zeros = int(structure.get("feedthrough", False))
    run = run_model(rp.Structure(1, zeros, **structure), model, Record(u, y, np.array([DT])), DT)
    assert run is not None
    return run


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_in_open_loop_it_is_hardly_ever_found(colour: float) -> None:
    """60 records, the model right or wrong by a third: by chance one of 100 such tables has an alarm."""
    assert binom.sf(0, 60, ALPHA) < 0.01
    statistics = []
    for seed in range(60):
        u = binary(seed, SAMPLES, 5)
        y = G1.simulate(u, DT) + 0.3 * coloured(seed, SAMPLES, colour)
        statistics.append(answer(run_of(y, u, TRUE * (0.7 if seed % 2 else 1.0)), ALL, u).statistic)
    assert np.count_nonzero(np.array(statistics) > 1.0) <= 1
    assert np.mean(statistics) < 0.5  # eleven degrees of freedom over the limit at 1e-4, 37


@pytest.mark.parametrize(("colour", "integral"), [(0.0, 0.0), (0.0, 1.0), (0.8, 1.0)])
def test_in_closed_loop_it_is_found(colour: float, integral: float) -> None:
    for seed in range(3):
        noise = 0.1 * coloured(seed, SAMPLES, colour)
        loop = controlled(G1, steps(seed, SAMPLES), noise, gain=2.0, integral=integral)
        run = run_of(loop.y, loop.u)
        assert answer(run, ALL, loop.u).found
        assert not answer(run, ALL, loop.r).found  # the reference answers nothing


def test_a_direct_path_that_the_model_lacks_looks_like_an_answer_at_once() -> None:
    u = binary(3, SAMPLES)
    y = G1.simulate(u, DT) + 0.2 * u + 0.1 * coloured(3, SAMPLES, 0.0)
    found = answer(run_of(y, u), ALL, u)
    assert found.found
    assert found.at_once
    direct = run_of(y, u, np.array([0.5, 0.2, 1.35]), feedthrough=True)
    assert direct.is_direct
    assert not answer(direct, ALL, u, first=1).found


def test_where_nothing_can_be_told_nothing_is_found() -> None:
    u = binary(1, SAMPLES, 5)
    run = run_of(G1.simulate(u, DT) + coloured(1, SAMPLES, 0.0), u)
    assert answer(run, slice(0, 100), u) == NONE  # too few samples
    assert answer(run, ALL, np.ones(SAMPLES)) == NONE
    assert not answer(run, ALL, np.sin(0.1 * np.arange(SAMPLES))).found  # its past tells its future
    assert answer(run_of(G1.simulate(u, DT), u), ALL, u).statistic < 1.0


def test_colour_that_the_noise_model_takes_is_none() -> None:
    noise = coloured(1, 5000, 0.9)
    assert colour_left(noise) < 1.0 < colour_left(noise[20:] + noise[:-20])
