"""A plant with two inputs, of which a controller makes one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.signal import cont2discrete, lfilter, tf2ss

import replant as rp
from replant.numerics.arguments import FloatArray

DT, SAMPLES = 0.1, 3000
PLANT = rp.TransferFunction([1.0], [1.0, 1.4, 1.0]), rp.TransferFunction([0.1], [1.0, 0.2], delay=0.3)
TRUE = np.array([1.4, 1.0, 1.0, 0.2, 0.1])
ASKED: dict[str, Any] = {"poles": (2, 1), "delay": (0.0, 0.3)}


def looped(
    seed: int, *, load: bool = False, pole: float = 0.0, samples: int = SAMPLES, snr: float = 10.0,
    act: Callable[[float, int], float] = lambda u, k: u, sense: Callable[[float], float] = lambda y: y,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Inputs (K, 2), output and reference of a loop u1 = 2 (r - y) + integral of it, u2 free; disturbed by ``snr`` dB.

    The actuator makes ``act`` of u1 at sample k, the sensor ``sense`` of the output.
    """
    rng = np.random.default_rng(seed)
    r = rng.uniform(-1.0, 1.0, samples // 30 + 1).repeat(30)[:samples]
    free = rng.choice([-1.0, 1.0], samples // 10 + 1).repeat(10)[:samples]
    noise = lfilter([1.0], [1.0, -pole], rng.standard_normal(samples + 500))[500:]
    a, b, c, _, _ = cont2discrete(tf2ss(PLANT[0].num, PLANT[0].den), DT)

    def closed(r: FloatArray, other: FloatArray, noise: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, total, u, y = np.zeros(len(a)), 0.0, np.zeros(samples), np.zeros(samples)
        for k in range(samples):
            y[k] = sense(float(c[0] @ x) + other[k] + noise[k] * (not load))
            total += DT * (r[k] - y[k])
            u[k] = 2.0 * (r[k] - y[k]) + total
            x = a @ x + b[:, 0] * (act(float(u[k]), k) + noise[k] * load)
        return u, y

    other, none = PLANT[1].simulate(free, DT), np.zeros(samples)
    clean, alone = closed(r, other, none)[1], closed(none, none, noise)[1] if load else noise
    u, y = closed(r, other, noise * clean.std() / alone.std() * 10 ** (-snr / 20.0))
    return np.column_stack([u, free]), y, r


def distance(found: Any) -> float:
    error = found.parameters - TRUE
    return float(error @ np.linalg.solve(found.covariance, error))
