"""What two inputs of one pole each cost online beside one input of two poles, of as many samples."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import replant as rp
from replant.numerics.arguments import FloatArray
from rows.known import DT, SAMPLES, coloured, steps

TWO = rp.TransferFunction([10.0], [1.0, 10.0]), rp.TransferFunction([0.5], [1.0, 0.5], delay=0.3)
ONE = rp.TransferFunction([5.0], [1.0, 10.5, 5.0], delay=0.3)
ASKED: tuple[dict[str, Any], ...] = {"poles": (1, 1), "delay": (0.0, 0.3)}, {"poles": 2, "delay": 0.3}
NOISES = {"white": 0.0, "AR(.9)": 0.9}  # poles
TURNS = 4  # of a record, of which the least time counts [count]
LIMIT = 2.4  # of the ratio of times, all records of a noise taken together


def measured(seed: int, noise: str, number: int) -> tuple[float, float]:
    """Return the processor times in s of two inputs and of one, over records with the same noise of 10 dB."""
    rng = np.random.default_rng([seed, number, 9])
    u = steps(rng, SAMPLES, 2)
    first = u[:, 0].copy()
    two, one = sum(g.simulate(each.copy(), DT) for g, each in zip(TWO, u.T, strict=True)), ONE.simulate(first, DT)
    left = coloured(rng, SAMPLES, NOISES[noise])
    left *= 10.0**-0.5 / left.std()
    records = [(u, two + left * np.std(two)), (first, one + left * np.std(one))]
    pairs = list(zip(ASKED, records, strict=True))
    times = np.array([[_taken(asked, *record) for asked, record in pairs] for _ in range(TURNS)])
    both: tuple[float, float] = tuple(times.min(axis=0).tolist())
    return both


def _taken(asked: dict[str, Any], u: FloatArray, y: FloatArray) -> float:
    identifier = rp.Identifier(**asked, dt=DT)
    begun = time.process_time()
    identifier.update_many(u, y)
    return time.process_time() - begun
