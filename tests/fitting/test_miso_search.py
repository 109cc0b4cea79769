"""Search over the structures of several inputs: one input is changed at a time, judged by the evidence."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.solver.undetermined_poles import grown
from replant.numerics.arguments import FloatArray
from support.cases import every

DT = 0.1
RESONANT = rp.TransferFunction([4.0], [1.0, 1.0, 4.0], delay=0.2)
SLOW = rp.TransferFunction([0.5], [1.0, 0.5], delay=0.45)
DELAYS = (0.0, 0.2, 0.4, 0.6)


def record(seed: int, samples: int = 800) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (samples // 10, 2)).repeat(10, axis=0)
    x = RESONANT.simulate(u[:, 0].copy(), DT) + SLOW.simulate(u[:, 1].copy(), DT)
    return u, x + 5.0 + 0.05 * rng.standard_normal(samples)


@pytest.fixture(scope="module")
def found() -> Any:
    told = []
    result = rp.search(*record(0), DT, poles=(1, 2, 3), zeros=0, delays=DELAYS, progress=lambda *of: told.append(of))
    assert told[-1][0] == told[-1][1]
    assert all(done <= of for done, of in told)
    return result


def test_poles_and_dead_times_of_each_input_are_found(found: Any) -> None:
    assert [each.poles for each in found.best.model.structures] == [2, 1]
    assert found.delays[0] == 0.2
    assert found.delays[1] == pytest.approx(0.45, abs=0.02)  # between the points of the grid
    assert found.chosen.of_inputs("poles") == "2, 1"
    assert found.best.verdict.status == "trusted"


def test_the_best_is_the_fit_of_its_structure(found: Any) -> None:
    alone = rp.fit(*record(0), DT, poles=(2, 1), delay=found.delays)
    assert isinstance(alone, rp.RowFit)
    assert alone.parameters == pytest.approx(found.best.parameters, rel=1e-9)


def test_far_fewer_structures_are_tried_than_there_are_and_the_right_one_has_evidence(found: Any) -> None:
    assert len(found.candidates) < (3 * len(DELAYS)) ** 2 / 2
    assert any(each is found.chosen for each in found.candidates)
    fewer = [each for each in found.candidates if each.of_inputs("poles") == "1, 1"]
    assert all(each.criterion > found.chosen.criterion + 100.0 for each in fewer)
    assert "2, 1 poles, 0, 0 zeros" in repr(found)
    assert 0.0 < found.chosen.uncertainty < 0.1


def test_a_range_for_each_input_and_logs() -> None:
    u, y = record(1)
    log = rp.Log(u[:, 0], y, DT, input_name="Q1", others={"Q2": u[:, 1]}, more_inputs=("Q2",))
    found = rp.search(log, poles=((2,), (1, 2)), zeros=0, delays=((0.2,), (0.45,)))
    assert [each.poles for each in found.best.model.structures] == [2, 1]
    assert found.best.model.input_names == ("Q1", "Q2")
    assert found.delays == (0.2, 0.45)


@pytest.mark.slow
def test_an_iterator_of_numbers_is_that_of_each_input_and_output() -> None:
    u, y = record(2, 300)
    ranges = rp.search(u, np.column_stack([y, y]), DT, poles=(1, 2), zeros=0, delays=(0.0, 0.2))
    ended = rp.search(u, np.column_stack([y, y]), DT, poles=iter((1, 2)), zeros=iter([0]), delays=iter((0.0, 0.2)))
    assert repr(ended) == repr(ranges)


def test_a_grown_model_answers_as_the_smaller_one() -> None:
    less, more = rp.Structure(1), rp.Structure(2, zeros=1)
    theta = np.array([2.0, 3.0])
    model = more.transfer_function(grown(less, theta, more, 0.01))
    assert model.dc_gain == pytest.approx(1.5)
    assert np.abs(model.poles).max() == pytest.approx(100.0)
    assert np.abs(model.poles).min() == pytest.approx(2.0)


@every(
    "asked, words",
    [
        ({"poles": ((1,), (1,), (1,))}, "poles has 3 ranges and u 2 inputs"),
        ({"poles": 1, "zeros": 1}, "zeros must be fewer than poles"),
        ({"poles": 1, "delays": 99.0}, "no shorter than the record"),
        ({"poles": 1, "bias": True}, "several inputs take no bias yet"),
    ],
)
def test_what_cannot_be_searched_is_named_in_a_line(asked: dict[str, Any], words: str) -> None:
    with pytest.raises(rp.ReplantError, match=words) as caught:
        rp.search(*record(0), DT, **asked)
    assert "\n" not in str(caught.value)


@pytest.mark.slow
@every("noise, seed", product([1e-5, 0.0, 1e-3], [1002, 1009]), quick=1)
def test_a_noise_model_takes_no_wrong_structure_for_noise(noise: float, seed: int) -> None:
    """Of a record with little noise an autoregression predicts what a wrong structure leaves, too."""
    generator = np.random.default_rng(seed)
    u = np.column_stack([generator.choice([-1.0, 1.0], 134).repeat(15)[:2000] for _ in range(2)])
    slow, swinging = rp.TransferFunction([2.0], [1.0, 0.5]), rp.TransferFunction([9.0], [1.0, 1.2, 9.0], delay=0.3)
    y = slow.simulate(u[:, 0], 0.1) + swinging.simulate(u[:, 1], 0.1) + noise * generator.standard_normal(2000)
    best = rp.search(u, y, 0.1, poles=(1, 2), delays=((0.0,), (0.0, 0.3))).best
    assert [(each.poles, each.zeros, each.delay) for each in best.model.structures] == [(1, 0, 0.0), (2, 0, 0.3)]


@pytest.mark.slow
def test_drift_leaves_a_search_the_structures() -> None:
    """What a model without a noise model leaves of a drift tells little of structures."""
    generator = np.random.default_rng(1)
    u = np.column_stack([generator.choice([-1.0, 1.0], 67).repeat(15)[:1000] for _ in range(2)])
    slow, swinging = rp.TransferFunction([2.0], [1.0, 0.5]), rp.TransferFunction([9.0], [1.0, 1.2, 9.0])
    y = slow.simulate(u[:, 0], 0.1) + swinging.simulate(u[:, 1], 0.1) + 0.05 * generator.standard_normal(1000).cumsum()
    best = rp.search(u, y, 0.1, poles=(1, 2), zeros=0).best
    assert best.model.structures[1].poles == 2


@pytest.mark.filterwarnings("error")
def test_a_search_with_an_input_that_rests_says_so_without_a_warning() -> None:
    generator = np.random.default_rng(0)
    u = np.column_stack([generator.choice([-1.0, 1.0], 50).repeat(20), np.zeros(1000)])
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u[:, 0], 0.1) + 0.1 * generator.standard_normal(1000)
    assert rp.search(u, y, 0.1, poles=(1, 2)).best.verdict.status == "not excited"
