"""Where single outputs are missing, slow noise is no disturbance with the input's period, and no fault of the model."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from support.cases import every
from support.loops import coloured


@pytest.mark.slow
@every("seed", [0, 2, 3, 4], quick=1)
def test_slow_noise_behind_holes_is_not_taken_for_what_the_input_explains(seed: int) -> None:
    """An integrator after one step: behind each hole the noise is on the level that it had before."""
    u = np.repeat([0.0, 1.0], [200, 1800])
    y = rp.TransferFunction([1.0], [1.0, 0.0]).simulate(u, 0.1) + 9.0 * coloured(seed, u.size, 0.99)
    y[np.random.default_rng(seed).random(y.size) < 0.1] = np.nan
    verdict = rp.fit(u, y, 0.1, poles=1).verdict
    assert verdict.status in ("trusted", "converging"), verdict.reasons
    for words in ("the input's period", "the input could explain", "acts otherwise at other levels"):
        assert not any(words in reason for reason in verdict.reasons), verdict.reasons
