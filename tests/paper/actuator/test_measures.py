"""The measures against their definitions, sample by sample."""

import numpy as np
import pytest

from replant import Trace
from replant.paper.actuator import DEFAULT, Row, measure
from support.cases import every

TRUE = {"a0": 2.0, "b0": -0.5}


def totals(measures):
    """Return the totals of an online run with these measures."""
    return Row(DEFAULT, "default", "own", measures, 0.0).totals


def wandering(samples, seed=0):
    """Return a trace that comes near the true values and trembles there."""
    generator = np.random.default_rng(seed)
    approach = 1 - np.exp(-np.arange(1, samples + 1) / (0.1 * samples))
    values = approach[:, None] * list(TRUE.values()) + 0.01 * generator.standard_normal((samples, 2))
    bias = generator.standard_normal((samples, 1))
    return Trace(("a0", "b0", "bias"), np.zeros(3), np.hstack([values, bias]), np.zeros(samples))


def test_a_whole_trace_gives_the_articles_index():
    trace = wandering(500)
    measures = measure(trace.start, trace.parameters, TRUE, dt=0.1)
    expected = trace.index([*TRUE.values(), 0.0])[:2]
    assert list(measures["J"].values()) == pytest.approx(expected, rel=1e-12)
    assert totals(measures)["J_sum"] == pytest.approx(expected.sum(), rel=1e-12)


def test_every_measure_follows_its_definition():
    trace = wandering(500)
    measures = measure(trace.start, trace.parameters, TRUE, dt=0.1)
    for i, (name, true) in enumerate(TRUE.items()):
        values = trace.parameters[:, i]
        assert measures["error"][name] == pytest.approx(100 * (values[-1] - true) / abs(true))
        k = len(values)
        while k > 0 and abs(values[k - 1] - true) <= 0.1 * abs(true):
            k -= 1
        assert measures["settled"][name] == pytest.approx(
            0.1 * (k + 1)
        )  # the estimate after sample k + 1, counted from 1
        tail, t = values[450:], np.arange(50)
        scatter = (tail - np.polyval(np.polyfit(t, tail, 1), t)).std()
        assert measures["roughness"][name] == pytest.approx(100 * scatter / abs(true))
    assert totals(measures)["settled"] == max(measures["settled"].values())
    assert totals(measures)["roughness"] == max(measures["roughness"].values())


def test_a_thinned_course_stands_still_between_its_rows():
    rows = np.array([[1.0], [3.0]])
    thinned = measure(np.zeros(1), rows, {"a0": 2.0}, 1.0, np.array([3, 6]), length=8)
    # the estimates that (21) counts: start for samples 0-2, the first row for 3-5, the second for 6-7
    held = np.array([0, 0, 0, 1, 1, 1, 3, 3.0])
    assert thinned["J"]["a0"] == pytest.approx(((held - 2) ** 2).sum())


@every(
    ("values", "settled"),
    [([2.0, 2.1, 1.9], 0.1), ([0.0, 2.1, 1.9], 0.2), ([2.0, 0.0, 2.0], 0.3), ([2.0, 2.0, 3.0], None)],
)
def test_settled_is_for_good(values, settled):
    found = measure(np.zeros(1), np.array(values)[:, None], {"a0": 2.0}, dt=0.1)["settled"]["a0"]
    assert found == (None if settled is None else pytest.approx(settled))


def test_all_settled_needs_every_coefficient():
    found = measure(np.zeros(2), np.array([[2.0, 7.0], [2.0, 7.0]]), TRUE, dt=1.0)
    assert totals(found)["settled"] is None


def test_a_straight_line_is_not_rough():
    values = np.linspace(0.0, 1.9, 1000)[:, None]
    assert measure(np.zeros(1), values, {"a0": 2.0}, dt=1.0)["roughness"]["a0"] == pytest.approx(0.0, abs=1e-9)
