"""Where the residual is coloured: whether the estimate that the noise model filters is taken."""

from dataclasses import replace

import numpy as np
import pytest

import replant as rp
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.offline.coloured_residual import FEWEST, answers_output, is_noise
from replant.offline.refined import Refined
from replant.offline.srivc import refine
from support.loops import DT, coloured, controlled, steps

LAG = rp.TransferFunction([1.0], [1.0, 1.0])
STRUCTURE = Structure(1)
SAMPLES = 1500
BOTH = [(True, True), (True, False), (False, True), (False, False)]  # whether plain and filtered have converged


def record_of(u: np.ndarray, y: np.ndarray) -> Record:
    return Record(u, y, np.array([DT]))


def in_feedback(samples: int = SAMPLES) -> Record:
    loop = controlled(LAG, steps(1, samples), 0.1 * coloured(2, samples, 0.9), gain=3.0)
    return record_of(loop.u, loop.y)


def in_open_loop(samples: int = SAMPLES) -> Record:
    u = steps(1, samples)
    return record_of(u, LAG.simulate(u, DT) + 0.1 * coloured(2, samples, 0.9))


def estimate(record: Record, *, converged: bool, pole: float = -1.0) -> Refined:
    """An estimate of a record with this pole; whether its steps have converged is given."""
    found = refine(STRUCTURE, record)
    assert found is not None
    theta = found.theta.copy()
    theta[0] = -pole
    return replace(found, theta=theta, converged=converged)


def is_filtered_taken(record: Record, plain: bool, filtered: bool, pole: float = -1.0) -> bool:
    return is_noise(
        STRUCTURE, record, estimate(record, converged=plain), estimate(record, converged=filtered, pole=pole)
    )


@pytest.mark.parametrize(("plain", "filtered"), BOTH)
def test_in_feedback_it_is_taken_whether_its_last_steps_are_missing_or_not(plain: bool, filtered: bool) -> None:
    """Without a filter the estimate is biased, however well its iteration converges."""
    assert is_filtered_taken(in_feedback(), plain, filtered)


@pytest.mark.parametrize(("plain", "filtered"), BOTH)
def test_in_open_loop_it_is_taken_only_if_it_has_converged(plain: bool, filtered: bool) -> None:
    assert is_filtered_taken(in_open_loop(), plain, filtered) == filtered


def test_in_open_loop_it_is_not_taken_where_the_input_explains_a_part_of_the_residual() -> None:
    """Half of the plant's gain is missing from the model."""
    record = in_open_loop()
    plain = estimate(record, converged=True)
    plain.theta[1] *= 0.5
    assert not is_noise(STRUCTURE, record, plain, estimate(record, converged=True))


@pytest.mark.parametrize("samples", [100, SAMPLES])
@pytest.mark.parametrize("converged", [False, True])
def test_of_an_unstable_plant_it_is_taken_if_it_has_converged(samples: int, converged: bool) -> None:
    """A plant that is not stable is in feedback, even where too few samples tell so."""
    assert is_filtered_taken(in_open_loop(samples), True, converged, pole=1.0) == converged


@pytest.mark.parametrize("samples", [100, FEWEST - 1])
def test_a_short_record_of_a_stable_plant_keeps_the_plain_estimate(samples: int) -> None:
    assert not is_filtered_taken(in_feedback(samples), True, True)


def test_only_an_input_in_feedback_answers_the_output() -> None:
    closed, opened = in_feedback(), in_open_loop()
    assert answers_output(closed.u, closed.y)
    assert not answers_output(opened.u, opened.y)


def test_a_set_point_that_steps_does_not_drown_the_answers() -> None:
    """Its steps are a hundred times as large as the noise."""
    loop = controlled(LAG, 100.0 * steps(1, SAMPLES, hold=50), coloured(2, SAMPLES, 0.9), gain=3.0)
    assert answers_output(loop.u, loop.y)
