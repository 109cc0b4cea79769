r"""Shared roots: a pole that a zero may cancel, one at infinity too, so that the data do not tell the coefficients.

Where A and B share a root p, G(s) is that of fewer poles and zeros, times (s - p)/(s - p): p may be any number, and the
coefficients with it.  The covariance of an estimate whose pole and zero nearly cancel says how well they are known
near the place where chance has put them; only an unbounded interval holds the true coefficients as often as it says.
What G(s) does where the input excites it, and its other poles, are not affected.

Both A and B are linear in the coefficients theta, so that a root p shared is a linear constraint C theta = c:

.. math:: F(p) = \frac{1}{q}\, g^T (C P C^T)^{-1} g, \qquad g = [A(p), B(p)]

with P the covariance of theta, and q the number of constraints: two of a real p, four of a complex pair.  The smallest
F over all p says how surely no root is shared.

Source: Dufour (1997), "Some impossibility theorems in econometrics with applications to structural and dynamic models",
Econometrica 65; Staiger and Stock (1997), "Instrumental variables regression with weak instruments", Econometrica 65.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from replant.model.structure import Structure
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import quiet, roots

# the rule of Staiger and Stock for weak instruments; of 600 fits with one or two poles and zeros too many it was
# exceeded by none; of 992 estimates of random plants 131 had a coefficient over three standard deviations off, 103 of
# them among the 156 below it
WEAK = 10.0  # smallest F up to which first-order intervals are not valid: a root may be shared [ratio of variances]

UNKNOWN = 2.0  # distance from zero within which a coefficient has no size: its 95 % interval [standard deviations]

# so far away it is slower than any record, or faster than its sampling
REACH = 1e3  # how far a real root is looked for beyond the slowest and the fastest pole [ratio of magnitudes]

# 17 a decade over the eight decades of plants whose poles span two; F changes over a factor of about two
REAL = 200  # real roots looked at, of each sign, evenly spaced in the logarithm [count]

# F changes along the way as the square of the distance
STEPS = 10  # steps from a pole to a zero, at each of which a root is looked for [count]

NEAR = 3  # zeros to which one goes from each pole, the nearest ones, as these cancel it [count]

# 4e5 times the precision of float64
ROUNDING = 1e-10  # eigenvalue of the constraints' correlations below which rounding decides [ratio]


@quiet
def cancelled_pole(structure: Structure, parameters: FloatArray, covariance: FloatArray) -> complex | None:
    """Return the pole that a zero may cancel: nearest to the root that A and B most likely share; None without one."""
    size = structure.coefficients
    known = covariance[:size, :size]
    if structure.zeros == 0 or not np.isfinite(known).all() or not np.isfinite(parameters[:size]).all():
        return None
    a = np.concatenate([[1.0], parameters[structure.denominator]])
    b = parameters[structure.numerator]
    poles, zeros = roots(a), roots(b)
    best, least = None, WEAK
    pairs = [_pairs(poles, zeros)] if structure.zeros > 1 else []  # one zero cancels no pair
    for candidates in (_real(poles, zeros), *pairs):
        found = _statistics(candidates, a, b, known)
        if found.min(initial=np.inf) < least:
            best, least = complex(candidates[found.argmin()]), float(found.min())
    if best is None:
        return None
    nearest = complex(poles[np.abs(poles - best).argmin()])
    return complex(nearest.real, abs(nearest.imag))


@quiet
def untold_pole(structure: Structure, parameters: FloatArray, covariance: FloatArray) -> complex | None:
    """Return the fastest pole where no coefficient is known, of a pair that above the real axis; else None.

    It may then be infinitely fast: every coefficient of A and B holds its product with the others.

    >>> untold_pole(Structure(2), np.array([3.0, 2.0, 1.0]), np.diag([3.0, 2.0, 1.0]) ** 2)
    (-2+0j)
    >>> untold_pole(Structure(2), np.array([3.0, 2.0, 1.0]), np.diag([3.0, 2.0, 0.1]) ** 2)
    """
    size = structure.coefficients
    std = np.sqrt(np.diag(covariance)[:size])
    if structure.poles < 2 or not (np.abs(parameters[:size]) < UNKNOWN * std).all():
        return None
    poles = roots(np.append(1.0, parameters[structure.denominator]))
    fastest = complex(poles[np.abs(poles).argmax()])
    return complex(fastest.real, abs(fastest.imag))


def _real(poles: npt.NDArray[np.complex128], zeros: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """Return the real roots to look at: a grid, and those between each real pole and its nearest real zeros."""
    fastest = float(np.abs(poles).max())
    slowest = max(float(np.abs(poles).min()), fastest / REACH)
    grid = np.geomspace(slowest / REACH, fastest * REACH, REAL) if fastest > 0.0 else np.zeros(0)
    between = _between(poles[poles.imag == 0.0], zeros[zeros.imag == 0.0])
    return np.concatenate([-grid, grid, between]).astype(np.complex128)


def _pairs(poles: npt.NDArray[np.complex128], zeros: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """Return the complex roots to look at: those of A and B, and those between them."""
    return _between(poles[poles.imag > 0.0], zeros[zeros.imag > 0.0])


def _between(poles: npt.NDArray[np.complex128], zeros: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """Return poles, zeros, and the points on the way from each pole to its nearest zeros."""
    way, found = np.linspace(0.0, 1.0, STEPS + 1), [poles, zeros]
    for pole in poles:
        nearest = zeros[np.argsort(np.abs(zeros - pole))[:NEAR]]
        found.append((pole + way * (nearest - pole)[:, None]).ravel())
    return np.concatenate(found)


def _statistics(
    candidates: npt.NDArray[np.complex128], a: FloatArray, b: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Return F at each of several roots (R,), all real or all complex; infinite where the covariance is singular."""
    n = a.size - 1
    powers = np.vander(candidates, n + 1)
    rows = np.zeros((candidates.size, 2, covariance.shape[0]), np.complex128)
    rows[:, 0, :n] = powers[:, 1:]
    rows[:, 1, n:] = powers[:, n + 1 - b.size :]
    shared = np.stack([powers @ a, powers[:, n + 1 - b.size :] @ b], axis=1)
    parts = [np.real] if (candidates.imag == 0.0).all() else [np.real, np.imag]
    constraints = np.concatenate([part(rows) for part in parts], axis=1)
    values = np.hstack([part(shared) for part in parts])
    squares = constraints @ covariance @ constraints.transpose(0, 2, 1)
    stds = np.sqrt(np.einsum("rii->ri", squares))
    scaled = squares / (stds[:, :, None] * stds[:, None, :])
    usable = np.isfinite(scaled).all(axis=(1, 2))
    eigenvalues, vectors = np.linalg.eigh(scaled[usable])
    along = np.einsum("rji,rj->ri", vectors, values[usable] / stds[usable])
    found = np.full(candidates.size, np.inf)
    found[usable] = (along**2 / np.maximum(eigenvalues, ROUNDING)).mean(axis=1)
    return np.where(np.isfinite(found), found, np.inf)
