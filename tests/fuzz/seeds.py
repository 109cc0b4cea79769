"""The checkpoints that mutants are made of: identifiers of every kind, started and not, with and without a stream."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import replant as rp

DT = 0.1
FIXED: dict[str, Any] = {"filter": rp.StateVariableFilter(3.0)}
AT_ONCE: dict[str, Any] = {**FIXED, "scaling": None, "instruments": False}
REPLAY = rp.Replay(capacity=20, batch_size=3, warmup=4, seed=7)

KINDS: dict[str, dict[str, Any]] = {
    "default": {},
    "bias": {"structure": rp.Structure(1, bias=True), "preprocess": rp.Preprocess("square", "first", "first")},
    "dead time": {"structure": rp.Structure(1, delay=0.237)},
    "feedthrough": {"structure": rp.Structure(1, 1, feedthrough=True)},
    "kalman": {"optimizer": rp.KalmanTracking([0.1, 0.2])},
    "forgetting": {"optimizer": rp.RecursiveLeastSquares(time_constant=20.0)},
    "fixed filter": {**AT_ONCE, "optimizer": rp.Gradient(2.0), "replay": None},
    "gradient, replay": {**AT_ONCE, "optimizer": rp.AMSGrad(1e-3), "replay": REPLAY},
    "dead time, replay": {**AT_ONCE, "structure": rp.Structure(1, delay=0.31), "optimizer": "adam", "replay": REPLAY},
    "integral cost": {**AT_ONCE, "optimizer": "integral-cost", "replay": REPLAY},
    "denominator": {
        **AT_ONCE,
        "structure": rp.Structure(2, 1),
        "filter": rp.StateVariableFilter(denominator=[1, 5, 6]),
        "optimizer": "rmsprop",
        "scaling": rp.Scaling(2.0, [1, 2, 3, 4]),
        "replay": REPLAY,
    },
    "gbt": {**AT_ONCE, "filter": rp.StateVariableFilter(3.0, method="gbt", alpha=0.7), "optimizer": "nadam"},
    "reference": {},
    "instruments": {**FIXED, "optimizer": rp.Adam(1e-3), "instruments": True, "replay": REPLAY},
}
LENGTHS = (0, 7, 60)  # samples: not begun, some held back or taken, well under way
IRREGULAR = ("default", "kalman", "dead time, replay", "reference")


def record(samples: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Input, output of a plant of the first order with noise, and stamps of a clock that jitters."""
    generator = np.random.default_rng(0)
    u = np.repeat(generator.choice([-1.0, 1.0], -(-samples // 4)), 4)[:samples]
    y = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(u, DT) + 0.01 * generator.standard_normal(samples)
    return u, y, np.cumsum(DT * generator.uniform(0.9, 1.1, samples))


def reference(samples: int) -> np.ndarray:
    """A reference."""
    return np.random.default_rng(1).standard_normal(samples)


@cache
def seed(kind: str, samples: int, irregular: bool) -> bytes:
    """Bytes of one of them."""
    changes = {"startup": 30, **KINDS[kind]}
    ident = rp.Identifier(changes.pop("structure", rp.Structure(1)), DT, **changes)
    u, y, t = record(samples)
    if samples:
        ident.update_many(u, y, t if irregular else None, reference(samples) if kind == "reference" else None)
    return ident.to_bytes({"taken": samples, "at": 0.1 * samples, "offset": 0.0, "counter lost": 2})


def seeds() -> list[tuple[str, int, bool]]:
    """All of them, by what `seed` takes."""
    regular = [(kind, samples, False) for kind in KINDS for samples in LENGTHS]
    return regular + [(kind, samples, True) for kind in IRREGULAR for samples in LENGTHS[1:]]
