"""Simulation of a companion form: states under an input, its output batch by batch, and free responses."""

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def filter_states(transition, taps, lag, u):
    """Return the states (K, n) from rest, u being zero before the record: w(k) = Ad w(k-1) + taps on past inputs."""
    n = transition.shape[0]
    states = np.zeros((u.size, n))
    for k in range(u.size):
        for i in range(n):
            total = 0.0
            if k > 0:
                for j in range(n):
                    total += transition[i, j] * states[k - 1, j]
                for tap in range(3):
                    past = k - lag - 2 + tap
                    if past >= 0:
                        total += taps[tap, i] * u[past]
            states[k, i] = total
    return states


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


@njit(cache=True, nogil=True, error_model="numpy")
def go_on(transition, taps, row, inputs, state, first, output):
    """Fill ``output`` (K,) from where ``state`` (n,) is, which moves along; the sample ``first`` is the state itself.

    ``inputs`` (K + 2,) are those on which the taps of each sample lie.
    """
    n = state.size
    moved = np.empty(n)
    for k in range(output.size):
        if k > first:
            for i in range(n):
                total = 0.0
                for j in range(n):
                    total += transition[i, j] * state[j]
                for tap in range(3):
                    total += taps[tap, i] * inputs[k + tap]
                moved[i] = total
            for i in range(n):
                state[i] = moved[i]
        total = 0.0
        for i in range(n):
            total += row[i] * state[i]
        output[k] = total
