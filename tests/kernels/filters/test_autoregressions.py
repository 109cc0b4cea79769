"""The prefilter of the recursion, beside the filter applied to a whole record; weights where the past is broken."""

from __future__ import annotations

import numpy as np

from replant.kernels.filters.autoregressions import filter_row
from replant.kernels.schema import FIXED, LAGS, NoiseSlots
from support.cases import every

T, SAMPLES = 3, 40


def noise_of(order: int, generator: np.random.Generator) -> NoiseSlots:
    noise = NoiseSlots.zeros(FIXED | {"T": T})
    noise.order, noise.filters = order, 1.0
    noise.models[:] = np.tril(generator.uniform(-1, 1, (LAGS + 1, LAGS + 1)))
    noise.models[:, 0] = 1.0
    for j in range(LAGS + 1):
        noise.models[j, j + 1 :] = 0.0
    noise.variances[:] = np.sort(generator.uniform(1, 2, LAGS + 1))[::-1]
    noise.gain = noise.variances[order] / noise.variances[0]
    return noise


@every("order", range(LAGS + 1))
def test_rows_are_those_of_the_filtered_record(order: int) -> None:
    """Row k is g D_j(q) of the rows, j the predecessors known: the past is broken before the first and the 21st row."""
    generator = np.random.default_rng(order)
    noise = noise_of(order, generator)
    rows = generator.standard_normal((SAMPLES, 2 * T + 1))
    known = 0
    for k in range(SAMPLES):
        if k == 20:
            noise.known, known = 0, 0
        phi, zeta = rows[k, :T].copy(), rows[k, T : 2 * T].copy()
        target = filter_row(T, noise.fields, phi, zeta, rows[k, 2 * T])
        lags = min(order, known)
        weight = np.sqrt(noise.variances[order] / noise.variances[lags])
        expected = weight * sum(noise.models[lags, lag] * rows[k - lag] for lag in range(lags + 1))
        np.testing.assert_allclose(np.concatenate([phi, zeta, [target]]), expected, rtol=1e-12, atol=1e-12)
        known += 1
