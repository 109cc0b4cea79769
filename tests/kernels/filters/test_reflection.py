"""Reflected denominators: the roots, the modulus on the imaginary axis, and what lies on the axis."""

from __future__ import annotations

import numpy as np
import pytest

from replant.kernels.filters.polynomials import reflect
from support.cases import every

ROOTS = {
    "one": [1.0],
    "complex": [0.5 + 2j, 0.5 - 2j],
    "mixed": [1.0, -2.0, -0.3 + 4j, -0.3 - 4j],
    "far apart": [1e-3, -1.0, 1e3],
    "ten": [*(-np.geomspace(0.1, 10.0, 7)), 3.0, 0.2 + 1j, 0.2 - 1j],
}


def reflected(roots: list[complex], margin: float = 0.0) -> np.ndarray:
    a = np.poly(roots).real[1:].copy()
    reflect(a, margin, np.empty(4 * a.size + 2))
    return a


@every("case", ROOTS)
def test_unstable_roots_are_mirrored_and_stable_ones_stay(case: str) -> None:
    """Coefficients: a root's rounding is eps times its condition, some thousands for ten roots."""
    roots = np.array(ROOTS[case], complex)
    expected = np.poly(-np.abs(roots.real) + 1j * roots.imag).real[1:]
    np.testing.assert_allclose(reflected(ROOTS[case]), expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@every("case", ROOTS)
def test_the_quotient_has_modulus_one_on_the_imaginary_axis(case: str) -> None:
    s = 1j * np.geomspace(1e-4, 1e4, 50)
    quotient = np.polyval(np.poly(ROOTS[case]), s) / np.polyval([1.0, *reflected(ROOTS[case])], s)
    np.testing.assert_allclose(np.abs(quotient), 1.0, rtol=1e-7)


@every("roots", [[0.0], [0.0, 0.0], [0.0, -1.0], [2j, -2j], [1e-4, -1e-4]], ids=repr)
def test_roots_on_the_axis_move_to_the_margin(roots: list[complex]) -> None:
    found = np.roots([1.0, *reflected(roots, 0.01)])
    assert found.real.max() == pytest.approx(-0.01, rel=1e-3)  # a double root is known to the root of its rounding
    np.testing.assert_allclose(np.sort(np.abs(found.imag)), np.sort(np.abs(np.imag(roots))), atol=1e-4)


@pytest.mark.parametrize("a", [[np.nan], [np.inf, 1.0], [1e300, -1e300]], ids=repr)
def test_what_has_no_roots_becomes_stable_or_nan_throughout(a: list[float]) -> None:
    found = np.array(a)
    reflect(found, 0.01, np.empty(4 * len(a) + 2))
    assert np.isnan(found).all() or (np.isfinite(found).all() and (found > 0.0).all())  # to order 2 that is stable
