"""A loop at 1 kHz: how long after a sample is due `Identifier.update` returns, beside a loop that does nothing.

The loop asks the clock until a sample is due, so that no sleep is part of the times.  The plant changes three times.
What the loop that does nothing loses, the machine loses: it runs something else.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import replant as rp

DT = 1e-3  # s
SECONDS = 60.0
BEFORE = 3000  # samples that start-up takes beforehand, more than enough
LIMIT = 100.0  # µs, of 99.9 % of the updates with ``background``
PLANTS = [rp.TransferFunction([gain], [1.0, 14.0, 100.0]) for gain in (100.0, 150.0, 100.0, 60.0)]


def measure(seconds: float = SECONDS) -> dict[str, Any]:
    """Return the figures: ``rows``, one for each loop, in µs."""
    u, y = record(BEFORE + round(seconds / DT))
    rows = [loop("nothing", lambda *_: None, u, y)]
    for background in (False, True):
        identifier = rp.Identifier(rp.Structure(2, 0), DT, background=background)
        identifier.update_many(u[:BEFORE], y[:BEFORE])
        before = identifier.forced_waits  # as the start-up came faster than at 1 kHz
        row = loop("with background" if background else "without background", identifier.update, u, y)
        rows.append(row | {"forced_waits": identifier.forced_waits - before})
    allowed = max(LIMIT, rows[0]["percentile_999"])  # the machine's own
    return {"rows": rows, "seconds": seconds, "limit": LIMIT, "holds": rows[-1]["percentile_999"] <= allowed}


def record(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return input and output of a plant that changes three times, with noise."""
    generator = np.random.default_rng(1)
    u = np.repeat(generator.choice([-1.0, 1.0], samples // 100 + 1), 100)[:samples]
    parts = np.array_split(np.arange(samples), len(PLANTS))
    clean = [plant.simulate(u, DT)[part] for plant, part in zip(PLANTS, parts, strict=True)]
    return u, np.concatenate(clean) + 0.02 * generator.standard_normal(samples)


def loop(case: str, update: Callable[[float, float], Any], u: np.ndarray, y: np.ndarray) -> dict[str, Any]:
    """Give the samples when they are due; return how late each call had returned."""
    samples = list(zip(u[BEFORE:].tolist(), y[BEFORE:].tolist(), strict=True))
    late, clock, period = np.empty(len(samples)), time.perf_counter_ns, round(DT * 1e9)
    gc.collect()
    gc.disable()
    begun = clock() + period
    for k, (one, other) in enumerate(samples):
        due = begun + k * period
        while clock() < due:
            pass
        update(one, other)
        late[k] = clock() - due
    gc.enable()
    late /= 1e3
    return {
        "case": case, "calls": len(late), "median": float(np.median(late)),
        "percentile_999": float(np.percentile(late, 99.9)), "longest": float(late.max()),
        "beyond": int(np.count_nonzero(late > LIMIT)),
    }  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    print(json.dumps(measure(parser.parse_args().seconds), indent=2))
