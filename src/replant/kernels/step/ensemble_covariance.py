"""Samples of each of `LANES` identifiers at once: `step.single`, in SIMD vectors while samples are ordinary.

Each member has its own arrays.  Samples are taken in stretches of a few.  Before a stretch, members for whom no action
is due are copied into lanes (`ensemble_exchange`), where they stay from stretch to stretch.  Vectors then take all
samples of the stretch (`ensemble_ordinary`).  If one of them was not ordinary for a member, that member is reset to the
begin of the stretch and takes its samples again by `single.take_covariance`.  A member for whom an action is due takes
them that way at once.  So a member always gets the bits that it would get alone.
"""

import numpy as np

from replant.kernels.lanes import LANES, member, members, vectors
from replant.kernels.native import Cube, IntMatrix, Ints, Matrix, States, inlined, kernel
from replant.kernels.optimizers.covariance import RECURSIVE_LEAST_SQUARES
from replant.kernels.schema import LAGS
from replant.kernels.step import ensemble, ensemble_ordinary, single, soundness
from replant.kernels.step.ensemble_exchange import enter, is_ordinary, leave, note, prepare, width_of
from replant.kernels.step.ensemble_ordinary import ODD
from replant.kernels.step.stages import mapped_input


def take_alone(s, number, start, end, u, y, errors, parameters):
    """Take the samples of one member alone, until it needs attention; return the row after the last one taken."""
    for k in range(start, end):
        now_u, now_y = u[k, number if u.shape[1] > 1 else 0], y[k, number if y.shape[1] > 1 else 0]
        errors[k, number] = single.take_covariance(s, now_u, now_y, np.nan, np.nan)
        for i in range(parameters.shape[2]):
            parameters[number, k, i] = s.theta[i] * s.unit[i]
        if s.attention:
            return k + 1
    return end


def keep(reals, models, kept, kept_models):
    """Save the content of the lanes."""
    one, other = vectors(reals), vectors(kept)
    for i in range(one.size):
        other[i] = one[i]
    for b in range(2):
        bank, copy = vectors(models)[b], vectors(kept_models)[b]
        for i in range(bank.size):
            copy[i] = bank[i]


def take_vectors(ints, reals, models, work, how, places, samples, width):
    """Take a stretch in vectors; return the newest rows of the two rings after it."""
    beside, companion, tile, estimates = work
    s, banks, own, room = members(ints, reals), vectors(models), vectors(beside), vectors(companion)
    inputs, outputs, told, written = vectors(tile[0]), vectors(tile[1]), vectors(tile[2]), vectors(estimates)
    white, coloured = places
    for k in range(samples):
        inputs[k] = mapped_input(s, inputs[k])
        outputs[k] = outputs[k] - s.output_offset
        white = white + 1 if white < LAGS else 0
        coloured = coloured + 1 if coloured < LAGS - 1 else 0
        told[k] = ensemble_ordinary.take(s, banks, own, (white, coloured), room, how, inputs[k], outputs[k])
        for i in range(width):
            written[k, i] = s.theta[i] * s.unit[i]
    return white, coloured


def deliver(numbers, lane, start, samples, tile, estimates, errors, parameters):
    """Copy errors and estimates of a member to the result arrays."""
    number = numbers[lane]
    for k in range(samples):
        errors[start + k, number] = tile[2, k, lane]
        for i in range(parameters.shape[2]):
            parameters[number, start + k, i] = estimates[k, i, lane]


@inlined
def each_lane(states, ints, reals, models, live, places, samples):
    """Copy members for whom no action is due into their lanes, the others out; return whether any lane is in use."""
    some = False
    for lane in range(live.size):
        own = states[lane]
        if live[lane] == 1:
            if not is_ordinary(member(ints, reals, lane), own, samples):
                leave(own, ints, reals, models, lane, places)
                live[lane] = 0
        elif is_ordinary(own, own, samples):
            enter(own, ints, reals, models, lane, places)
            live[lane] = 1
        some |= live[lane] == 1
    return some


def fits(s, first):
    """Return whether a member can be stepped beside the first: all branches that do not depend on data are equal."""
    same = s.reals.size == first.reals.size and s.ints.size == first.ints.size
    same &= s.entries == first.entries and s.order == first.order and s.input_entries == first.input_entries
    same &= s.memory_size == first.memory_size and s.settings_size == first.settings_size
    same &= s.square_input == first.square_input and s.straight_input == first.straight_input
    same &= s.has_noise_model == first.has_noise_model and s.coloured == first.coloured
    same &= s.rests_with_input == first.rests_with_input and (s.rest_after > 0) == (first.rest_after > 0)
    same &= s.has_constant == first.has_constant and s.ring_size == first.ring_size
    same &= (s.settings[0] < 1.0) == (first.settings[0] < 1.0)
    known = s.examines_output and s.refined and s.instruments and s.algorithm == RECURSIVE_LEAST_SQUARES
    known &= not (s.has_reference or s.collects) and s.delay == 0.0 and s.capacity == 1 and s.batch_size == 1
    return same and known


def are_sound(states):
    """Return whether the arrays of all members are large enough, and they can be stepped side by side."""
    for lane in range(LANES):
        if not (soundness.is_sound(states[lane]) and fits(states[lane], states[0])):
            return False
    return True


def has_room(s, models):
    """Return whether the array has room for two banks of each member."""
    return models.shape[0] == 2 and models.shape[1] >= width_of(s) and models.shape[2] == LANES


@kernel(
    "are_sound(states)",
    "1 <= live.size <= LANES and taken.size == live.size and numbers.size == LANES",
    "ints.shape[0] == LANES and ints.shape[1] == states[0].ints.size and reals.shape[1] == LANES",
    "reals.shape[0] == states[0].reals.size and kept.shape[0] == reals.shape[0] and kept.shape[1] == LANES",
    "has_room(states[0], models) and has_room(states[0], kept_models) and kept_models.shape[1] == models.shape[1]",
    "beside.shape[0] == ensemble_ordinary.BESIDE and beside.shape[1] == LANES",
    "companion.shape[0] > states[0].entries and companion.shape[1] == LANES",
    "tile.shape[0] == 3 and tile.shape[1] >= 1 and tile.shape[2] == LANES",
    "estimates.shape[0] >= tile.shape[1] and estimates.shape[1] == parameters.shape[2] and estimates.shape[2] == LANES",
    "parameters.shape[2] <= states[0].entries and 0 <= start and y.shape[0] == u.shape[0] <= errors.shape[0]",
    "ensemble.are_within(numbers, u, y, errors) and errors.shape[1] <= parameters.shape[0]",
    "parameters.shape[1] >= u.shape[0]",
)
def steps(
    states: States,
    numbers: Ints, live: Ints, taken: Ints, ints: IntMatrix, reals: Matrix,
    kept: Matrix, models: Cube, kept_models: Cube, beside: Matrix, companion: Matrix, tile: Cube, estimates: Cube,
    start: int, u: Matrix, y: Matrix, errors: Matrix, parameters: Cube,
):  # fmt: skip
    """Take the samples from row ``start`` on, up to the stretch in which a member needs attention.

    Returns the row after it.  ``taken`` becomes the row that each member has reached: that one, unless it needs
    attention.

    ``numbers`` (LANES,) are the places of the ``states`` among the M members of the ensemble; states
    beyond the size of ``live`` and ``taken`` are not stepped.  ``u`` and ``y`` have a column for each member, (K, M),
    or one for all, (K, 1); ``errors`` is (K, M), ``parameters`` (M, K, size).

    Work, with the lanes last: ``ints`` (LANES, I), ``reals`` and ``kept`` (N, LANES), ``models`` and ``kept_models``
    (2, B, LANES), ``beside`` (BESIDE, LANES), ``companion`` (T + 1, LANES), ``tile`` (3, R, LANES) and ``estimates``
    (R, size, LANES) for stretches of R samples.
    """
    work = (beside, companion, tile, estimates)
    white, coloured, row, goes_on, forgets = 0, 0, start, True, states[0].settings[0] < 1.0
    for lane in range(LANES):
        enter(states[lane], ints, reals, models, lane, (white, coloured))
        if lane < live.size:
            live[lane] = 0
            taken[lane] = start
    while goes_on and row < u.shape[0]:
        samples = min(tile.shape[1], u.shape[0] - row)
        before, filters = (white, coloured), False
        if each_lane(states, ints, reals, models, live, before, samples):
            keep(reals, models, kept, kept_models)
            ensemble.fetch(u, numbers, row, tile[0, :samples])
            ensemble.fetch(y, numbers, row, tile[1, :samples])
            for lane in range(LANES):
                filters |= prepare(member(ints, reals, lane), beside, lane)
            white, coloured = take_vectors(
                ints, reals, models, work, (filters, forgets), before, samples, parameters.shape[2]
            )
        for lane in range(live.size):
            own, number = states[lane], numbers[lane]
            if live[lane] == 1 and beside[ODD, lane] == 0.0:
                s = member(ints, reals, lane)
                note(own, s, beside, companion, lane, samples, tile[0], tile[1])
                deliver(numbers, lane, row, samples, tile, estimates, errors, parameters)
                taken[lane] = row + samples
            else:
                if live[lane] == 1:
                    leave(own, ints, kept, kept_models, lane, before)
                    live[lane] = 0
                taken[lane] = take_alone(own, number, row, row + samples, u, y, errors, parameters)
                goes_on &= not own.attention
        row += samples
    for lane in range(live.size):
        if live[lane] == 1:
            leave(states[lane], ints, reals, models, lane, (white, coloured))
    return row
