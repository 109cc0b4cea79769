"""Step tests: six plants that engineers meet, what they know of them, and the records that they make."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

import replant as rp
from campaign.exact import Clock, forced, poles_apart
from replant.numerics.arguments import FloatArray

APART = 6.0  # nats
SAMPLES = (100, 500)
NOISE = (0.01, 0.03)  # standard deviation, as a part of the step
DOWN = 1 / 3  # share of the tests that step down again


@dataclass(frozen=True, eq=False)
class Case:
    """A plant, and what its engineer knows.

    Attributes
    ----------
    name : str
    plant : TransferFunction
    dt : float
        Sampling time in s.
    delays : tuple of float
        Dead times in s that the engineer lets the search try.
    """

    name: str
    plant: rp.TransferFunction
    dt: float
    delays: tuple[float, ...]

    @property
    def poles(self) -> int:
        """The plant's order."""
        return self.plant.den.size - 1


def grid(last: float, step: float) -> tuple[float, ...]:
    """Return dead times from 0 to the last, as `--delay 0:LAST:STEP` does."""
    return tuple(step * k for k in range(round(last / step) + 1))


CASES = (
    Case("oven: 12 s, dead time 3 s", rp.TransferFunction([0.8], [12.0, 1.0], 3.0), 1.0, grid(6.0, 1.0)),
    Case("motor: 0.15 s, no dead time", rp.TransferFunction([25.0], [0.15, 1.0]), 0.01, grid(0.06, 0.01)),
    Case("pipe: 2 s, dead time 5 s", rp.TransferFunction([-1.5], [2.0, 1.0], 5.0), 0.25, grid(9.0, 1.5)),
    Case(
        "heated plate: 40 and 10 s, dead time 4 s",
        rp.TransferFunction([1.2], np.polymul([40.0, 1.0], [10.0, 1.0]), 4.0), 2.0, grid(12.0, 2.0),
    ),
    Case(
        "tanks: 6 and 5 s, dead time 1.3 s",
        rp.TransferFunction([0.5], np.polymul([6.0, 1.0], [5.0, 1.0]), 1.3), 0.5, grid(3.0, 0.5),
    ),
    Case("spring: 2 rad/s, damping 0.25, dead time 0.3 s",
         rp.TransferFunction([12.0], [1.0, 1.0, 4.0], 0.3), 0.1, grid(0.6, 0.1)),
)  # fmt: skip
TEXTBOOK = CASES[0]
TEXTBOOK_SAMPLES = (100, 150, 200, 250, 300)


@dataclass(frozen=True, eq=False)
class Test:
    """The record of a step test.

    Attributes
    ----------
    u, y, clean : (K,) arrays
        From a working point; the output without noise as well.
    v : (K,) array
        The input less its working point.
    sigma : float
        Standard deviation of the noise.
    what : str
        The test in words.
    """

    u: FloatArray
    y: FloatArray
    clean: FloatArray
    v: FloatArray
    sigma: float
    what: str


def drawn(seed: int, case: int, number: int, samples: int | None = None) -> Test:
    """Return a step test; the same for the same numbers."""
    rng = np.random.default_rng([seed, case, number])
    drawn_samples = round(math.exp(rng.uniform(*np.log(SAMPLES))))
    samples = samples or drawn_samples
    k, height = np.arange(samples), float(rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 10.0))
    begin, down = round(rng.uniform(0.05, 0.15) * samples), bool(rng.random() < DOWN)
    v = np.where(k >= begin, height, 0.0)
    if down:
        v[round(rng.uniform(0.5, 0.65) * samples) :] = 0.0
    of = CASES[case]
    clean = response(of.plant, v, of.dt)
    sigma = float(rng.uniform(*NOISE) * abs(height * of.plant.dc_gain))
    u, y = v + rng.uniform(-50.0, 50.0), clean + rng.uniform(-50.0, 50.0)
    what = f"{samples} samples, noise {100.0 * sigma / abs(height * of.plant.dc_gain):.1f} %"
    what += ", up and down" if down else ""
    return Test(u, y + sigma * rng.standard_normal(samples), clean, v, sigma, what)


def response(plant: rp.TransferFunction, v: FloatArray, dt: float) -> FloatArray:
    """Return the output (K,) from rest."""
    t = np.arange(v.size) * dt
    poles = poles_apart(np.roots(plant.den))
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return np.asarray(forced(poles, plant.num.size - 1, Clock.of(t, v, plant.delay, t)) @ plant.num)


def explained(test: Test, plant: rp.TransferFunction, dt: float) -> float:
    """Return how far a model explains the output without noise, in percent."""
    left = test.clean - response(plant, test.v, dt)
    fit = 100.0 * (1.0 - float(np.linalg.norm(left) / np.linalg.norm(test.clean - test.clean.mean())))
    return max(fit, -100.0) if math.isfinite(fit) else -100.0


def nats_apart(case: Case, test: Test) -> float:
    """Return by how much in log-likelihood the best model with one pole less is expected to be behind."""
    if case.poles == 1:  # a gain with a dead time is left
        shifts = (np.concatenate([np.zeros(k), test.v[: test.v.size - k]]) for k in range(test.v.size))
        columns = (np.column_stack([shift, np.ones(shift.size)]) for shift in shifts)
        least = min(float(np.sum((test.clean - x @ np.linalg.pinv(x) @ test.clean) ** 2)) for x in columns)
        return least / (2.0 * test.sigma**2)

    def left(logs: FloatArray) -> FloatArray:
        tau, delay = np.exp(logs)
        x = np.column_stack([response(rp.TransferFunction([1.0], [tau, 1.0], delay), test.v, case.dt),
                             np.ones(test.v.size)])  # fmt: skip
        return np.asarray(test.clean - x @ np.linalg.lstsq(x, test.clean)[0])

    slowest = 1.0 / float(np.abs(np.roots(case.plant.den)).min())
    starts = [
        (part * slowest, case.plant.delay + more * slowest)
        for part in (0.3, 1.0, 1.5)
        for more in (0.02, 0.1, 0.3, 0.6)
    ]
    found = (least_squares(left, np.log(start), max_nfev=40, diff_step=1e-4) for start in starts)
    return min(2.0 * float(one.cost) for one in found) / (2.0 * test.sigma**2)
