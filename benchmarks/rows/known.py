"""Two known inputs in open loop: poles {1, 10} and {.1}, the second behind a dead time, 10 dB.

The noise is white or AR(.9), the inputs are uncorrelated or correlated by .9.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

import replant as rp
from replant.numerics.arguments import FloatArray
from rows.likelihood import Estimate, likeliest_from

DT, SAMPLES, HELD = 0.05, 4000, 10
PLANT = rp.TransferFunction([20.0], [1.0, 11.0, 10.0]), rp.TransferFunction([0.2], [1.0, 0.1], delay=0.3)
STRUCTURES = rp.Structure(2), rp.Structure(1, delay=0.3)
TRUTH = np.array([11.0, 10.0, 20.0, 0.1, 0.2])
#: Cases by name: the pole of the noise, the correlation of the inputs.
CASES = {
    "white": (0.0, 0.0),
    "white, inputs correlated .9": (0.0, 0.9),
    "AR(.9)": (0.9, 0.0),
    "AR(.9), inputs correlated .9": (0.9, 0.9),
}
METHODS = "likelihood from the truth", "fit", "Identifier"


def drawn(seed: int, case: str, number: int) -> tuple[FloatArray, FloatArray]:
    """Return the inputs (K, 2) and the output (K,) of a run; the same for the same numbers."""
    pole, correlation = CASES[case]
    rng = np.random.default_rng([seed, number])
    u = steps(rng, SAMPLES, 2)
    u[:, 1] = correlation * u[:, 0] + np.sqrt(1.0 - correlation**2) * u[:, 1]
    x = np.sum([g.simulate(column.copy(), DT) for g, column in zip(PLANT, u.T, strict=True)], axis=0)
    noise = coloured(rng, SAMPLES, pole)
    return u, x + noise * x.std() / noise.std() * 10.0**-0.5 + 5.0


def steps(rng: np.random.Generator, samples: int, inputs: int) -> FloatArray:
    """Return random inputs of +-1 (K, q), each held for `HELD` samples."""
    columns = rng.choice([-1.0, 1.0], (samples // HELD + 1, inputs))
    return np.ascontiguousarray(np.repeat(columns, HELD, axis=0)[:samples])


def coloured(rng: np.random.Generator, samples: int, pole: float) -> FloatArray:
    """Return noise (K,) with one pole, in its steady state."""
    return np.asarray(lfilter([1.0], [1.0, -pole], rng.standard_normal(samples + 500)))[500:]


def carry_out(seed: int, task: tuple[str, int]) -> list[Estimate]:
    """Return the estimates of `METHODS` of one run."""
    u, y = drawn(seed, *task)
    fitted = rp.fit(u, y, DT, poles=(2, 1), delay=(0.0, 0.3))
    online = rp.Identifier(poles=(2, 1), delay=(0.0, 0.3), dt=DT)
    online.update_many(u, y)
    return [
        likeliest_from(TRUTH, STRUCTURES, u, y, DT),
        Estimate(fitted.parameters, fitted.covariance, fitted.verdict.status),
        Estimate(online.parameters, online.covariance, online.assess().status),
    ]
