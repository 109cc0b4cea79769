"""The Cramer-Rao bound: the least variance that an unbiased estimator can have, for noise of a known colour."""

from __future__ import annotations

import numpy as np

import replant as rp
from accuracy.loops import discretised
from replant.numerics.arguments import FloatArray


def cramer_rao(plant: rp.TransferFunction, u: FloatArray, dt: float, decibels: float, colour: float) -> FloatArray:
    r"""Return the least standard deviation of each coefficient, a_{n-1} .. a_0, b_m .. b_0.

    With the sensitivities :math:`S = \partial y/\partial\theta` of the output and a column of ones for the offset,
    both whitened by the known colour, the covariance is :math:`\sigma_w^2 (S^T S)^{-1}`.  For a held input they are
    exact: :math:`\partial G/\partial a_i = -s^i B/A^2`, :math:`\partial G/\partial b_i = s^i/A`.

    Parameters
    ----------
    plant : TransferFunction
    u : (K,) array
    dt : float
    decibels, colour : float
        Of the noise, see `records.noise`.

    Examples
    --------
    >>> from accuracy.records import PLANT_A
    >>> from replant.signals import prbs
    >>> cramer_rao(PLANT_A, prbs(2001, bits=8, hold=8), 0.05, decibels=10.0, colour=0.0).round(2)
    array([0.12, 0.07, 0.05])
    """
    a, b = plant.den, plant.num
    n, squared = a.size - 1, np.convolve(a, a)
    slopes = [(np.convolve(-b, _power(i)), squared) for i in reversed(range(n))]
    slopes += [(_power(i), a) for i in reversed(range(b.size))]
    columns = [_simulated(rp.TransferFunction(num, den), u, dt) for num, den in slopes]
    whitened = np.column_stack([*columns, np.ones(u.size)])
    whitened[1:] -= colour * whitened[:-1].copy()
    whitened[0] *= np.sqrt(1.0 - colour**2)  # of the first sample nothing is known before
    variance = _simulated(plant, u, dt).var() * 10.0 ** (-decibels / 10.0) * (1.0 - colour**2)
    sizes = np.linalg.norm(whitened, axis=0)  # they may differ by twenty powers of ten
    inverse = np.linalg.inv(np.linalg.qr(whitened / sizes, mode="r"))
    return np.asarray((np.sqrt(variance) * np.linalg.norm(inverse, axis=1) / sizes)[: n + b.size])


def _simulated(plant: rp.TransferFunction, u: FloatArray, dt: float) -> FloatArray:
    """Return the output (K,) from rest: without the package's kernels, which need not be compiled for this."""
    from scipy.signal import lfilter

    return np.asarray(lfilter(*discretised(plant, dt), u))


def _power(exponent: int) -> FloatArray:
    """Return s^exponent."""
    return np.eye(1, exponent + 1).ravel()
