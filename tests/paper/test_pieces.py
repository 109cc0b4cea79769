"""Measures, figures and texts of the article's reproduction."""

from __future__ import annotations

import math

import numpy as np
import pytest

from replant.paper.actuator import measure, measure_rig
from replant.paper.figures import FIGURES, compute
from replant.paper.rendering import _listed, _short, typeset
from replant.paper.tables import TABLES, Cell, Plant, reproduce, run_seeds, thin


def test_the_measures_of_a_short_estimate_are_right() -> None:
    found = measure(np.zeros(1), np.array([[1.0], [3.0], [2.1], [2.0]]), {"a0": 2.0}, dt=0.5)
    assert found["J"] == {"a0": pytest.approx(2.0**2 + 1.0**2 + 1.0**2 + 0.1**2)}
    assert (found["error"], found["settled"]) == ({"a0": 0.0}, {"a0": 1.5})


def test_the_record_is_that_of_the_rig_of_table_6() -> None:
    record = measure_rig(1000)
    assert (record.y.size, record.true["a1"]) == (1000, 5891.0)


def test_a_signal_is_drawn_with_its_extremes() -> None:
    assert thin(np.array([0.0, 9.0, 1.0, 2.0, -5.0, 3.0, 4.0, 5.0]), points=4).tolist() == [0, 1, 4, 7]


def test_a_figure_has_a_curve_for_each_label_and_parameter() -> None:
    curves = compute(FIGURES["fig4"])
    assert list(curves) == ["without bias", "with bias"]
    assert list(curves["with bias"]) == ["a0", "b0", "bias"]


def test_numbers_are_short() -> None:
    numbers = (-0.001, 6.406, -101.76, 2.79e12, -math.inf, None)
    assert [_short(value) for value in numbers] == ["0.00", "6.41", "-102", "2.79e12", "none", "never"]
    assert _listed({"a1": -0.00123, "a0": 102.4}) == "a1 0.0012 %, a0 102 %"


def test_text_of_the_terminal_is_typeset() -> None:
    assert typeset("J_sum 2.79e12, a0 -5 %, g_n 5e-5 (1/s^2)") == (
        "J<sub>sum</sub> 2.79×10<sup>12</sup>, a<sub>0</sub> −5\xa0%, g<sub>n</sub> 5×10<sup>−5</sup> (1/s<sup>2</sup>)"
    )


def test_figures_are_compared_with_the_published_ones() -> None:
    assert Cell("J_a0", ours=5186.3, published=5.19e3).verdict == "equal"
    assert Cell("J_a0", ours=2165.0, published=2.14e3, std=29.0).verdict == "within 3 std"
    assert reproduce(TABLES["table2"])["AMSGrad, amplitude 0.1"]["J_b0"].verdict == "equal"


def test_an_experiment_gives_the_published_indices() -> None:
    plant = Plant(num=(1.25,), den=(1.0, 0.5), dt=1e-3, duration=10.0, period=1.25)
    assert (plant.samples, plant.true) == (10000, {"a0": 0.5, "b0": 1.25})
    (indices,) = run_seeds(TABLES["table1"].row("Gradient, no buffer").experiment, [0])
    assert {name: f"{value:.2e}" for name, value in indices.items()} == {
        "J_a0": "8.41e+02", "J_b0": "1.64e+03", "J_sum": "2.48e+03",
    }  # fmt: skip
