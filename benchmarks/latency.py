"""One sample from Python: how long a call of `Identifier.update` takes, in the middle and at worst; and a verdict."""

from __future__ import annotations

import gc
import sys
import time
import tracemalloc
from typing import Any

import numpy as np

import replant as rp
from kernels import DT, REPLAY, chunks

STRUCTURE = rp.Structure(poles=3, zeros=1)
CASES: dict[str, dict[str, Any]] = {
    "the default": {},
    "AMSGrad without replay": {"optimizer": "amsgrad", "replay": None},
    "AMSGrad with a batch of 20": {"optimizer": "amsgrad", "replay": REPLAY},
}
CALLS = {"the default": 1_000_000}
FEWER_CALLS = 100_000
MEDIAN, WORST, GROWTH = 2.0, 20.0, 4096  # µs, µs at 99.9 %, bytes
KEPT, VERDICT = 10_000, 5.0  # samples that a verdict looks at; its time by that of learning as many


def measure() -> dict[str, Any]:
    """Return the figures: ``rows``, one for each case, in µs; ``growth``, in bytes over many calls; ``verdict``."""
    rows = [latency(case, choices, CALLS.get(case, FEWER_CALLS)) for case, choices in CASES.items()]
    grown, judged = growth(), verdict()
    kernel = rows[2]["kernel"]
    holds = (
        rows[0]["median"] <= MEDIAN
        and rows[1]["median"] <= MEDIAN
        and rows[2]["median"] <= MEDIAN + kernel
        and rows[0]["percentile_999"] <= WORST
        and grown <= GROWTH
        and judged["ratio"] <= VERDICT
    )
    return {"rows": rows, "growth": grown, "verdict": judged, "holds": holds}


def latency(case: str, choices: dict[str, Any], calls: int) -> dict[str, Any]:
    """Time each of many calls, the start-up and its solutions apart."""
    learned, record = 20_001, 100_000  # one record, without a joint that would be taken for a change of the plant
    u, y = next(chunks(STRUCTURE, learned + calls + record, 1))
    identifier = rp.Identifier(STRUCTURE, DT, **choices)
    identifier.update_many(u[: learned - 1], y[: learned - 1])
    samples = list(zip(u[learned - 1 : -record].tolist(), y[learned - 1 : -record].tolist(), strict=True))
    identifier.update(*samples[0])
    times = np.empty(calls)
    clock, update = time.perf_counter_ns, identifier.update
    for k, (one, other) in enumerate(samples[1:]):
        start = clock()
        update(one, other)
        times[k] = clock() - start
    begun = time.perf_counter_ns()
    identifier.update_many(u[-record:], y[-record:])
    kernel = (time.perf_counter_ns() - begun) / record
    middle, worst, maximum = np.percentile(times, [50, 99.9, 100]) / 1e3
    return {
        "case": case, "calls": calls, "median": float(middle), "percentile_999": float(worst),
        "maximum": float(maximum), "kernel": kernel / 1e3,
    }  # fmt: skip


def growth(calls: int = 100_000) -> int:
    """Return by how many bytes Python's memory grows over so many calls."""
    learned = 40_000  # every kind of look has been taken once
    u, y = (signal.tolist() for signal in next(chunks(STRUCTURE, learned + calls, 1)))
    identifier = rp.Identifier(STRUCTURE, DT)
    tracemalloc.start()
    for k in range(learned):
        identifier.update(u[k], y[k])
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    for k in range(learned, learned + calls):
        identifier.update(u[k], y[k])
    gc.collect()
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    return after - before


def verdict(repetitions: int = 21) -> dict[str, float]:
    """Return how long a verdict takes in ms, and its ratio to learning as many samples, in turn; processor times."""
    # one record: a joint would be taken for a change of the plant, and looked into
    u, y = next(chunks(STRUCTURE, (repetitions + 2) * KEPT, 1))
    identifier = rp.Identifier(STRUCTURE, DT)
    identifier.update_many(u[: 2 * KEPT], y[: 2 * KEPT])
    identifier.assess()
    times = np.empty((repetitions, 2))
    for k in range(repetitions):
        part = slice((k + 2) * KEPT, (k + 3) * KEPT)
        begun = time.thread_time_ns()
        identifier.assess()
        middle = time.thread_time_ns()
        identifier.update_many(u[part], y[part])
        times[k] = middle - begun, time.thread_time_ns() - middle
    return {"milliseconds": float(np.median(times[:, 0])) / 1e6, "ratio": float(np.median(times[:, 0] / times[:, 1]))}


if __name__ == "__main__":
    figures = measure()
    for row in figures["rows"]:
        print(row)
    print(f"grown by {figures['growth']} bytes; verdict {figures['verdict']}")
    sys.exit(int(not figures["holds"]))
