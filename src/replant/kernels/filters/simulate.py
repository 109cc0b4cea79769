"""Simulation of a companion form: states under an input, from rest or going on from a state, and free responses."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def continued_states(transition, taps, inputs, state, first):
    """Return the states (K, n) from ``state`` (n,) on, and leave the last one there.

    w(k) = Ad w(k-1) + taps[0] x(k-2) + taps[1] x(k-1) + taps[2] x(k).  ``inputs`` (K + 2,) begin with x(-2) and x(-1).
    Up to sample ``first`` the states are ``state`` itself: 0 at the beginning of a record, -1 later on.
    """
    n = transition.shape[0]
    states = np.empty((inputs.size - 2, n))
    for k in range(states.shape[0]):
        for i in range(n):
            total = state[i]
            if k > first:
                total = 0.0
                for j in range(n):
                    total += transition[i, j] * state[j]
                for tap in range(3):
                    total += taps[tap, i] * inputs[k + tap]
            states[k, i] = total
        for i in range(n):
            state[i] = states[k, i]
    return states


@njit(cache=True, nogil=True, error_model="numpy")
def filter_states(transition, taps, lag, u):
    """Return the states (K, n) from rest under ``u`` (K,) delayed by ``lag`` samples, zero before the record."""
    inputs = np.zeros(u.size + 2)
    if lag + 2 < inputs.size:
        inputs[lag + 2 :] = u[: u.size - lag]
    return continued_states(transition, taps, inputs, np.zeros(transition.shape[0]), 0)


@njit(cache=True, nogil=True, error_model="numpy")
def free_responses(transition, row, samples):
    """Return row Ad^k (K, n): column i is the output when state i starts at one."""
    n = row.size
    responses = np.empty((samples, n))
    responses[0] = row
    for k in range(1, samples):
        for j in range(n):
            total = 0.0
            for i in range(n):
                total += responses[k - 1, i] * transition[i, j]
            responses[k, j] = total
    return responses
