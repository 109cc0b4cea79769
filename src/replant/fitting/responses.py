r"""Responses of a model: step, impulse, Bode, Nyquist, poles, each with standard deviations where they are known.

The standard deviation of a response y(t) follows from the covariance C of the coefficients to first order (delta
method), :math:`\sqrt{s^T C s}` with the sensitivities :math:`s = \partial y(t) / \partial \theta`, which are responses
themselves: :math:`\partial G / \partial a_i = -s^i B / A^2`, :math:`\partial G / \partial b_j = s^j / A`.

Source: Ljung (1999), "System Identification: Theory for the User", sections 4.3 and 9.4.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from replant.errors import InvalidArgumentError
from replant.model.transfer_function import Mode, TransferFunction
from replant.model.uncertainty import UncertainMode, Uncertainty
from replant.numerics.arguments import FloatArray, array_of_reals
from replant.numerics.limits import LONGEST, SHORTEST, duration
from replant.numerics.linear_algebra import quiet
from replant.plotting.diagrams import draw_bode, draw_nyquist, draw_poles, draw_response, with_conjugates
from replant.plotting.numbers import over, with_std
from replant.plotting.style import Shown

POINTS = 400  # points of a response; a fast oscillation over time has more [count]
PER_PERIOD, MOST_POINTS = 8, 8000  # points per period of a response over time, and most points [count]
SETTLED = 6.0  # duration of a response: 0.25 % of a step response is then left [slowest time constants]
BEYOND = 30.0  # how far a frequency response reaches beyond the slowest and the fastest root [ratio]
RESONANT = 0.3  # damping below which a pair of roots makes a peak that needs frequencies of its own [damping ratio]
NEAR_RESONANCE = 32  # frequencies about a peak; even: at an undamped root itself the response is infinite [count]
LEAST_DAMPING = 1e-4  # damping at which peaks are not resolved any further [damping ratio]


@dataclass(frozen=True, eq=False, repr=False)
class StepResponse(Shown):
    """The response to a unit step, from rest.

    Attributes
    ----------
    time : (N,) array
        In s.
    output : (N,) array
    std : (N,) array or None
        Standard deviation of the output; None if unknown.
    """

    time: FloatArray
    output: FloatArray
    std: FloatArray | None

    WHAT, IS_OF_IMPULSE = "step response", False

    @classmethod
    def of(cls, model: TransferFunction, known: Uncertainty | None, time: FloatArray) -> Self:
        """Return the response of a model at times (N,), which begin at 0 and are equally spaced, in s.

        InvalidArgumentError if a response to an impulse holds an impulse.
        """
        if cls.IS_OF_IMPULSE and model.num.size == model.den.size:
            raise InvalidArgumentError(
                "G(s) has as many zeros as poles: its impulse response holds an impulse; use step()"
            )
        return cls(time, *_over_time(model, known, time, impulse=cls.IS_OF_IMPULSE))

    def plot(self, ax: Any = None) -> Any:
        """Draw the response with its band of +-2 standard deviations, into ``ax`` if given; return its axes."""
        return draw_response({"model": self}, self.WHAT, ax)

    def __repr__(self) -> str:
        std = None if self.std is None or not self.std.size else float(self.std[-1])
        end = f", {with_std(float(self.output[-1]), std)} at the end" if self.output.size else ""
        return f"<{type(self).__name__} over {over(self.time, 's')}: {self.time.size} values{end}>"


@dataclass(frozen=True, eq=False, repr=False)
class ImpulseResponse(StepResponse):
    """The response to a unit impulse, from rest: time, output and std as of a `StepResponse`."""

    WHAT, IS_OF_IMPULSE = "impulse response", True


@dataclass(frozen=True, eq=False, repr=False)
class Bode(Shown):
    """A frequency response.

    Attributes
    ----------
    frequency : (F,) array
        In rad/s.
    response : (F,) complex array
        G(i omega).
    relative_std, phase_std : (F,) array or None
        Standard deviations of ln abs G and of the phase in rad; None if unknown.
    """

    frequency: FloatArray
    response: npt.NDArray[np.complex128]
    relative_std: FloatArray | None
    phase_std: FloatArray | None

    @classmethod
    def of(cls, model: TransferFunction, known: Uncertainty | None, dt: float, frequency: Any = None) -> Self:
        """Return the response of a model; without ``frequency`` (F,) in rad/s, from below its roots to above them."""
        omega = frequencies(model, dt) if frequency is None else _angular(frequency)
        relative, phase = (None, None) if known is None else known.response(omega)
        return cls(omega, model.response(omega), relative, phase)

    @property
    def magnitude(self) -> FloatArray:
        """Abs G (F,)."""
        return np.abs(self.response)

    @property
    def phase(self) -> FloatArray:
        """Phase (F,) in rad, continuous over frequency."""
        phase = np.unwrap(np.angle(self.response))
        return np.asarray(phase - math.tau * round(float(phase[0]) / math.tau)) if phase.size else phase

    def plot(self, ax: Any = None) -> Any:
        """Draw magnitude and phase with bands of +-2 standard deviations, into two axes ``ax`` if given."""
        return draw_bode({"model": self}, ax, argument="ax")

    def __repr__(self) -> str:
        figures = f"abs G {over(self.magnitude, '')}, phase {over(np.degrees(self.phase), 'degrees')}"
        values = f"{self.frequency.size} values, {figures.replace(' ,', ',')}"
        return f"<{type(self).__name__} over {over(self.frequency, 'rad/s')}: {values}>"


@dataclass(frozen=True, eq=False, repr=False)
class Nyquist(Bode):
    """A frequency response in the complex plane: frequency, response and standard deviations as of a `Bode`."""

    def plot(self, ax: Any = None) -> Any:
        """Draw G(i omega) with its regions of 2 standard deviations, into ``ax`` if given; return its axes."""
        return draw_nyquist(self.response, self.relative_std, self.phase_std, ax)


@dataclass(frozen=True, eq=False, repr=False)
class PoleMap(Shown):
    """Poles and zeros.

    Attributes
    ----------
    values, zeros : complex arrays
        In rad/s.
    modes : tuple of Mode
        The poles as frequency, damping and time constant, slowest first; one entry for a conjugate pair.
    uncertain : tuple of UncertainMode
        The same with their standard deviations; empty if unknown.
    """

    values: npt.NDArray[np.complex128]
    zeros: npt.NDArray[np.complex128]
    modes: tuple[Mode, ...]
    uncertain: tuple[UncertainMode, ...]

    @classmethod
    def of(cls, model: TransferFunction, known: Uncertainty | None) -> Self:
        """Return the poles and zeros of a model."""
        return cls(model.poles, model.zeros, model.modes, () if known is None else known.modes)

    def plot(self, ax: Any = None) -> Any:
        """Draw poles and zeros with the poles' 95 % regions, into ``ax`` if given; return its axes."""
        regions = [(mode.mode.pole, mode.covariance) for mode in self.uncertain]
        return draw_poles({"model": (self.values, self.zeros, with_conjugates(regions))}, ax)

    def __repr__(self) -> str:
        poles, zeros = (
            ", ".join(f"{root:.4g}" if root.imag else f"{root.real:.4g}" for root in roots.tolist())
            for roots in (self.values, self.zeros)
        )
        return f"<PoleMap: poles {poles} rad/s, {f'zeros {zeros} rad/s' if zeros else 'no zeros'}>"


def time_of(model: TransferFunction, given: float | None = None) -> FloatArray:
    """Return times (N,) in s from 0 to ``given``, or until the slowest mode has settled; oscillations are resolved."""
    if given is None:
        slowest = np.abs(model.poles.real)
        speeds = np.where(slowest > 1e-6 * np.abs(model.poles), slowest, np.abs(model.poles))
        # without modes that are too slow to settle, as an integrator, or too fast to be seen
        speeds = speeds[(speeds > SETTLED / (0.1 * LONGEST)) & (speeds < SETTLED / SHORTEST)]
        lasts = model.delay + (SETTLED / float(speeds.min()) if speeds.size else 1.0)
        lasts = min(lasts, LONGEST)
    else:
        lasts = duration("duration", given)
    turns = np.abs(model.poles.imag[np.abs(model.poles.imag) > np.abs(model.poles.real)])
    fastest = float(np.max(turns[np.isfinite(turns)], initial=0.0))
    points = PER_PERIOD * min(lasts * min(fastest, 1.0 / SHORTEST), float(MOST_POINTS)) / math.tau
    return np.linspace(0.0, lasts, int(min(max(points, POINTS), MOST_POINTS)))


def frequencies(model: TransferFunction, dt: float, points: int = POINTS) -> FloatArray:
    """Return angular frequencies (F,) from 1/30 of the slowest root to 30 times the fastest, at most Nyquist's."""
    roots = np.concatenate([model.poles, model.zeros])
    sizes = np.abs(roots)
    nyquist = math.pi / dt
    sizes = sizes[np.isfinite(sizes) & (sizes > 1e-9 * nyquist) & (sizes < 1e3 * nyquist)]
    low, high = nyquist / 1e4, nyquist
    if sizes.size:
        low, high = float(sizes.min()) / BEYOND, float(sizes.max()) * BEYOND
    high = max(min(high, nyquist), 10 * low)
    # closer about each resonance and antiresonance, so that a curve shows the whole peak
    peaks = [_about(complex(root)) for root in roots if root.imag > 0.0 and abs(root.real) < RESONANT * abs(root)]
    close = np.concatenate([np.zeros(0), *peaks])
    return np.unique(np.concatenate([np.geomspace(low, high, points), close[(close > low) & (close < high)]]))


def _angular(frequency: Any) -> FloatArray:
    """Return angular frequencies (F,) that a user gives, in rad/s."""
    omega = array_of_reals("frequency", frequency).ravel()
    if not (np.abs(omega) <= 1.0 / SHORTEST).all():
        raise InvalidArgumentError(f"frequency must be finite and at most {1.0 / SHORTEST:g} rad/s")
    return omega


def _about(root: complex) -> FloatArray:
    """Return frequencies about a resonance, from a tenth of the half-width of its peak to ten times that."""
    half_width = max(abs(root.real) / abs(root), LEAST_DAMPING)
    return np.asarray(abs(root) * np.exp(half_width * np.sinh(np.linspace(-3.0, 3.0, NEAR_RESONANCE))))


@quiet
def _over_time(
    model: TransferFunction, known: Uncertainty | None, time: FloatArray, *, impulse: bool
) -> tuple[FloatArray, FloatArray | None]:
    """Return a response (N,) to a step or an impulse, and its standard deviation."""
    output = _response(model.num, model, time, impulse=impulse)
    if known is None:
        return output, None
    n, m = known.structure.poles, known.structure.zeros
    slopes = np.zeros((time.size, known.structure.size))
    squared = TransferFunction(model.num, np.asarray(np.polymul(model.den, model.den), np.float64), model.delay)
    for i in range(n):
        slopes[:, n - 1 - i] = -_response(np.append(model.num, np.zeros(i)), squared, time, impulse=impulse)
    for j in range(m + 1):
        slopes[:, n + m - j] = _response(np.append(1.0, np.zeros(j)), model, time, impulse=impulse)
    variance = np.einsum("ti,ij,tj->t", slopes, known.covariance, slopes)
    return output, np.sqrt(np.maximum(variance, 0.0))


def _response(num: FloatArray, model: TransferFunction, time: FloatArray, *, impulse: bool) -> FloatArray:
    """Return the response (N,) of num(s) over the denominator of a model, with its dead time."""
    if impulse:  # the step response of s num / den is the impulse response of num / den
        num = np.append(num, 0.0)
    part = TransferFunction(num, model.den, model.delay)
    return part.simulate(np.ones(time.size), float(time[1] - time[0]))
