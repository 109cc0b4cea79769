"""Compiles the large kernels before the tests begin: else every worker of pytest-xdist would compile them by itself.

    python tests/support/compiling.py refined|first-order

The two halves take about equally long, for two cores.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np

import replant as rp

DT = 0.1


def refined() -> None:
    """The default: refined instrumental variables, in chunks and sample by sample; and a fit."""
    u, y = record()
    default = rp.Identifier(rp.Structure(2), DT)
    default.update_many(u, y)
    default.update(u[0], y[0])
    default.assess()
    rp.fit(u, y, DT, poles=2)


def first_order() -> None:
    """Optimizers of the first order, and least squares on a fixed filter."""
    u, y = record()
    fixed = rp.StateVariableFilter(2.0)
    gradient, buffer = rp.Gradient(1e-3), rp.Replay(capacity=100, batch_size=5)
    for optimizer, replay in ((gradient, None), (gradient, buffer), (rp.RecursiveLeastSquares(), None)):
        ident = rp.Identifier(rp.Structure(2), DT, filter=fixed, optimizer=optimizer, replay=replay)
        ident.update_many(u, y)
        ident.update(u[0], y[0])


def record() -> tuple[np.ndarray, np.ndarray]:
    """Input and output of a plant of two poles."""
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 120), 10)
    y = rp.TransferFunction([1.0], [1.0, 1.0, 1.0]).simulate(u, DT)
    return u, y + 0.01 * np.random.default_rng(1).standard_normal(y.size)


HALVES: dict[str, Callable[[], None]] = {"refined": refined, "first-order": first_order}

if __name__ == "__main__":
    HALVES[sys.argv[1]]()
