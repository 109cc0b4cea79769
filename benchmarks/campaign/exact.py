"""The response of a transfer function to a held input on any clock: exact, vectorised, and no code of the package."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from replant.numerics.arguments import FloatArray, IntArray

ComplexArray = npt.NDArray[np.complex128]
APART = 1e-6  # least distance of two poles, as a part of their size: partial fractions lose so many digits
SMALL = 1e-5  # of pole times interval: there the series is more exact than the quotient


@dataclass(frozen=True, eq=False)
class Clock:
    """When a held input reaches the plant, between the instants at which the output is wanted.

    Attributes
    ----------
    steps : (E,) array
        Time to the next event, in s.
    u : (E,) array
        What the plant's input is meanwhile.
    at : (K,) array of int
        Events that are outputs.
    """

    steps: FloatArray
    u: FloatArray
    at: IntArray

    @staticmethod
    def of(t: FloatArray, u: FloatArray, delay: float, outputs: FloatArray) -> Clock:
        """Return the clock of an input (K,) held from each stamp to the next, and behind the last.

        Before the first stamp the input is zero.  No output is before the first stamp.
        """
        events = np.unique(np.concatenate([t[:1], t + delay, outputs]))
        events = events[: int(np.searchsorted(events, outputs[-1], "right"))]
        index = np.searchsorted(t, events - delay + 1e-9 * float(np.median(np.diff(t))), "right") - 1
        known = np.where(index >= 0, u[np.maximum(index, 0)], 0.0)
        return Clock(np.diff(events, append=events[-1:]), known, np.searchsorted(events, outputs))


def poles_apart(poles: npt.ArrayLike) -> ComplexArray:
    """Return poles, those that coincide moved apart."""
    poles = np.sort_complex(np.asarray(poles, np.complex128))
    for k in range(1, poles.size):
        size = max(abs(poles[k]), 1e-300)
        if np.abs(poles[:k] - poles[k]).min() < APART * size:
            poles[k] += APART * size * k
    return poles


def states(poles: ComplexArray, clock: Clock) -> ComplexArray:
    """Return the response (n, K) of 1 / (s - pole) for each pole, from rest."""
    grown = poles[:, None] * clock.steps
    factor = np.exp(grown)
    small = np.abs(grown) < SMALL
    held = np.where(small, 1.0 + grown / 2.0, (factor - 1.0) / np.where(small, 1.0, grown)) * clock.steps * clock.u
    return scanned(factor[:, :-1], held[:, :-1])[:, clock.at]


def scanned(factor: ComplexArray, given: ComplexArray) -> ComplexArray:
    """Return x (n, E + 1) with x_0 = 0 and x_{e+1} = factor_e x_e + given_e, in log E passes."""
    factor, x = factor.copy(), given.copy()
    ahead = 1
    while ahead < x.shape[1]:
        x[:, ahead:] += factor[:, ahead:] * x[:, :-ahead]
        factor[:, ahead:] *= factor[:, :-ahead]
        ahead *= 2
    return np.concatenate([np.zeros((x.shape[0], 1), np.complex128), x], axis=1)


def forced(poles: ComplexArray, zeros: int, clock: Clock) -> FloatArray:
    """Return the responses (K, m + 1) of s^m / A to 1 / A, from rest."""
    slopes = np.array([np.prod(pole - np.delete(poles, k)) for k, pole in enumerate(poles)])
    powers = poles[:, None] ** np.arange(zeros, -1, -1) / slopes[:, None]
    return np.asarray((states(poles, clock).T @ powers).real)


def free(poles: ComplexArray, since: FloatArray) -> FloatArray:
    """Return what initial states do (K, n), a time (K,) in s later."""
    columns = []
    for pole in poles:
        if pole.imag >= 0.0:
            grown = np.exp(pole * since)
            columns += [grown.real] if pole.imag == 0.0 else [grown.real, grown.imag]
    return np.column_stack(columns)
