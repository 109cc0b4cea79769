"""Kernels: the gate beside its naive twin, and the bridge."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.monitoring import outliers
from replant.numerics.linear_algebra import compose
from support.builders import DT, binary
from support.references import gate

FIXED = {"filter": rp.StateVariableFilter(cutoff=3.0), "instruments": True}


def learned(samples: int = 800, **options: Any) -> tuple[rp.Identifier, np.ndarray, np.ndarray]:
    u = binary(4, samples + 400, 8)
    y = rp.TransferFunction([2.0], [1.0, 4.0, 3.0]).simulate(u, DT)
    y += 0.03 * np.random.default_rng(2).standard_normal(u.size)
    ident = rp.Identifier(rp.Structure(2), DT, **options)
    ident.update_many(u[:samples], y[:samples])
    return ident, u[samples:], y[samples:]


@pytest.mark.parametrize("options", [{}, FIXED], ids=["with a noise model", "without one"])
def test_the_gate_is_its_naive_twin(options: dict[str, Any]) -> None:
    ident, _, _ = learned(**options)
    state, size = ident._state, ident._state.entries
    assert bool(state.has_noise_model) == (options == {})
    memory = state.memory[: size * size + size]
    covariance = compose(memory[: size * size].reshape(size, size), memory[size * size :])
    rng, found = np.random.default_rng(0), []
    for exponent in rng.uniform(-1.0, 4.0, 300):
        zeta = 10.0 ** rng.uniform(-1.0, 1.5) * rng.standard_normal(size)
        state.zeta[:] = zeta
        usual = {"spread": state.late_variance, "usual": state.usual_variance, "peak": state.largest_output}
        error = float(np.sqrt(usual["usual"]) * 10.0**exponent)
        expected, ratio = gate(usual, error, zeta, covariance, 1.0)
        state.variance_ratio = 1.0
        found.append(outliers.is_outlier(state.fields, error, True))
        assert found[-1] == expected
        assert not expected or state.variance_ratio == pytest.approx(ratio, rel=1e-9)
    assert 30 < sum(found) < 270


def test_where_an_output_is_bridged_the_filters_see_the_models() -> None:
    """One, three and then five spikes."""
    ident, u, y = learned()
    y[[50, 90, 91, 92, 150, 151, 152, 153, 154]] += 1e3
    modelled, before = np.empty(u.size), ident.samples
    ident._resolve_at = 0  # a solution in between would note its own outputs
    ident._plan()
    for k in range(u.size):
        ident.update(u[k], y[k])
        state = ident._state
        modelled[k] = state.banks[state.serving_bank, bk.MODEL_OUTPUT]
    kept = state.recent[before : before + u.size]
    np.testing.assert_array_equal(np.flatnonzero(kept[:, at.DOUBTED]), np.flatnonzero(y > 100.0))
    offset = state.output_offset
    expected = np.where(kept[:, at.DOUBTED] > 0, modelled, y - offset)
    np.testing.assert_allclose(kept[:, at.BRIDGED], expected, rtol=1e-9, atol=1e-12)
