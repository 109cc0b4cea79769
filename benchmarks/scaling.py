"""How cost grows with the number of parameters, the order, the batch and the buffer, beside what the arithmetic says.

Each cost is the median time of the kernel over sizes where the arithmetic outweighs what every call costs; its
exponent is the slope of a straight line through log cost over log size.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

import replant as rp
from compiled import compiled
from kernels import DT, ROUNDS
from replant.estimation.engine.vector_blocks import aligned
from replant.kernels.native import IntMatrix, Matrix, Reals, kernel
from replant.kernels.optimizers import covariance, gradient

REPETITIONS = 42
WITHIN = 0.1

Once = Callable[[], None]


@dataclass(frozen=True)
class Scaling:
    """Cost of one kernel over one size."""

    what: str
    size: str
    sizes: list[int]
    nanoseconds: list[float]
    exponent: float
    expected: float

    @property
    def holds(self) -> bool:
        """Whether it grows as it should."""
        return abs(self.exponent - self.expected) <= WITHIN


@kernel()
def learn(
    algorithm: int, theta: Reals, memory: Reals, settings: Reals, buffer: Matrix, rows: IntMatrix, samples: int,
    batch: int,
):  # fmt: skip
    """``samples`` times a batch."""
    for k in range(samples):
        gradient.learn(algorithm, theta, memory, settings, buffer, rows[k], batch, 0, 0.0)


@kernel()
def least_squares(theta: Reals, memory: Reals, settings: Reals, buffer: Matrix, rows: IntMatrix, samples: int):
    for k in range(samples):
        covariance.recursive_least_squares(theta, memory, settings, buffer, rows[k], 1, 0)


@kernel()
def kalman(theta: Reals, memory: Reals, settings: Reals, buffer: Matrix, rows: IntMatrix, samples: int):
    for k in range(samples):
        covariance.kalman_tracking(theta, memory, settings, buffer, rows[k], 1, 0, 1e-3)


def problem(P: int, capacity: int, samples: int, batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a buffer of rows and which of them are drawn."""
    generator = np.random.default_rng(5)
    buffer = np.ones((capacity, P + 2))
    buffer[:, :P] = generator.standard_normal((capacity, P)) / np.sqrt(P)
    # noise: without it errors end as numbers so small that products of them take processors far longer
    buffer[:, P] = buffer[:, :P].sum(axis=1) + 0.1 * generator.standard_normal(capacity)
    return buffer, generator.integers(0, capacity, (samples, batch))


def one_after_the_other(*arrays: np.ndarray) -> list[np.ndarray]:
    """Lay the arrays as an identifier's state does, from the beginning of a line of the cache on."""
    together = aligned((sum(array.size for array in arrays),))
    together[:] = np.concatenate(arrays)
    return np.split(together, np.cumsum([array.size for array in arrays[:-1]]))


def gradient_family(optimizer: Any, P: int, capacity: int = 20, batch: int = 20, samples: int = 200) -> Once:
    buffer, rows = problem(P, capacity, samples, batch)
    theta, memory = one_after_the_other(np.zeros(P), optimizer.memory(P))
    settings = optimizer.settings(DT, np.ones(P))
    return lambda: compiled(learn)(optimizer.code, theta, memory, settings, buffer, rows, samples, batch)


def second_family(optimizer: Any, P: int, samples: int = 200) -> Once:
    buffer, rows = problem(P, 20, samples, 1)
    theta, memory, settings = np.zeros(P), optimizer.memory(P), optimizer.settings(DT, np.ones(P))
    call = compiled(kalman if isinstance(optimizer, rp.KalmanTracking) else least_squares)
    return lambda: call(theta, memory, settings, buffer, rows, samples)


def cases() -> Iterator[tuple[str, str, float, dict[int, Once], int]]:
    """Name, size, expected exponent, what is timed for each size, and updates in one go."""
    adam, least, tracking = rp.Adam(1e-3), rp.RecursiveLeastSquares(), rp.KalmanTracking(1e-3)
    # numbers that lie whole pages apart wait for each other, and share few lines of the cache: of these sizes theta and
    # the memory's parts lie a quarter of a page apart, and more or less
    wide = (640, 1152, 2176)
    yield "Gradient", "parameters", 1, {P: gradient_family(rp.Gradient(1.0), P) for P in wide}, 4000
    yield "Adam", "parameters", 1, {P: gradient_family(adam, P) for P in wide}, 4000
    yield "AMSGrad", "parameters", 1, {P: gradient_family(rp.AMSGrad(1e-3), P) for P in wide}, 4000
    integral = rp.IntegralCost(1.0, 0.1)
    yield "IntegralCost", "parameters", 2, {P: gradient_family(integral, P) for P in (20, 44, 92, 188)}, 4000
    yield "least squares", "parameters", 2, {P: second_family(least, P) for P in (30, 60, 120)}, 200
    # sizes whose matrices lie in the second cache alike
    yield "Kalman tracking", "parameters", 3, {P: second_family(tracking, P, 40) for P in (76, 100, 132)}, 40
    batches = (5, 20, 80, 320)
    yield "Adam", "batch", 1, {B: gradient_family(adam, 6, batch=B) for B in batches}, 200
    # a buffer of 10^5 rows of 64 bytes lies in the second cache; beyond, memory's latency adds to the arithmetic
    sizes = (100, 1000, 10_000)
    yield "Adam", "buffer", 0, {C: gradient_family(adam, 6, capacity=C) for C in sizes}, 4000


def time_in_turn(timed: dict[int, Once], updates: int) -> dict[int, list[float]]:
    """Return for each size the ns an update, time after time: what else the machine does falls on all alike."""
    times: dict[int, list[float]] = {number: [] for number in timed}
    for _ in range(REPETITIONS // ROUNDS):
        for number, once in timed.items():
            begun = time.thread_time_ns()
            once()
            times[number].append((time.thread_time_ns() - begun) / updates)
    return times


def measure() -> dict[str, Any]:
    """Return the figures: ``rows``, one for each kernel and size."""
    found: dict[tuple[str, str, float], list[dict[int, list[float]]]] = {}
    for _ in range(ROUNDS):
        for *case, timed, updates in cases():
            found.setdefault(tuple(case), []).append(time_in_turn(timed, updates))
    results = []
    for (what, size, expected), rounds in found.items():
        sizes = list(rounds[0])
        cost = [float(np.median([each[number] for each in rounds])) for number in sizes]
        exponent = float(np.polyfit(np.log(sizes), np.log(cost), 1)[0])
        results.append(Scaling(what, size, sizes, cost, exponent, expected))
    return {"rows": [asdict(result) for result in results], "holds": all(result.holds for result in results)}


if __name__ == "__main__":
    figures = measure()
    for row in figures["rows"]:
        print(row)
    sys.exit(int(not figures["holds"]))
