"""Rows with poles at 0: behind one a constant is a ramp, which is neither an offset nor a free response."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import chi2_quantile
from support.cases import every
from support.rows import DT, toggling

FIRST, SECOND, DOUBLE = ((2.0, [1.0, 0.0]), (2.0, [1.0, 1.5, 0.0]), (1.0, [1.0, 0.0, 0.0]))
STABLE = (3.0, [1.0, 2.0])


def made(pairs: Any, seed: int, load: float, samples: int = 3000) -> tuple[FloatArray, FloatArray]:
    """Return inputs about 1 and an output; the load acts at the first input."""
    u = toggling(seed, samples=samples) + 1.0
    parts = [
        rp.TransferFunction([b], a).simulate(each - 1.0 + load, dt=DT) for (b, a), each in zip(pairs, u.T, strict=True)
    ]
    noise = 0.1 * parts[1].std() * np.random.default_rng([seed, 7]).standard_normal(samples)
    return u, np.sum(parts, axis=0) + noise


@pytest.mark.slow
@every(
    "pairs, seed, load",
    [
        ((SECOND, STABLE), 1, 0.3),
        ((FIRST, STABLE), 2, 0.0),
        ((DOUBLE, STABLE), 3, 0.0),
        ((FIRST, SECOND), 4, 0.1),
    ],
    quick=1,
)
def test_they_are_found_with_the_uncertainty_that_they_have(pairs: Any, seed: int, load: float) -> None:
    u, y = made(pairs, seed, load)
    poles, true = tuple(len(a) - 1 for _, a in pairs), np.concatenate([[*a[1:], b] for b, a in pairs])
    ident = rp.Identifier(poles=poles, dt=DT)
    ident.update_many(u[:2900], y[:2900])
    assert ident.assess().status == "trusted", ident.assess()
    ident.update_many(u[2900:], y[2900:])
    ident.finish()
    for found in (ident, rp.fit(u, y, DT, poles=poles)):
        verdict = found.assess() if found is ident else found.verdict
        assert verdict.status == "trusted", verdict
        error = found.parameters - true
        assert float(error @ np.linalg.solve(found.covariance, error)) < chi2_quantile(0.9999, true.size)


def test_single_samples_and_a_chunk_give_the_same_bits() -> None:
    u, y = made((SECOND, STABLE), 1, 0.3, 900)
    chunk, single = (rp.Identifier(poles=(2, 1), dt=DT) for _ in range(2))
    chunk.update_many(u, y)
    for row, output in zip(u, y, strict=True):
        single.update(tuple(row), float(output))
    assert single.to_bytes() == chunk.to_bytes()


@pytest.mark.slow
def test_behind_a_gap_the_constant_goes_on() -> None:
    """The inputs move over a gap: what they then make is a constant at the integrator's input."""
    u, y = made((SECOND, STABLE), 5, 0.2)
    t = DT * np.arange(len(y))
    kept = np.r_[0:1500, 1600:3000]
    ident = rp.Identifier(poles=(2, 1), dt=DT)
    ident.update_many(u[kept], y[kept], t[kept])
    assert ident.assess().status == "trusted", ident.assess()
