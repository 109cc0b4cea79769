"""Plants with several inputs, the signals that drive them, and noise."""

from __future__ import annotations

from typing import Any

import numpy as np

import replant as rp
from replant.numerics.arguments import FloatArray

DT = 0.05
FAST, SLOW = rp.TransferFunction([20.0], [1.0, 11.0, 10.0]), rp.TransferFunction([0.2], [1.0, 0.1], delay=0.3)
TRUE = np.array([11.0, 10.0, 20.0, 0.1, 0.2])
ASKED: dict[str, Any] = {"poles": (2, 1), "delay": (0.0, 0.3)}


def toggling(seed: int, inputs: int = 2, samples: int = 4000, correlation: float = 0.0) -> FloatArray:
    """Steps of 10 samples, the inputs after the first correlated with it."""
    columns = np.random.default_rng(seed).choice([-1.0, 1.0], (samples // 10, inputs)).repeat(10, axis=0)
    columns[:, 1:] = correlation * columns[:, :1] + np.sqrt(1.0 - correlation**2) * columns[:, 1:]
    return columns


def row_of(u: FloatArray, *plant: rp.TransferFunction) -> FloatArray:
    return np.sum([g.simulate(column.copy(), DT) for g, column in zip(plant, u.T, strict=True)], axis=0)


def noisy(seed: int, x: FloatArray, pole: float = 0.0, decibels: float = 10.0) -> FloatArray:
    """Add noise with a pole, and an offset."""
    white = np.random.default_rng([seed, 1]).standard_normal(x.size + 500)
    noise = np.convolve(white, pole ** np.arange(100.0))[500 : 500 + x.size]
    return np.asarray(x + noise * x.std() / noise.std() * 10 ** (-decibels / 20.0) + 5.0)
