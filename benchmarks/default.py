"""What the noise model and a reference cost: a sample of the default with and without, in turn, in the same run."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from scipy.signal import lfilter

import replant as rp
from kernels import DT, chunks

STRUCTURE = rp.Structure(poles=3, zeros=1)
SAMPLES, BEFORE = 2000, 40_000  # of a chunk that is timed; learned before the first
WHITE, REFERENCE = 1.15, 2.0  # limits: of the noise model where the noise is white, of a reference
PLAIN = "without a noise model"

Record = tuple[np.ndarray, np.ndarray, np.ndarray | None]


def measure(repetitions: int = 101) -> dict[str, Any]:
    """Return the ratios, a row each: median and quartiles of processor times in the same turn."""
    u, y = next(chunks(STRUCTURE, BEFORE + repetitions * SAMPLES, 1))
    y_slow = y + lfilter([0.02], [1.0, -0.9], np.random.default_rng(8).standard_normal(y.size))
    r = np.concatenate([[0.0], u[:-1]]) + 0.1 * np.random.default_rng(9).standard_normal(u.size)
    records: dict[str, Record] = {
        PLAIN: (u, y, None),
        "the default, white noise": (u, y, None),
        "the default, noise with a pole at 0.9": (u, y_slow, None),
        "the default with a reference": (u, y, r),
    }
    learned = {name: rp.Identifier(STRUCTURE, DT) for name in records}
    for name, record in records.items():
        learn(learned[name], record, slice(BEFORE))
    learned[PLAIN]._state.has_noise_model = False  # the same identifier, as it would be without
    chunk = [slice(k, k + SAMPLES) for k in range(BEFORE, u.size, SAMPLES)]
    times = np.array([[learn(learned[name], record, rows) for name, record in records.items()] for rows in chunk])
    times /= SAMPLES
    besides = {"the default, white noise": PLAIN, "the default, noise with a pole at 0.9": PLAIN}
    besides["the default with a reference"] = "the default, white noise"
    names = list(records)
    rows = []
    for name, beside in besides.items():
        both = times[:, names.index(name)] / times[:, names.index(beside)]
        low, middle, high = np.percentile(both, [25, 50, 75]).tolist()
        nanoseconds = float(np.median(times[:, names.index(name)]))
        rows.append(
            {"case": name, "beside": beside, "ns": nanoseconds, "ratio": middle, "ratio_quartiles": [low, high]}
        )
    holds = rows[0]["ratio"] <= WHITE and rows[2]["ratio"] <= REFERENCE
    return {"rows": rows, "plain": float(np.median(times[:, 0])), "holds": holds}


def learn(identifier: rp.Identifier, record: Record, rows: slice) -> float:
    """Let an identifier learn rows of a record; return the processor time of the thread, in ns."""
    u, y, r = record
    begun = time.thread_time_ns()
    identifier.update_many(u[rows], y[rows], r=None if r is None else r[rows])
    return float(time.thread_time_ns() - begun)
