"""TransferFunction: num, den and dead time; poles, response, simulation, conversion to SciPy and python-control."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.errors import InvalidArgumentError, needs, shown
from replant.model import interop, state_space
from replant.model.state_space import Response
from replant.numerics.arguments import FloatArray, array_of_reals, coefficients, one_of, vector, whole
from replant.numerics.limits import count, dead_time, duration
from replant.numerics.linear_algebra import quiet, roots


@dataclass(frozen=True)
class Mode:
    """A pole with its frequency, damping and time constant.

    Attributes
    ----------
    pole : complex
        In rad/s.
    frequency : float
        Natural frequency abs(pole) / (2 pi), in Hz.
    damping : float
        -Re(pole) / abs(pole); 1 for a real stable pole, NaN at the origin.
    time_constant : float
        -1 / Re(pole) in s; infinite on the imaginary axis, negative for an unstable pole.
    """

    pole: complex
    frequency: float
    damping: float
    time_constant: float

    @classmethod
    def of(cls, pole: complex) -> Mode:
        """Return the mode of a pole in rad/s.

        >>> Mode.of(-3.0 + 4.0j).damping, Mode.of(-2.0 + 0.0j).time_constant
        (0.6, 0.5)
        """
        magnitude = abs(pole)
        damping = -pole.real / magnitude if magnitude else math.nan
        time_constant = -1.0 / pole.real if pole.real else math.inf
        return cls(pole, magnitude / (2 * math.pi), damping, time_constant)


# with a higher order the coefficients for a dead time of 1 s overflow
MOST_PADE = 100  # highest order of a Pade approximation [count]


@dataclass(frozen=True, eq=False, repr=False)
class TransferFunction:
    r"""A continuous-time transfer function :math:`G(s) = \frac{num(s)}{den(s)} e^{-s\,delay}`.

    Parameters
    ----------
    num, den : sequence of float
        Coefficients in descending powers of s, as in SciPy and python-control; both are divided by the leading
        coefficient of ``den``.
    delay : float
        Dead time in s.

    Raises
    ------
    InvalidArgumentError
        If ``den`` is zero, or ``num`` is of higher order than ``den``.

    Examples
    --------
    >>> g = TransferFunction([2.0], [1.0, 4.0, 3.0])
    >>> g.poles.real, g.dc_gain
    (array([-3., -1.]), 0.666...)
    >>> print(g)
    2 / (s^2 + 4 s + 3)
    """

    num: FloatArray
    den: FloatArray
    delay: float = 0.0

    def __init__(self, num: Sequence[float] | FloatArray, den: Sequence[float] | FloatArray, delay: float = 0.0):
        # leading zeros are dropped, so that equal systems have equal coefficients
        numerator = np.trim_zeros(coefficients("num", num), "f")
        denominator = np.trim_zeros(coefficients("den", den), "f")
        if denominator.size == 0:
            raise InvalidArgumentError("den must not be zero")
        if numerator.size > denominator.size:
            raise InvalidArgumentError(
                f"num must not be of higher order than den, got {numerator.size - 1} and {denominator.size - 1}"
            )
        numerator = numerator if numerator.size else np.zeros(1)
        for name, polynomial in (("num", numerator), ("den", denominator)):
            object.__setattr__(self, name, _monic(name, polynomial, float(denominator[0])))
        object.__setattr__(self, "delay", dead_time("delay", delay))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TransferFunction):
            return NotImplemented
        same = np.array_equal(self.num, other.num) and np.array_equal(self.den, other.den)
        return bool(same and self.delay == other.delay)

    def __hash__(self) -> int:
        return hash((self.num.tobytes(), self.den.tobytes(), self.delay))

    def __repr__(self) -> str:
        return f"<TransferFunction {self}>"

    def __str__(self) -> str:
        dead_time = f" exp(-{self.delay:.4g} s)" if self.delay else ""
        return f"{polynomial_text(self.num)} / {polynomial_text(self.den)}{dead_time}"

    @property
    def poles(self) -> npt.NDArray[np.complex128]:
        """Roots of ``den``, in rad/s."""
        return roots(self.den)

    @property
    def zeros(self) -> npt.NDArray[np.complex128]:
        """Roots of ``num``, in rad/s."""
        return roots(self.num)

    @property
    def dc_gain(self) -> float:
        """G(0); infinite with a pole at the origin."""
        if self.den[-1] == 0.0:
            return math.inf if self.num[-1] != 0.0 else math.nan
        return float(self.num[-1] / self.den[-1]) + 0.0  # not -0

    @property
    def is_stable(self) -> bool:
        """Whether every pole lies to the left of the imaginary axis."""
        return bool((self.poles.real < 0).all())

    @property
    def modes(self) -> tuple[Mode, ...]:
        """The poles with frequency, damping and time constant, slowest first; one entry for a conjugate pair."""
        upper = [pole for pole in self.poles.tolist() if pole.imag >= 0]
        return tuple(Mode.of(pole) for pole in sorted(upper, key=abs))

    @quiet
    def response(self, frequency: Sequence[float] | FloatArray) -> npt.NDArray[np.complex128]:
        """Return G(i omega) at each ``frequency`` omega in rad/s, in the same shape; not finite at a pole.

        Parameters
        ----------
        frequency : array
            Angular frequencies in rad/s.

        Examples
        --------
        >>> abs(TransferFunction([1.0], [1.0, 1.0]).response([0.0, 1.0])).round(4)
        array([1.    , 0.7071])
        """
        s = 1j * array_of_reals("frequency", frequency)
        result = np.polyval(self.num, s) / np.polyval(self.den, s) * np.exp(-s * self.delay)
        return np.asarray(result, np.complex128)

    @quiet
    def simulate(self, u: Sequence[float] | FloatArray, dt: float, *, input_hold: str = "zoh") -> FloatArray:
        """Return the output (K,) for a sampled input, starting at rest; exact for the given hold.

        Before the first sample the input is zero.

        Parameters
        ----------
        u : (K,) array
        dt : float
            Sampling time in s.
        input_hold : {"zoh", "foh"}
            Input between samples: held, or linear.

        Examples
        --------
        >>> TransferFunction([1.0], [1.0, 1.0]).simulate([1.0, 1.0, 1.0], dt=1.0).round(4)
        array([0.    , 0.6321, 0.8647])
        """
        u, dt = vector("u", u), duration("dt", dt)
        return Response(self, dt, one_of("input_hold", input_hold, ("zoh", "foh"))).take(u).output

    @quiet
    def free_responses(self, samples: int, dt: float) -> FloatArray:
        """Return the responses (K, n) to a unit of each initial state, at K ``samples`` that are ``dt`` s apart.

        The states are those of `state_space.companion`.  An initial state w0 (n,) adds ``free_responses @ w0``.
        """
        dt, samples = duration("dt", dt), count("samples", samples, 0, 4 * self.den.size)
        undelayed = TransferFunction(self.num, self.den)
        free = Response(undelayed, dt, at_rest=False).take(np.zeros(samples)).free
        return np.concatenate([free, np.zeros((samples - len(free), free.shape[1]))])

    @property
    def feedthrough(self) -> float:
        """Gain from the input to the output at the same instant: 0 unless there are as many zeros as poles."""
        return float(self.num[0]) if self.num.size == self.den.size else 0.0

    def output_row(self, model: state_space.Companion) -> FloatArray:
        """Return the row (n,) from the companion states to the output without feedthrough."""
        order = self.den.size - 1
        padded = np.zeros(order + 1)
        padded[order + 1 - self.num.size :] = self.num
        remainder = padded[1:] - padded[0] * self.den[1:]
        return np.asarray(remainder / model.scale)

    @classmethod
    def from_control(cls, system: Any, delay: float = 0.0) -> TransferFunction:
        """Return the transfer function of a `control.TransferFunction` or `control.StateSpace`.

        Parameters
        ----------
        system : control.TransferFunction or control.StateSpace
            In continuous time, with one input and one output.
        delay : float
            Dead time in s, as python-control's systems have none.

        Raises
        ------
        InvalidArgumentError
            If the system has several inputs or outputs, is in discrete time, or improper.
        ArgumentTypeError
            If it is neither of the two.
        MissingDependencyError
            If python-control is not installed.

        Examples
        --------
        >>> import control
        >>> print(TransferFunction.from_control(control.tf([2.0], [1.0, 4.0, 3.0])))
        2 / (s^2 + 4 s + 3)
        """
        return cls(*interop.of_control(system), delay)

    @classmethod
    def from_scipy(cls, system: Any, delay: float = 0.0) -> TransferFunction:
        """Return the transfer function of a TransferFunction, ZerosPolesGain or StateSpace of `scipy.signal`.

        Parameters
        ----------
        system : scipy.signal.lti
            With one input and one output.
        delay : float
            Dead time in s, as SciPy's systems have none.

        Raises
        ------
        InvalidArgumentError
            If the system has several inputs or outputs, is in discrete time, or improper.
        ArgumentTypeError
            If it is none of these, or has complex coefficients.

        Examples
        --------
        >>> from scipy import signal
        >>> print(TransferFunction.from_scipy(signal.ZerosPolesGain([], [-1.0, -3.0], 2.0)))
        2 / (s^2 + 4 s + 3)
        """
        return cls(*interop.of_scipy(system), delay)

    def to_scipy(self) -> Any:
        """Return a `scipy.signal.TransferFunction`, which cannot have a dead time.

        Raises
        ------
        InvalidArgumentError
            If ``delay`` is not 0.
        """
        if self.delay:
            raise InvalidArgumentError(f"SciPy's transfer functions have no dead time, this one has {self.delay:g} s")
        from scipy.signal import TransferFunction as ScipyTransferFunction

        system = ScipyTransferFunction([1.0], [1.0])
        # set afterwards: the constructor drops leading numerator coefficients below 1e-14 with a warning
        system.num, system.den = self.num, self.den
        return system

    def to_control(self, pade: int | None = None) -> Any:
        """Return a `control.TransferFunction`, which cannot have a dead time.

        Parameters
        ----------
        pade : int, optional
            Order of the Pade approximation that replaces the dead time; its phase is accurate up to about
            ``pade / delay`` rad/s.

        Raises
        ------
        InvalidArgumentError
            If ``delay`` is not 0 and no order is given.
        MissingDependencyError
            If python-control is not installed.

        Examples
        --------
        >>> TransferFunction([2.0], [1.0, 1.0], delay=0.1).to_control(pade=1).poles().real
        array([-20.,  -1.])
        """
        if self.delay and pade is None:
            raise InvalidArgumentError(
                f"python-control's transfer functions have no dead time, this one has {self.delay:g} s: "
                "approximate it, to_control(pade=3)"
            )
        with needs("to_control needs python-control", "control"):
            import control
        order = 1 if pade is None else whole("pade", pade, 1)
        rational = control.tf(self.num, self.den)
        return rational * control.tf(*_pade(self.delay, order)) if self.delay else rational

    def to_sympy(self) -> Any:
        """Return G(s) as an expression of SymPy in the symbol s, the dead time as exp(-delay s).

        Raises
        ------
        MissingDependencyError
            If SymPy is not installed.

        Examples
        --------
        >>> TransferFunction([2.0], [1.0, 4.0, 3.0]).to_sympy()
        2.0/(1.0*s**2 + 4.0*s + 3.0)
        """
        with needs("to_sympy needs SymPy", "sympy"):
            import sympy
        s = sympy.Symbol("s")
        num, den = (
            sum(value * s**power for power, value in enumerate(reversed(polynomial.tolist())))
            for polynomial in (self.num, self.den)
        )
        return num / den * sympy.exp(-self.delay * s) if self.delay else num / den


@quiet
def _monic(name: str, polynomial: FloatArray, leading: float) -> FloatArray:
    """Return a polynomial divided by the leading coefficient of ``den``."""
    monic = polynomial / leading + 0.0  # turns -0.0 into 0.0: equal coefficients must have the same hash
    if not np.isfinite(monic).all():
        raise InvalidArgumentError(
            f"{name} overflows when divided by the leading coefficient of den, {leading:g}: scale both polynomials"
        )
    return coefficients(name, monic)


def _pade(delay: float, order: int) -> tuple[FloatArray, FloatArray]:
    """Return num and den of the Pade approximation of a dead time; InvalidArgumentError if coefficients overflow."""
    import control

    if order <= MOST_PADE:
        with contextlib.suppress(OverflowError, ZeroDivisionError):
            num, den = (np.array(polynomial, np.float64) for polynomial in control.pade(delay, order))
            if np.isfinite(num).all() and np.isfinite(den).all():
                return num, den
    raise InvalidArgumentError(
        f"pade must be smaller: with a dead time of {delay:g} s coefficients of order {shown(order)} overflow"
    )


def polynomial_text(polynomial: FloatArray) -> str:
    """Return a polynomial in s (descending powers) as text, in brackets if it has more than one term.

    >>> import numpy as np
    >>> polynomial_text(np.array([1.0, -4.0, 0.5])), polynomial_text(np.array([2.0]))
    ('(s^2 - 4 s + 0.5)', '2')
    """
    terms = terms_of(polynomial, lambda value: f"{value:.4g}", " ", "s^{}")
    return f"({''.join(terms)})" if len(terms) > 1 else terms[0]


def terms_of(polynomial: FloatArray, number: Callable[[float], str], times: str, power_of_s: str) -> list[str]:
    """Return the terms of a polynomial with their signs; ``number`` formats a coefficient, ``times`` follows it."""
    terms: list[str] = []
    for power, value in zip(range(polynomial.size - 1, -1, -1), polynomial.tolist(), strict=True):
        if value == 0.0 and polynomial.size > 1:
            continue
        symbol = "" if power == 0 else "s" if power == 1 else power_of_s.format(power)
        size = number(abs(value))
        body = symbol if symbol and size == "1" else f"{size}{times}{symbol}" if symbol else size
        sign = "-" if value < 0 else "+" if terms else ""
        terms.append(f" {sign} {body}" if terms else f"{sign}{body}")
    return terms or ["0"]
