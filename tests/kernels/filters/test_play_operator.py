"""The play operator equals its definition, and does what backlash does."""

from __future__ import annotations

import itertools

import numpy as np

from replant.kernels.filters.autoregressions import play
from support.cases import every


@every("width", [0.0, 0.02, 0.5, 3.0])
def test_it_is_its_definition_to_the_bit(width: float) -> None:
    v = np.cumsum(np.random.default_rng(0).uniform(-0.1, 0.1, 5000))
    pushed = itertools.accumulate(v.tolist(), lambda held, at: min(max(held, at - width), at + width), initial=0.0)
    np.testing.assert_array_equal(play(v, width), list(pushed)[1:])


def test_it_follows_where_it_is_pushed_and_rests_in_between() -> None:
    v = np.array([0.0, 0.1, 0.3, 1.0, 0.9, 0.6, -1.0])
    np.testing.assert_allclose(play(v, 0.2), [0.0, 0.0, 0.1, 0.8, 0.8, 0.8, -0.8])


def test_no_signal() -> None:
    assert play(np.empty(0), 0.5).size == 0
