"""Plants under a controller: records of input, output and reference."""

from __future__ import annotations

import numpy as np
from scipy.signal import cont2discrete, lfilter, tf2ss

DT = 0.1


def closed_loop(
    numerator: list[float], denominator: list[float], gains: tuple[float, float], dt: float, r: np.ndarray,
    load: np.ndarray, noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Input and output of u = kp (r - y) + ki times its integral, y = G (u + load) + noise; u is held.

    The output is read before the input is set, so that the loop has a delay of one sample.
    """
    A, B, C, _, _ = cont2discrete(tf2ss(numerator, denominator), dt, "zoh")
    x, integral = np.zeros(len(A)), 0.0
    u, y = np.empty(r.size), np.empty(r.size)
    for k in range(r.size):
        y[k] = float(C[0] @ x) + noise[k]
        error = r[k] - y[k]
        u[k] = gains[0] * error + gains[1] * integral
        integral += dt * error
        x = A @ x + B[:, 0] * (u[k] + load[k])
    return u, y


def loaded_loop(samples: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """1/(s^2 + 1.4 s + 1) under a PI controller and a load that wanders: input, output and reference."""
    generator = np.random.default_rng(seed)
    r = np.repeat(generator.uniform(-1, 1, samples // 30 + 1), 30)[:samples]
    load = 0.05 * lfilter([1.0], [1.0, -0.95], generator.standard_normal(samples))
    u, y = closed_loop([1.0], [1.0, 1.4, 1.0], (2.0, 1.0), DT, r, load, np.zeros(samples))
    return u, y, r
