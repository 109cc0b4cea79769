"""The measures against their definitions, sample by sample."""

import numpy as np
import pytest

from replant import Trace
from replant.paper.actuator import Course, measure
from support.cases import every

TRUE = {"a0": 2.0, "b0": -0.5}


def wandering(samples, seed=0):
    """Return a trace that comes near the true values and trembles there."""
    generator = np.random.default_rng(seed)
    approach = 1 - np.exp(-np.arange(1, samples + 1) / (0.1 * samples))
    values = approach[:, None] * list(TRUE.values()) + 0.01 * generator.standard_normal((samples, 2))
    bias = generator.standard_normal((samples, 1))
    return Trace(("a0", "b0", "bias"), np.zeros(3), np.hstack([values, bias]), np.zeros(samples))


def test_a_whole_trace_gives_the_articles_index():
    trace = wandering(500)
    measures = measure(Course.of(trace), TRUE, dt=0.1)
    expected = trace.index([*TRUE.values(), 0.0])[:2]
    assert list(measures.index.values()) == pytest.approx(expected, rel=1e-12)
    assert measures.index_sum == pytest.approx(expected.sum(), rel=1e-12)


def test_every_measure_follows_its_definition():
    trace = wandering(500)
    measures = measure(Course.of(trace), TRUE, dt=0.1)
    for i, (name, true) in enumerate(TRUE.items()):
        values = trace.parameters[:, i]
        assert measures.error[name] == pytest.approx(100 * (values[-1] - true) / abs(true))
        k = len(values)
        while k > 0 and abs(values[k - 1] - true) <= 0.1 * abs(true):
            k -= 1
        assert measures.settled[name] == pytest.approx(0.1 * (k + 1))  # the estimate after sample k + 1, counted from 1
        tail, t = values[450:], np.arange(50)
        scatter = (tail - np.polyval(np.polyfit(t, tail, 1), t)).std()
        assert measures.roughness[name] == pytest.approx(100 * scatter / abs(true))
    assert measures.all_settled == max(measures.settled.values())
    assert measures.roughest == max(measures.roughness.values())


def test_a_thinned_course_stands_still_between_its_rows():
    rows = np.array([[1.0], [3.0]])
    thinned = Course(np.zeros(1), np.array([3, 6]), rows, length=8)
    # the estimates that (21) counts: start for samples 0-2, the first row for 3-5, the second for 6-7
    held = np.array([0, 0, 0, 1, 1, 1, 3, 3.0])
    assert measure(thinned, {"a0": 2.0}, dt=1.0).index["a0"] == pytest.approx(((held - 2) ** 2).sum())


@every(
    ("values", "settled"),
    [([2.0, 2.1, 1.9], 0.1), ([0.0, 2.1, 1.9], 0.2), ([2.0, 0.0, 2.0], 0.3), ([2.0, 2.0, 3.0], None)],
)
def test_settled_is_for_good(values, settled):
    course = Course(np.zeros(1), np.arange(1, 4), np.array(values)[:, None], length=3)
    found = measure(course, {"a0": 2.0}, dt=0.1).settled["a0"]
    assert found == (None if settled is None else pytest.approx(settled))


def test_all_settled_needs_every_coefficient():
    course = Course(np.zeros(2), np.arange(1, 3), np.array([[2.0, 7.0], [2.0, 7.0]]), length=2)
    assert measure(course, TRUE, dt=1.0).all_settled is None


def test_a_straight_line_is_not_rough():
    values = np.linspace(0.0, 1.9, 1000)[:, None]
    course = Course(np.zeros(1), np.arange(1, 1001), values, length=1000)
    assert measure(course, {"a0": 2.0}, dt=1.0).roughness["a0"] == pytest.approx(0.0, abs=1e-9)
