"""The simulation kernels against powers and convolutions written out."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels.filters.simulate import filter_states, free_responses


def random_system(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(n)
    return 0.8 * generator.standard_normal((n, n)) / n, generator.standard_normal((3, n)), generator.standard_normal(12)


@pytest.mark.parametrize("n", [1, 2, 5])
@pytest.mark.parametrize("lag", [0, 1, 4, 20])
def test_states_are_the_convolution_of_taps_and_powers(n: int, lag: int) -> None:
    """w(k) = sum over i of Ad^i (taps on u[k-i-lag-2 .. k-i-lag]), the input zero and the state at rest before."""
    transition, taps, u = random_system(n)
    states = filter_states(transition, taps, lag, u)
    padded = np.concatenate([np.zeros(lag + 2), u])
    for k in range(u.size):
        expected = np.zeros(n)
        for i in range(k):
            expected += np.linalg.matrix_power(transition, i) @ (padded[k - i : k - i + 3] @ taps)
        np.testing.assert_allclose(states[k], expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_free_responses_are_the_row_times_powers(n: int) -> None:
    transition, taps, _ = random_system(n)
    responses = free_responses(transition, taps[0], 9)
    expected = [taps[0] @ np.linalg.matrix_power(transition, k) for k in range(9)]
    np.testing.assert_allclose(responses, expected, rtol=1e-12, atol=1e-14)
