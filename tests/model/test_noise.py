"""NoiseModel: its spectrum, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from support.cases import every


@pytest.mark.parametrize("model", [[1.0], [1.0, -0.9], [1.0, -1.6, 0.9]], ids=repr)
def test_the_integral_of_the_spectrum_is_the_variance(model: list[float]) -> None:
    """Over the frequencies in Hz up to half the sampling rate, on both sides; of white noise it is flat."""
    dt, impulse = 0.02, np.zeros(4000)
    impulse[0] = 1.0
    for k in range(4000):
        impulse[k] -= sum(d * impulse[k - i] for i, d in enumerate(model) if 0 < i <= k)
    noise = rp.NoiseModel(np.array(model), 2.0, 2.0 * float(impulse @ impulse), dt)
    frequency = (np.arange(20_000) + 0.5) / 20_000 / (2 * dt)
    integral = 2.0 * float(np.mean(noise.spectrum(2 * np.pi * frequency))) / (2 * dt)
    assert integral == pytest.approx(noise.residual_variance, rel=1e-6)
    assert noise.order == len(model) - 1
    assert noise.is_white == (len(model) == 1)


def test_its_values_cannot_be_changed_from_outside() -> None:
    given = np.array([1.0, -0.5])
    noise = rp.NoiseModel(given, 1.0, 2.0, 0.1)
    given[1] = 3.0
    assert noise.coefficients[1] == -0.5
    with pytest.raises(ValueError, match="read-only"):
        noise.coefficients[1] = 3.0


@every(
    ("changes", "named"),
    [
        ({"coefficients": [2.0, 1.0]}, "begin with 1"),
        ({"coefficients": []}, "coefficients"),
        ({"variance": -1.0}, "variance"),
        ({"residual_variance": np.nan}, "residual_variance"),
        ({"dt": 0.0}, "dt"),
    ],
)
def test_a_bad_argument_is_refused_by_name(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=named):
        rp.NoiseModel(**{"coefficients": [1.0], "variance": 1.0, "residual_variance": 1.0, "dt": 0.1, **changes})
