"""The benchmark of step tests: the records are what they say, and orders are told apart by what noise allows."""

from __future__ import annotations

import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from steps.cases import CASES, NOISE, SAMPLES, TEXTBOOK, drawn, explained, nats_apart
from steps.command import COUNTS, counted, table_of
from steps.outcome import STRUCTURES, Outcome, Way, carry_out


def test_a_step_test_is_the_same_whenever_it_is_drawn() -> None:
    one, again, other = drawn(1, 0, 3), drawn(1, 0, 3), drawn(2, 0, 3)
    assert np.array_equal(one.y, again.y)
    assert not np.array_equal(one.y, other.y[: one.y.size])
    assert drawn(1, 0, 3, 150).y.size == 150


def test_a_step_test_steps_once_or_up_and_down_and_comes_to_rest_first() -> None:
    downs = set()
    for case, of in enumerate(CASES):
        for number in range(6):
            test = drawn(1, case, number)
            steps = np.flatnonzero(np.diff(test.v))
            assert SAMPLES[0] <= test.u.size <= SAMPLES[1]
            assert steps.size == 1 + ("down" in test.what)
            assert not test.clean[: steps[0] + 1].any()
            height = abs(float(np.ptp(test.v)) * of.plant.dc_gain)
            assert NOISE[0] <= test.sigma / height <= NOISE[1]
            assert explained(test, of.plant, of.dt) == pytest.approx(100.0)
            downs.add(steps.size)
    assert downs == {1, 2}


def test_a_user_gives_dead_times_about_the_right_one() -> None:
    for of in CASES:
        assert of.delays[0] == 0.0
        assert of.delays[-1] >= of.plant.delay
    assert TEXTBOOK.delays == (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert len(TEXTBOOK.delays) * 6 == STRUCTURES  # of one to three poles, with all numbers of zeros


def test_orders_are_farther_apart_where_there_is_less_noise() -> None:
    """The expectation is a sum of squares over twice the variance."""
    for case in (0, 3, 5):
        test = drawn(1, case, 0)
        nats = nats_apart(CASES[case], test)
        assert nats_apart(CASES[case], replace(test, sigma=2.0 * test.sigma)) == pytest.approx(nats / 4.0, rel=1e-6)
    assert nats > 100.0  # an oscillation is no lag


def test_a_textbook_step_test_is_identified() -> None:
    found = carry_out(1, (0, 0, 200))
    assert found.is_delay_found
    assert found.fitted.is_right
    assert (found.searched.poles, found.searched.zeros) == (1, 0)


def test_the_table_counts() -> None:
    way = Way(1, 0, 0.5, 99.0, True, "trusted", 1.0)
    one = Outcome(0, 0, "", 20.0, way, way)
    nothing = replace(one, searched=Way(0, 0, math.inf, -100.0, False, "no model", 1.0))
    close = replace(one, nats=1.0, searched=replace(way, poles=2, known=False, fit=90.0, delay_off=-3.0))
    group = [one, nothing, close]
    assert [counted(group, *count) for count in COUNTS.values()] == [
        "1/3", "1/2", "0/1", "1/3", "1/1", "1/2", "3/3", "3/3", "3/3", "-",
    ]  # fmt: skip
    assert table_of("", {"all": group}).row_count == len(COUNTS) + 2
