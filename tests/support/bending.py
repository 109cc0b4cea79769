"""Plants that are not linear, integrated by the method of Runge and Kutta in steps far below the sampling time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

STEPS = 20  # in a sampling time


def integrated(rate: Callable[[np.ndarray, float], np.ndarray], order: int, u: np.ndarray, dt: float) -> np.ndarray:
    """The states (K, order) of x' = rate(x, u) from rest, the input held."""
    states, x, h = np.empty((u.size, order)), np.zeros(order), dt / STEPS
    for k, now in enumerate(u):
        states[k] = x
        for _ in range(STEPS):
            first = rate(x, now)
            second = rate(x + 0.5 * h * first, now)
            third = rate(x + 0.5 * h * second, now)
            x = x + h / 6.0 * (first + 2.0 * (second + third) + rate(x + h * third, now))
    return states


def lagging(u: np.ndarray, dt: float, bend: Callable[[float], float]) -> np.ndarray:
    """The output of (1 + bend(y)) y' = u - y."""
    return integrated(lambda x, now: (now - x) / (1.0 + bend(float(x[0]))), 1, u, dt)[:, 0]


def turning(u: np.ndarray, dt: float, up: float, down: float) -> np.ndarray:
    """The output of y' = rate (u - y), which is another rate on the way up than on the way down."""
    return integrated(lambda x, now: (up if now > x[0] else down) * (now - x), 1, u, dt)[:, 0]


def damped(u: np.ndarray, dt: float, bend: Callable[[float], float]) -> np.ndarray:
    """The output of y'' + (1 + bend(y)) y' + y = u."""

    def rate(x: np.ndarray, now: float) -> np.ndarray:
        return np.array([x[1], now - x[0] - (1.0 + bend(float(x[0]))) * x[1]])

    return integrated(rate, 2, u, dt)[:, 0]


def rubbing(u: np.ndarray, dt: float, spring: float, force: float) -> np.ndarray:
    """The output of y'' + y' + spring y = u - force sign(y'): within a step friction stops the motion, and no more."""
    position, speed, h, output = 0.0, 0.0, dt / STEPS, np.empty(u.size)
    for k, now in enumerate(u):
        output[k] = position
        for _ in range(STEPS):
            free = speed + h * (now - speed - spring * position)
            speed = float(np.sign(free)) * max(abs(free) - h * force, 0.0)
            position += h * speed
    return output
