"""Routh's array against the roots themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from replant.kernels.filters.polynomials import all_left_of, bandwidth, slowest_decay
from support.cases import every

ORDERS = range(1, 11)


def polynomials(order: int, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Random monic polynomials, as lower coefficients, with the roots that they were made from.

    Half of them have every root on the left; the others at random, which for higher orders is hardly ever stable.
    """
    generator = np.random.default_rng(order)
    made = []
    for k in range(count):
        roots: list[complex] = []
        while len(roots) < order:
            size = 10 ** generator.uniform(-1.5, 1.5)
            angle = generator.uniform(0.5, 1.0) if k % 2 == 0 else generator.uniform(0.0, 1.0)
            if order - len(roots) >= 2 and generator.random() < 0.6:
                root = size * np.exp(1j * math.pi * angle)
                roots += [root, root.conjugate()]
            else:
                roots.append(-size if k % 2 == 0 else size * generator.choice([-1.0, 1.0]))
        made.append((np.poly(roots).real[1:], np.array(roots)))
    return made


def work(order: int) -> np.ndarray:
    return np.empty(3 * (order + 2))


@every("order", ORDERS)
def test_it_agrees_with_the_roots(order: int) -> None:
    """Wherever a root is not so close to the line that rounding decides."""
    seen = {True: 0, False: 0}
    for a, roots in polynomials(order, 300):
        rightmost = roots.real.max()
        for margin in (0.0, 0.05, 1.0, -0.5 * rightmost, -0.9 * rightmost, -1.1 * rightmost):
            if margin < 0.0 or abs(rightmost + margin) < 1e-2 * abs(roots).max():
                continue
            expected = bool(rightmost < -margin)
            assert all_left_of(a, margin, work(order)) == expected
            seen[expected] += 1
    assert min(seen.values()) > 50


@every("a", [[0.0], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0], [1.0, 4.0, 4.0], [0.0, 2.0, 0.0, 1.0]])
def test_a_root_on_the_axis_is_not_left_of_it(a: list[float]) -> None:
    assert np.roots([1.0, *a]).real.max() == pytest.approx(0.0, abs=1e-7)
    assert not all_left_of(np.array(a), 0.0, work(len(a)))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_coefficients_that_are_not_finite_are_not_stable(bad: float) -> None:
    for position in range(3):
        a = np.array([6.0, 11.0, 6.0])
        a[position] = bad
        assert not all_left_of(a, 0.0, work(3))
        assert slowest_decay(a, work(3)) == 0.0


@every("count", [40, 300], quick=1)
@every("order", ORDERS)
def test_the_slowest_decay_is_within_a_factor_of_two_from_below(order: int, count: int) -> None:
    for a, roots in polynomials(order, count):
        slowest = -roots.real.max()
        decay = slowest_decay(a, work(order))
        if slowest <= 0.0:
            assert decay == 0.0
        elif slowest > 1e-2 * abs(roots).max():
            assert 0.499 * slowest <= decay <= 1.001 * slowest


@every("damping", [0.1, 0.01, 0.001])
@every("frequency", [1e-3, 1.0, 1e4])
def test_the_slowest_decay_of_a_lightly_damped_mode(damping: float, frequency: float) -> None:
    a = np.array([2 * damping * frequency, frequency**2])
    assert 0.499 * damping * frequency <= slowest_decay(a, work(2)) <= 1.001 * damping * frequency


@every("order", ORDERS)
def test_the_bandwidth_bounds_the_largest_root_on_both_sides(order: int) -> None:
    for a, roots in polynomials(order, 100):
        largest, bound = abs(roots).max(), bandwidth(a)
        assert largest <= 2.0 * bound * (1 + 1e-9)
        assert largest >= bound / order * (1 - 1e-9)
