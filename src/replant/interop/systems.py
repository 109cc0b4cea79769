"""Systems: numerator and denominator of the systems of python-control and SciPy."""

from __future__ import annotations

from typing import Any

import numpy as np

from replant.arguments import FloatArray, array_of_reals, coefficients
from replant.errors import ArgumentTypeError, InvalidArgumentError, MissingDependencyError

Polynomials = tuple[FloatArray, FloatArray]


def of_control(system: Any) -> Polynomials:
    """Return num and den of a `control.TransferFunction` or `control.StateSpace`.

    >>> import control
    >>> of_control(control.tf([2.0], [1.0, 0.5]))
    (array([2.]), array([1. , 0.5]))
    """
    try:
        import control
    except ImportError as cause:
        raise MissingDependencyError("from_control needs python-control: pip install 'replant[control]'") from cause
    if not isinstance(system, control.TransferFunction | control.StateSpace):
        raise ArgumentTypeError(
            f"system must be a control.TransferFunction or control.StateSpace, got {type(system).__name__}"
        )
    _check_single(system.ninputs, system.noutputs)
    if system.dt:  # None: the system's time is unspecified
        _refuse_discrete(system.dt)
    if isinstance(system, control.StateSpace):
        return of_state_space(system.A, system.B, system.C, system.D)
    return _proper(system.num[0][0], system.den[0][0])


def of_scipy(system: Any) -> Polynomials:
    """Return num and den of a system of `scipy.signal`: TransferFunction, ZerosPolesGain or StateSpace.

    >>> from scipy import signal
    >>> of_scipy(signal.ZerosPolesGain([], [-0.5], 2.0))
    (array([2.]), array([1. , 0.5]))
    """
    from scipy import signal

    if not isinstance(system, signal.TransferFunction | signal.ZerosPolesGain | signal.StateSpace):
        raise ArgumentTypeError(
            "system must be a TransferFunction, ZerosPolesGain or StateSpace of scipy.signal, "
            f"got {type(system).__name__}"
        )
    if system.dt is not None:
        _refuse_discrete(system.dt)
    if isinstance(system, signal.StateSpace):
        _check_single(system.B.shape[1], system.C.shape[0])
        return of_state_space(system.A, system.B, system.C, system.D)
    if isinstance(system, signal.ZerosPolesGain):
        _check_single(1, np.atleast_2d(system.zeros).shape[0])
        return _proper(*signal.zpk2tf(system.zeros, system.poles, system.gain))
    num = np.atleast_2d(system.num)
    _check_single(1, num.shape[0])
    return _proper(num[0], system.den)


def of_state_space(a: Any, b: Any, c: Any, d: Any) -> Polynomials:
    """Return num and den of a state-space model with one input and one output.

    Leading coefficients of the numerator that are zero are set to exactly 0, where `scipy.signal.ss2tf` leaves rounding
    errors.  The first non-zero coefficient has the same place as the first non-zero Markov parameter h_0 = D,
    h_k = C A^(k-1) B.

    >>> of_state_space([[0.0, 1.0], [-3.0, -4.0]], [[0.0], [1.0]], [[2.0, 0.0]], [[0.0]])
    (array([0., 0., 2.]), array([1., 4., 3.]))
    """
    a, b, c, d = (array_of_reals(name, value) for name, value in zip("ABCD", (a, b, c, d), strict=True))
    if a.size == 0:
        return d.reshape(-1)[:1], np.ones(1)
    from scipy.signal import ss2tf

    num, den = ss2tf(a, b, c, d)
    num = np.array(num[0], np.float64)
    markov, bound, column, reach = d.item(), abs(d.item()), b, np.abs(b)
    for k in range(num.size):
        if abs(markov) > 100 * num.size * np.finfo(np.float64).eps * bound:
            break
        num[k] = 0.0
        markov, bound = (c @ column).item(), (np.abs(c) @ reach).item()
        column, reach = a @ column, np.abs(a) @ reach
    return num, np.asarray(den, np.float64)


def _proper(num: Any, den: Any) -> Polynomials:
    """Return numerator and denominator, after a check that they are real and form a proper fraction."""
    num, den = coefficients("num", np.real_if_close(num)), coefficients("den", np.real_if_close(den))
    above, below = (np.trim_zeros(polynomial, "f").size - 1 for polynomial in (num, den))
    if above > below:
        raise InvalidArgumentError(
            f"the system is improper, its numerator has order {above} and its denominator order {below}: "
            "add the poles that the plant has at high frequency"
        )
    return num, den


def _check_single(inputs: int, outputs: int) -> None:
    if (inputs, outputs) != (1, 1):
        raise InvalidArgumentError(
            f"the system must have one input and one output, got {inputs} and {outputs}: choose one pair of them"
        )


def _refuse_discrete(dt: Any) -> None:
    step = "" if dt is True else f" (dt = {float(dt):g} s)"
    raise InvalidArgumentError(f"the system is in discrete time{step}: give a system in continuous time")
