"""Samples of an ensemble on their way into the vectors, and what comes of them on its way back.

A tile holds some hundred samples of `LANES` members, a vector a sample.
"""

from replant.kernels.lanes import LANES, load, prefetch, store, vectors

AHEAD = 16
"""Rows that the memory is asked for before they are copied [count]."""


def are_neighbours(numbers):
    """Say whether the members are one after the other in the ensemble: then so are their numbers in a row."""
    neighbours = True
    for lane in range(LANES):
        neighbours &= numbers[lane] == numbers[0] + lane
    return neighbours


def fetch(samples, numbers, start, own):
    """Copy the members' columns of the samples from a row on, or the one for all."""
    rows, width = vectors(own), samples.shape[1]
    if width == 1:
        for k in range(rows.size):
            rows[k] = samples[start + k, 0]
    elif are_neighbours(numbers):
        for k in range(rows.size):
            ahead = min(start + k + AHEAD, samples.shape[0] - 1)
            prefetch(samples, ahead, numbers[0])
            prefetch(samples, ahead, numbers[LANES - 1])  # their last line
            rows[k] = load(samples, start + k, numbers[0])
    else:
        for k in range(rows.size):
            for lane in range(LANES):
                own[k, lane] = samples[start + k, numbers[lane]]


def deliver(numbers, members, start, told, estimates, errors, parameters):
    """Copy errors and estimates of a tile to where they are wanted."""
    rows = vectors(told)
    if members == LANES and are_neighbours(numbers):
        for k in range(rows.size):
            store(errors, start + k, numbers[0], rows[k])
    else:
        for k in range(rows.size):
            for lane in range(members):
                errors[start + k, numbers[lane]] = told[k, lane]
    if parameters.shape[2] > 0:
        for lane in range(members):
            for k in range(rows.size):
                for i in range(parameters.shape[2]):
                    parameters[numbers[lane], start + k, i] = estimates[k, i, lane]
