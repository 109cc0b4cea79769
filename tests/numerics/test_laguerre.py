"""Laguerre functions: orthonormal, and the pole that fits is chosen."""

from __future__ import annotations

import numpy as np

from replant.kernels.schema import LAGUERRE
from replant.numerics.projections import POLES, best_pole, explained_power, laguerre, widening
from support.cases import every


@every("pole", POLES)
def test_their_impulse_responses_are_orthonormal(pole: float) -> None:
    pulse = np.zeros(20_000)
    pulse[0] = 1.0
    responses = laguerre(pulse, pole) - laguerre(np.zeros(20_000), pole)
    # the mean of the pulse is subtracted: 1 / 20,000, over memories of up to some 2400 samples
    np.testing.assert_allclose(responses.T @ responses, np.eye(LAGUERRE), atol=0.02)


def test_the_pole_follows_the_memory_of_the_signals() -> None:
    r = np.random.default_rng(1).standard_normal(5000)
    quick, slow = (np.convolve(r, decay ** np.arange(2000))[:5000] for decay in (0.5, 0.99))
    assert best_pole(r, quick) < 0.8 < best_pole(r, slow)


def test_white_residuals_are_not_widened() -> None:
    """Beyond four standard deviations alone: of 50 records none, but for one time in 600."""
    generator = np.random.default_rng(2)
    found = [
        widening(np.linalg.qr(generator.standard_normal((1000, 12)))[0], generator.standard_normal(1000), 1.0)
        for _ in range(50)
    ]
    assert max(found) == 1.0


def test_what_functions_explain_by_chance_is_taken_off() -> None:
    """A dozen of them explain 12 of 200 parts of white noise: what is left over is what varies of it."""
    parts = []
    for seed in range(20):
        functions, signal = (np.random.default_rng([seed, k]).standard_normal((200, n)) for k, n in ((0, 12), (1, 1)))
        parts.append(explained_power(functions, signal[:, 0]) / signal.var())
    assert np.mean(parts) < 0.03
