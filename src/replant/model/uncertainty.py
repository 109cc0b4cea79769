r"""Uncertainty of poles, damping, gain and frequency response, from the covariance of the coefficients.

It is a first-order approximation, except for a pole that a zero may cancel, perhaps at infinity.  If A and B share a
root p, G(s) has fewer poles and zeros, times (s - p)/(s - p): p, and with it the coefficients, may be any number.  If a
pole and a zero of an estimate nearly cancel, the covariance is valid only near the place where chance has put them.
Only an unbounded interval then contains the true coefficients with the stated probability.  The response of G(s) at
excited frequencies, and its other poles, are not affected.

A and B are linear in the coefficients theta, so that a shared root p is a linear constraint C theta = c:

.. math:: F(p) = \frac{1}{q}\, g^T (C P C^T)^{-1} g, \qquad g = [A(p), B(p)]

with P the covariance of theta, and q the number of constraints: two for a real p, four for a complex pair.  The
smallest F over all p tests the hypothesis that a root is shared.

Source: Dufour (1997), "Some impossibility theorems in econometrics with applications to structural and dynamic models",
Econometrica 65; Staiger and Stock (1997), "Instrumental variables regression with weak instruments", Econometrica 65.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from replant.model.structure import Structure
from replant.model.transfer_function import Mode, TransferFunction
from replant.numerics.arguments import FloatArray, array_of_reals, instance, keep, owned
from replant.numerics.linear_algebra import quiet, roots

ComplexArray = npt.NDArray[np.complex128]

# the rule of Staiger and Stock for weak instruments; none of 600 fits with one or two surplus poles and zeros exceeded
# it; of 992 estimates of random plants 131 had a coefficient beyond three standard deviations, of which 103 were among
# the 156 below it
WEAK = 10.0  # smallest F up to which a root may be shared, so first-order intervals are invalid [ratio of variances]

UNKNOWN = 2.0  # distance from zero up to which a coefficient may be zero: 95 % interval [standard deviations]

# such a pole is slower than any record, or faster than its sampling
REACH = 1e3  # range of the real roots tested, beyond the slowest and the fastest pole [ratio of magnitudes]

# 17 a decade over the eight decades of plants whose poles span two; F changes over a factor of about two
REAL = 200  # real roots tested of each sign, evenly spaced in the logarithm [count]

# F changes with the square of the distance
STEPS = 10  # steps from a pole to a zero, at each of which a root is tested [count]

NEAR = 3  # nearest zeros tested with each pole, as these cancel it [count]

# 4e5 times the precision of float64
ROUNDING = 1e-10  # floor of an eigenvalue of the constraints' correlations, for rounding [ratio]


@dataclass(frozen=True, eq=False)
class UncertainMode:
    """A pole with the standard deviations of its frequency, damping and time constant."""

    mode: Mode
    covariance: FloatArray  # (2, 2): of the pole's real and imaginary part, in (rad/s)^2
    # in Hz, without unit, and in s; infinite if the figure itself is infinite
    frequency_std: float
    damping_std: float
    time_constant_std: float


@dataclass(frozen=True, eq=False, repr=False)
class Uncertainty:
    r"""The uncertainty of an estimate and of the figures computed from it, to first order (delta method).

    A figure :math:`f(\theta)` has the variance :math:`J C J^T` with :math:`J = \partial f / \partial \theta`.  This
    holds if the figure is nearly linear over a few standard deviations.  If a pole and a zero may cancel, or a pole may
    be infinitely fast, the standard deviations of all coefficients and of that pole are infinite, see
    `replant.model.uncertainty`.

    Parameters
    ----------
    structure : Structure
    parameters : (P,) array
    covariance : (P, P) array
        In the units of the parameters, squared; NaN while unknown.

    References
    ----------
    Ljung (1999), "System Identification: Theory for the User", section 9.4 and appendix 9A.

    Examples
    --------
    >>> known = Uncertainty(Structure(poles=1), np.array([0.5, 2.0]), np.diag([1e-4, 4e-4]))
    >>> known.std, round(known.dc_gain_std, 4)
    (array([0.01, 0.02]), 0.0894)
    >>> mode, = known.modes
    >>> mode.mode.time_constant, round(mode.time_constant_std, 4)
    (2.0, 0.04)
    """

    structure: Structure
    parameters: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        keep(self, "structure", instance, Structure)
        size = self.structure.size
        keep(self, "parameters", owned, (size,))
        keep(self, "covariance", owned, (size, size))

    @cached_property
    def cancelled_pole(self) -> complex | None:
        """The pole that a zero may cancel, or None; of a complex pair, the one above the real axis."""
        return cancelled_pole(self.structure, self.parameters, self.covariance)

    @cached_property
    @quiet
    def untold_pole(self) -> complex | None:
        """The fastest pole if every coefficient may be zero, else None; of a complex pair, the one above the real axis.

        Such a pole may be infinitely fast: it is a factor of every coefficient of A and B.

        >>> Uncertainty(Structure(2), np.array([3.0, 2.0, 1.0]), np.diag([3.0, 2.0, 1.0]) ** 2).untold_pole
        (-2+0j)
        >>> Uncertainty(Structure(2), np.array([3.0, 2.0, 1.0]), np.diag([3.0, 2.0, 0.1]) ** 2).untold_pole
        """
        size = self.structure.coefficients
        std = np.sqrt(np.diag(self.covariance)[:size])
        if self.structure.poles < 2 or not (np.abs(self.parameters[:size]) < UNKNOWN * std).all():
            return None
        poles = roots(np.append(1.0, self.parameters[self.structure.denominator]))
        return _upper(poles[np.abs(poles).argmax()])

    def __repr__(self) -> str:
        known = zip(self.structure.names, self.parameters.tolist(), self.std.tolist(), strict=False)
        return f"<Uncertainty {', '.join(f'{name} {value:.4g} +- {std:.2g}' for name, value, std in known)}>"

    @property
    @quiet
    def std(self) -> FloatArray:
        """Standard deviation of each parameter, (P,); infinite if the samples do not determine a pole."""
        if self.cancelled_pole is not None or self.untold_pole is not None:
            return np.full(self.structure.size, math.inf)
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0) + 0.0 * np.diag(self.covariance)))

    @property
    def modes(self) -> tuple[UncertainMode, ...]:
        """The poles of `TransferFunction.modes`, in the same order, with their standard deviations.

        They are infinite for a pole that the samples do not determine.
        """
        found, cancelled = self.first_order_modes, self.cancelled_pole
        untold = self.untold_pole if cancelled is None else cancelled
        if untold is None:
            return found
        nearest = min(found, key=lambda each: abs(each.mode.pole - untold))
        return tuple(_unknown(each.mode, math.inf) if each is nearest else each for each in found)

    @property
    @quiet
    def first_order_modes(self) -> tuple[UncertainMode, ...]:
        """The same by the covariance alone, also for a pole that a zero may cancel."""
        return tuple(self._uncertain_mode(mode) for mode in self._model.modes)

    @property
    @quiet
    def dc_gain_std(self) -> float:
        """Standard deviation of G(0)."""
        if self._model.den[-1] == 0.0:
            return math.inf
        return _std(dc_gain_slope(self.structure, self.parameters), self.covariance)

    @quiet
    def response(self, frequency: Sequence[float] | FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the standard deviations of ln abs G, which are relative ones of abs G, and of the phase in rad.

        Parameters
        ----------
        frequency : (F,) array
            In rad/s.

        Returns
        -------
        relative : (F,) array
            Of ln abs G.
        phase : (F,) array
            In rad.
        """
        omega = array_of_reals("frequency", frequency).ravel()
        slopes = self._log_response_slopes(omega)
        real = np.einsum("fi,ij,fj->f", slopes.real, self.covariance, slopes.real)
        imag = np.einsum("fi,ij,fj->f", slopes.imag, self.covariance, slopes.imag)
        return np.sqrt(np.maximum(real, 0.0)), np.sqrt(np.maximum(imag, 0.0))

    @property
    def _model(self) -> TransferFunction:
        return self.structure.transfer_function(self.parameters)

    def _log_response_slopes(self, omega: FloatArray) -> ComplexArray:
        """Return d ln G(i omega) / d theta, (F, P)."""
        n, m = self.structure.poles, self.structure.zeros
        s = 1j * omega
        slopes = np.zeros((omega.size, self.structure.size), np.complex128)
        for i in range(n):
            slopes[:, n - 1 - i] = -(s**i) / np.polyval(self._model.den, s)
        for i in range(m + 1):
            slopes[:, n + m - i] = s**i / np.polyval(self._model.num, s)
        return slopes

    def _uncertain_mode(self, mode: Mode) -> UncertainMode:
        slope = self._pole_slope(mode.pole)
        if not np.isfinite(slope).all():
            unbounded = math.inf if np.isfinite(self.covariance).all() else math.nan
            return _unknown(mode, unbounded)
        parts = np.stack([slope.real, slope.imag])
        covariance = np.asarray(parts @ self.covariance @ parts.T)
        x, y = mode.pole.real, mode.pole.imag
        size = abs(mode.pole)
        if size == 0.0:
            return UncertainMode(mode, covariance, math.sqrt(max(covariance[0, 0], 0.0)) / math.tau, math.inf, math.inf)
        return UncertainMode(
            mode,
            covariance,
            _std(np.array([x, y]) / (math.tau * size), covariance),
            _std(np.array([-((y / size) ** 2), x / size * (y / size)]) / size, covariance),
            _std(np.array([1.0 / x / x, 0.0]), covariance) if x else math.inf,
        )

    def _pole_slope(self, pole: complex) -> ComplexArray:
        """Return dp / d theta, (P,): A(p) = 0 gives dp / da_i = -p^i / A'(p); infinite at a double pole."""
        n = self.structure.poles
        slope = np.zeros(self.structure.size, np.complex128)
        steepness = np.polyval(np.polyder(self._model.den), pole)
        if steepness == 0.0:
            slope[:n] = np.inf
            return slope
        slope[:n] = -(pole ** np.arange(n - 1, -1, -1)) / steepness
        return slope


def dc_gain_slope(structure: Structure, parameters: FloatArray) -> FloatArray:
    """Return the derivative (P,) of G(0)."""
    a0, b0 = parameters[structure.denominator.stop - 1], parameters[structure.numerator.stop - 1]
    slope = np.zeros(structure.size)
    slope[structure.denominator.stop - 1] = -b0 / a0**2
    slope[structure.numerator.stop - 1] = 1.0 / a0
    return slope


def _unknown(mode: Mode, std: float) -> UncertainMode:
    return UncertainMode(mode, np.full((2, 2), std), std, std, std)


def _std(slope: FloatArray, covariance: FloatArray) -> float:
    variance = float(slope @ covariance @ slope)
    return math.sqrt(max(variance, 0.0)) if variance == variance else math.nan


@quiet
def cancelled_pole(structure: Structure, parameters: FloatArray, covariance: FloatArray) -> complex | None:
    """Return the pole nearest to the root that A and B most likely share; None if they share none."""
    size = structure.coefficients
    known = covariance[:size, :size]
    if structure.zeros == 0 or not np.isfinite(known).all() or not np.isfinite(parameters[:size]).all():
        return None
    a = np.concatenate([[1.0], parameters[structure.denominator]])
    b = parameters[structure.numerator]
    poles, zeros = roots(a), roots(b)
    best, least = None, WEAK
    pairs = [_between(poles[poles.imag > 0.0], zeros[zeros.imag > 0.0])] if structure.zeros > 1 else []
    for candidates in (_real(poles, zeros), *pairs):  # a single zero cannot cancel a pair
        found = _statistics(candidates, a, b, known)
        if found.min(initial=np.inf) < least:
            best, least = complex(candidates[found.argmin()]), float(found.min())
    if best is None:
        return None
    return _upper(poles[np.abs(poles - best).argmin()])


def _upper(pole: complex) -> complex:
    """Return a pole, or its conjugate above the real axis."""
    return complex(pole.real, abs(pole.imag))


def _real(poles: ComplexArray, zeros: ComplexArray) -> ComplexArray:
    """Return the real roots to test: a grid, and points between each real pole and its nearest real zeros."""
    fastest = float(np.abs(poles).max())
    slowest = max(float(np.abs(poles).min()), fastest / REACH)
    grid = np.geomspace(slowest / REACH, fastest * REACH, REAL) if fastest > 0.0 else np.zeros(0)
    between = _between(poles[poles.imag == 0.0], zeros[zeros.imag == 0.0])
    return np.concatenate([-grid, grid, between]).astype(np.complex128)


def _between(poles: ComplexArray, zeros: ComplexArray) -> ComplexArray:
    """Return poles, zeros, and points between each pole and its nearest zeros."""
    way, found = np.linspace(0.0, 1.0, STEPS + 1), [poles, zeros]
    for pole in poles:
        nearest = zeros[np.argsort(np.abs(zeros - pole))[:NEAR]]
        found.append((pole + way * (nearest - pole)[:, None]).ravel())
    return np.concatenate(found)


def _statistics(candidates: ComplexArray, a: FloatArray, b: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return F at each of several roots (R,), all real or all complex; infinite if the covariance is singular."""
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
