"""The projection on a reference: Laguerre functions beside their transfer functions, weights beside least squares."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from replant.kernels.filters.reference import SIZE, carry_on
from replant.kernels.schema import FIXED, LAGUERRE, ReferenceSlots
from support.cases import every


def reference_of(pole: float, origin: float = 0.0) -> ReferenceSlots:
    reference = ReferenceSlots.zeros(FIXED | {"L": SIZE})
    reference.pole, reference.origin = pole, origin
    reference.states[-1] = 1.0
    return reference


def functions(pole: float, r: np.ndarray) -> np.ndarray:
    reference, states = reference_of(pole), np.empty((r.size, SIZE))
    for k in range(r.size):
        carry_on(reference.states, reference.pole, r[k] - reference.origin)
        states[k] = reference.states
    return states


@every("pole", [0.0, 0.2, 0.9, 0.99])
def test_the_functions_are_those_of_laguerre(pole: float) -> None:
    r = np.random.default_rng(0).standard_normal(500)
    states, signal = functions(pole, r), lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], r)
    for i in range(LAGUERRE):
        np.testing.assert_allclose(states[:, i], signal, atol=1e-9)
        signal = lfilter([-pole, 1.0], [1.0, -pole], signal)
    np.testing.assert_array_equal(states[:, LAGUERRE], 1.0)


def test_they_are_orthonormal() -> None:
    """Their impulse responses are: sums of products are 1 and 0."""
    impulse = np.zeros(4000)
    impulse[0] = 1.0
    states = functions(0.9, impulse)[:, :LAGUERRE]
    np.testing.assert_allclose(states.T @ states, np.eye(LAGUERRE), atol=1e-9)
