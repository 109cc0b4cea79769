"""Two inputs, the first made by a PI controller from a reference, the second free.

The noise is white or AR(.9), or a load of a pole of .95 acts on the plant's input; its part of the output is 10 dB
below what reference and free input make.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import cont2discrete, tf2ss

import replant as rp
from replant.numerics.arguments import FloatArray
from rows.known import coloured, steps
from rows.likelihood import Estimate, likeliest_from

DT, SAMPLES, HELD = 0.1, 4000, 30
PLANT = rp.TransferFunction([1.0], [1.0, 1.4, 1.0]), rp.TransferFunction([0.1], [1.0, 0.2], delay=0.3)
STRUCTURES = rp.Structure(2), rp.Structure(1, delay=0.3)
TRUTH = np.array([1.4, 1.0, 1.0, 0.2, 0.1])
PROPORTIONAL, INTEGRAL = 2.0, 1.0  # gains of the controller, of the latter per s
#: Cases by name: the pole of the disturbance, and whether it is a load.
CASES = {"white": (0.0, False), "AR(.9)": (0.9, False), "load": (0.95, True)}
METHODS = "likelihood from the truth", "fit", "Identifier"


def closed(r: FloatArray, other: FloatArray, noise: FloatArray, load: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the controlled input and the output (K,) of a loop; ``other`` is the part of the free input."""
    a, b, c, _, _ = cont2discrete(tf2ss(PLANT[0].num, PLANT[0].den), DT)
    x, total, u, y = np.zeros(len(a)), 0.0, np.zeros(r.size), np.zeros(r.size)
    for k in range(r.size):
        y[k] = c[0] @ x + other[k] + noise[k]
        total += DT * (r[k] - y[k])
        u[k] = PROPORTIONAL * (r[k] - y[k]) + INTEGRAL * total
        x = a @ x + b[:, 0] * (u[k] + load[k])
    return u, y


def drawn(seed: int, case: str, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return inputs (K, 2), output and reference (K,) of a run; the same for the same numbers."""
    pole, is_load = CASES[case]
    rng = np.random.default_rng([seed, number, 2])
    r = np.repeat(rng.uniform(-1.0, 1.0, SAMPLES // HELD + 1), HELD)[:SAMPLES]
    free, disturbance, none = steps(rng, SAMPLES, 1)[:, 0], coloured(rng, SAMPLES, pole), np.zeros(SAMPLES)
    other = PLANT[1].simulate(free, DT)
    _, clean = closed(r, other, none, none)
    reached = closed(none, none, none, disturbance)[1] if is_load else disturbance
    disturbance = disturbance * clean.std() / reached.std() * 10.0**-0.5
    u, y = closed(r, other, none if is_load else disturbance, disturbance if is_load else none)
    return np.column_stack([u, free]), y, r


def carry_out(seed: int, task: tuple[str, int]) -> list[Estimate]:
    """Return the estimates of `METHODS` of one run."""
    u, y, r = drawn(seed, *task)
    asked = {"poles": (2, 1), "delay": (0.0, 0.3)}
    fitted = rp.fit(u, y, DT, **asked, reference=r)
    online = rp.Identifier(**asked, dt=DT)
    online.update_many(u, y, r=r)
    return [
        likeliest_from(TRUTH, STRUCTURES, u, y, DT),
        Estimate(fitted.parameters, fitted.covariance, fitted.verdict.status),
        Estimate(online.parameters, online.covariance, online.assess().status),
    ]
