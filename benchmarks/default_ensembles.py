"""Speed of an ensemble of the default method beside one identifier in the same run: between its reviews, and with them.

An identifier looks into its record each 5,000 samples, and searches that for a change each 15,000, which takes as long
as tens of thousands of samples; chunks are shorter: their median tells what is between, and their sum all of it.
"""

from __future__ import annotations

import json
import time
from typing import Any

import numpy as np

import replant as rp

MEMBERS, DT, PERIOD, BEGUN = 64, 0.02, 1000, 20
PROMISED, PROMISED_THREADS = 2.5, 1.8
PLANT = rp.TransferFunction([2.0, 6.0], [1.0, 2.0, 5.0])
LEAST = 20  # chunks: of four looks, a search among them


def measure(repetitions: int = LEAST) -> dict[str, Any]:
    """Return ns a sample of a member: of one identifier, of the ensemble on one thread and on two; and ratios."""
    generator = np.random.default_rng(7)
    u = np.repeat(generator.choice([-1.0, 1.0], PERIOD // 20), 20)
    clean = PLANT.simulate(np.tile(u, 4), DT)[-PERIOD:]  # a record that goes on without a seam
    one = rp.Identifier(rp.Structure(2, 1), DT)
    for _ in range(BEGUN):
        one.update_many(u, clean + 0.1 * generator.standard_normal(PERIOD))
    pair = [rp.Ensemble(one, MEMBERS, n_jobs=jobs) for jobs in (1, 2)]
    columns, times = np.repeat(u[:, None], MEMBERS, axis=1), []
    for _ in range(max(repetitions, LEAST)):
        y = clean[:, None] + 0.1 * generator.standard_normal((PERIOD, MEMBERS))
        first = np.ascontiguousarray(y[:, 0])
        times.append([timed(one, u, first), *(timed(each, columns, y) for each in pair)])
    clock, processor = np.array(times).transpose(2, 1, 0) / PERIOD / np.array([[[1]], [[MEMBERS]], [[MEMBERS]]])[:, 0]
    usual = np.median(processor, axis=1)
    ratios = {
        "between_reviews": float(usual[0] / usual[1]),
        "with_reviews": float(processor[0].sum() / processor[1].sum()),
        "two_threads": float(np.median(clock[1] / clock[2])),
        "efficiency": float(usual[1] / usual[2]),
    }
    holds = ratios["between_reviews"] >= PROMISED and ratios["two_threads"] >= PROMISED_THREADS
    return {"members": MEMBERS, "one": float(usual[0]), "together": float(usual[1]), **ratios, "holds": holds}


def timed(taker: rp.Identifier | rp.Ensemble, u: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return how long a chunk takes, by the clock and of processor time, in ns."""
    begun = time.perf_counter_ns(), time.process_time_ns()
    taker.update_many(u, y)
    return float(time.perf_counter_ns() - begun[0]), float(time.process_time_ns() - begun[1])


if __name__ == "__main__":
    print(json.dumps(measure(), indent=2))
