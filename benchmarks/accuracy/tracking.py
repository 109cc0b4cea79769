"""Scenario C: a plant whose damping and stiffness change while it is identified.

y'' + a1(t) y' + a0(t) y = b0 u with a1 from 5 to 45 in a line, a0 = 160 - 90 cos(2 pi t / 1000), b0 = 200, for
1000 s at 0.01 s; the output carries white noise of variance 0.1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from accuracy.records import Measured, random_binary
from compiled import compiled
from replant.kernels.native import Matrix, Reals, kernel
from replant.numerics.arguments import FloatArray

DT, DURATION = 0.01, 1000.0
SAMPLES = round(DURATION / DT) + 1
NOISE_VARIANCE = 0.1
STEPS = 4  # of the integration, a sample


@dataclass(frozen=True)
class Varying:
    """Makes the records; the input is random binary, held for ``hold`` samples."""

    hold: int

    def __call__(self, run: int) -> Measured:
        """Return the record of a run."""
        generator = np.random.default_rng(run)
        u = random_binary(generator, SAMPLES, self.hold)
        y = simulate(u) + math.sqrt(NOISE_VARIANCE) * generator.standard_normal(SAMPLES)
        return Measured(u, y, truth=parameters())


def parameters() -> FloatArray:
    """Return a1, a0, b0 at each sample, (K, 3)."""
    t = DT * np.arange(SAMPLES)
    a1 = 5.0 + 40.0 * t / DURATION
    a0 = 160.0 - 90.0 * np.cos(2.0 * math.pi * t / DURATION)
    return np.column_stack([a1, a0, np.full(SAMPLES, 200.0)])


def simulate(u: FloatArray) -> FloatArray:
    """Return the output (K,) for a held input, from rest, by Runge and Kutta's method of order four."""
    y = np.zeros(u.size)
    compiled(integrate)(u, y, DT / STEPS, 2.0 * math.pi / DURATION, np.empty((4, 2)))
    return y


@kernel("y.size >= u.size and rates.shape[0] >= 4 and rates.shape[1] >= 2")
def integrate(u: Reals, y: Reals, h: float, omega: float, rates: Matrix):
    x, v = 0.0, 0.0
    for k in range(u.size):
        y[k] = x
        for i in range(STEPS):
            begin = (k * STEPS + i) * h
            for stage in range(4):
                share = 0.0 if stage == 0 else 1.0 if stage == 3 else 0.5
                at_x = x + share * h * rates[stage - 1, 0] if stage > 0 else x
                at_v = v + share * h * rates[stage - 1, 1] if stage > 0 else v
                t = begin + share * h
                a1, a0 = 5.0 + 40.0 * t / DURATION, 160.0 - 90.0 * math.cos(omega * t)
                rates[stage, 0] = at_v
                rates[stage, 1] = 200.0 * u[k] - a1 * at_v - a0 * at_x
            x += h / 6.0 * (rates[0, 0] + 2.0 * rates[1, 0] + 2.0 * rates[2, 0] + rates[3, 0])
            v += h / 6.0 * (rates[0, 1] + 2.0 * rates[1, 1] + 2.0 * rates[2, 1] + rates[3, 1])
