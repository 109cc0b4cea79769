"""Whether an input answers a residual: under a controller, behind steps of the set-point, where rows are lost."""

from __future__ import annotations

import numpy as np
import pytest

from replant.estimation.solver.feedback_test import answering, part_answering
from replant.numerics.levels import ALPHA
from support.cases import every

SAMPLES = 1500
INDEX = np.arange(SAMPLES)


def test_an_input_in_feedback_answers_and_a_reference_does_not() -> None:
    w, r = np.random.default_rng(3).standard_normal((2, SAMPLES))
    slow = np.convolve(r, 0.95 ** np.arange(200))[:SAMPLES]
    for free in (r, slow):
        found = answering(free - 0.5 * np.roll(w, 2), w, INDEX)
        assert found.chance < 1e-6
        assert np.corrcoef(part_answering(free - 0.5 * np.roll(w, 2), w, INDEX), -np.roll(w, 2))[0, 1] > 0.9
        assert answering(free, w, INDEX).chance > 1e-3


def test_an_answer_is_followed_as_long_as_the_loop_rings() -> None:
    """Over 60 samples, beside a free input of the same power."""
    gains = np.sin(0.3 * np.arange(60)) * 0.95 ** np.arange(60)
    for seed in range(5):
        w, free = np.random.default_rng(seed).standard_normal((2, SAMPLES))
        answered = np.convolve(w, gains)[:SAMPLES]
        found = part_answering(free * answered.std() + answered, w, INDEX)
        assert np.corrcoef(found, answered)[0, 1] > 0.9


def test_steps_of_the_set_point_do_not_hide_an_answer() -> None:
    for seed in range(5):
        rng = np.random.default_rng(seed)
        steps, w = np.repeat(rng.standard_normal(SAMPLES // 50), 50), rng.standard_normal(SAMPLES)
        dither = 0.02 * rng.standard_normal(SAMPLES)  # of the steps a fiftieth: what the input does between them
        assert answering(steps + dither - 0.01 * w, w, INDEX).chance < 1e-6, "a hundredth of the steps"
        assert answering(steps + dither, w, INDEX).chance > 1e-3


def test_an_input_that_its_past_tells_answers_nothing() -> None:
    assert answering(np.sin(0.1 * INDEX), np.random.default_rng(4).standard_normal(SAMPLES), INDEX).chance == 1.0


def test_behind_a_lost_row_an_input_that_is_told_elsewhere_answers_nothing() -> None:
    """Three lines, which their past tells but behind a lost row; a wrong model leaves one of them."""
    lost = np.unique(np.random.default_rng(6).integers(1, 2 * SAMPLES, 30))
    place = np.delete(np.arange(2 * SAMPLES), lost)[:SAMPLES]
    u, w = np.sin(np.outer(place, [0.05, 0.11, 0.17])).sum(axis=1), np.sin(0.11 * place + 1.0)
    before = np.arange(SAMPLES) - np.maximum.accumulate(np.where(np.diff(place, prepend=-1) > 1, np.arange(SAMPLES), 0))
    assert answering(u, w, before).chance > ALPHA
    assert answering(u, w, INDEX).chance < 1e-6, "it is not known which rows are lost"


@every("seed", range(5))
def test_an_input_that_follows_another_one_answers_nothing_that_this_explains(seed: int) -> None:
    """A wrong structure leaves a part of the other input, which tells what the input will be."""
    rng = np.random.default_rng([seed, 7])
    other, w, own = rng.standard_normal((3, SAMPLES))
    follows, left = np.roll(other, 5) + 0.5 * own, w + 0.3 * np.roll(other, 2)
    assert answering(follows, left, INDEX).found
    assert answering(follows, left, INDEX, others=[other]).chance > 1e-3
    found = answering(follows - 0.3 * np.roll(w, 1), left, INDEX, others=[other])
    assert found.found
    assert found.part == pytest.approx(0.3**2 / (0.3**2 + 0.5**2), rel=0.3)
