"""Plants under a controller: records of input, output and reference."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.signal import cont2discrete, lfilter, tf2ss

import replant as rp

DT = 0.1


def closed_loop(
    numerator: list[float], denominator: list[float], gains: tuple[float, float], dt: float, r: np.ndarray,
    load: np.ndarray, noise: np.ndarray, factors: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Input and output of u = kp (r - y) + ki times its integral, y = G (factor u + load) + noise; u is held.

    The output is read before the input is set, so that the loop has a delay of one sample.
    """
    A, B, C, _, _ = cont2discrete(tf2ss(numerator, denominator), dt, "zoh")
    x, integral = np.zeros(len(A)), 0.0
    u, y = np.empty(r.size), np.empty(r.size)
    factors = np.ones(r.size) if factors is None else factors
    for k in range(r.size):
        y[k] = float(C[0] @ x) + noise[k]
        error = r[k] - y[k]
        u[k] = gains[0] * error + gains[1] * integral
        integral += dt * error
        x = A @ x + B[:, 0] * (factors[k] * u[k] + load[k])
    return u, y


def loaded_loop(
    samples: int, seed: int = 0, *, load: float = 0.05, sensor: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """1/(s^2 + 1.4 s + 1) under a PI controller and a load that wanders: input, output and reference.

    The load is an autoregression of coefficient 0.95 with innovations of this size, the sensor's noise is white.
    """
    generator = np.random.default_rng(seed)
    r = np.repeat(generator.uniform(-1, 1, samples // 30 + 1), 30)[:samples]
    wandering = load * lfilter([1.0], [1.0, -0.95], generator.standard_normal(samples))
    noise = sensor * generator.standard_normal(samples)
    u, y = closed_loop([1.0], [1.0, 1.4, 1.0], (2.0, 1.0), DT, r, wandering, noise)
    return u, y, r


class Loop(NamedTuple):
    """A record of a loop: input, output and reference."""

    u: np.ndarray
    y: np.ndarray
    r: np.ndarray


def controlled(
    plant: rp.TransferFunction, r: np.ndarray, noise: np.ndarray, *, gain: float, integral: float = 0.0
) -> Loop:
    """A plant under a proportional or PI controller, with noise of its output."""
    u, y = closed_loop(list(plant.num), list(plant.den), (gain, integral), DT, r, np.zeros(r.size), noise)
    return Loop(u, y, r)


def coloured(seed: int, samples: int, colour: float) -> np.ndarray:
    """Noise of standard deviation one, an autoregression of order one."""
    made = lfilter([1.0], [1.0, -colour], np.random.default_rng([seed, 5]).standard_normal(samples + 500))[500:]
    return np.asarray(made * np.sqrt(1.0 - colour**2))


def steps(seed: int, samples: int, hold: int = 20) -> np.ndarray:
    """A reference: uniform in (-1, 1), each value held."""
    return np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, -(-samples // hold)), hold)[:samples]
