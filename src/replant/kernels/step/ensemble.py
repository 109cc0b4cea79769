"""One sample of each of `LANES` identifiers at once: `fixed_filter`, in SIMD vectors.

The arrays are those of one identifier (see `kernels.schema`), stacked.  The member axis is the last one, so that a
quantity of all members is one vector; in ``ints`` it is the first.  The arithmetic is that of `fixed_filter` and
`optimizers.gradient`, on vectors (see `kernels.lanes`).  A member gets the same bits from either kernel, and each
kernel can continue from the state of the other.

Members are level as long as no member rejects a sample that others accept; the first member then counts for all.  Level
members with equal random streams draw the same rows, which are read in place.  Otherwise every member draws its own
rows, and the batch is gathered first.

A member whose sample is rejected takes its previous sample again, to keep the vectors full, and is then restored.
Samples come in tiles of some hundred, one vector a sample.  `ensemble_members` has the work of single members, and
learning.
"""

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.lanes import LANES, all_within, load, member, members, prefetch, store, vectors
from replant.kernels.monitoring.outliers import equation_error
from replant.kernels.native import Cube, IntMatrix, Ints, Matrix, inlined, kernel
from replant.kernels.step import ensemble_members, fixed_filter, soundness
from replant.kernels.step.stages import cut_estimate, mapped_input

AHEAD = 16  # rows by which prefetching runs ahead of copying [count]


def are_neighbours(numbers):
    """Return whether the members have consecutive numbers: then their samples are contiguous in a row."""
    neighbours = True
    for lane in range(LANES):
        neighbours &= numbers[lane] == numbers[0] + lane
    return neighbours


def fetch(samples, numbers, start, own):
    """Copy the samples of the members from row ``start`` on: a column each, or one column for all."""
    rows, width = vectors(own), samples.shape[1]
    if width == 1:
        for k in range(rows.size):
            rows[k] = samples[start + k, 0]
    elif are_neighbours(numbers):
        for k in range(rows.size):
            ahead = min(start + k + AHEAD, samples.shape[0] - 1)
            prefetch(samples, ahead, numbers[0])
            prefetch(samples, ahead, numbers[LANES - 1])  # the last cache line of the row
            rows[k] = load(samples, start + k, numbers[0])
    else:
        for k in range(rows.size):
            for lane in range(LANES):
                own[k, lane] = samples[start + k, numbers[lane]]


def deliver(numbers, members, start, told, estimates, errors, parameters):
    """Copy errors and estimates of a tile to the result arrays."""
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


@inlined
def take(arrays, s, apart, shared, work, cuts, u, y):
    """Take one admitted sample of each member; ``shared``: all draw the same rows.

    ``s`` has the fields of all members; ``cuts`` are filters, regressor and estimate as cut by `fixed_filter`.  Returns
    the errors, and for each member 0 if its new numbers are finite, else NaN.
    """
    filters, regressor, estimate = cuts
    s.elapsed += s.interval
    fixed_filter.advance_filters(s, filters, s.input_now, u, y)
    s.last_output = y
    target = fixed_filter.fill_regressor(s, regressor, y)
    bk.settle(filters[3], filters[4])
    if s.adapt:
        error, finite = ensemble_members.update_estimate(arrays, s, apart, shared, work, estimate, target)
    else:
        error, finite = equation_error(s, target), 0.0 * y
    return error * s.output_scale, finite


def take_tile(arrays, apart, work, u, y, errors, parameters):
    """Take the samples of a tile: each row of ``u``, ``y``, ``errors`` and ``parameters`` belongs to one sample."""
    ints, reals, banks, _, recent = arrays
    s, b, written, live = members(ints, reals), vectors(banks), vectors(parameters), work[0]
    inputs, outputs, told = vectors(u), vectors(y), vectors(errors)
    place, estimate = bk.at_kept(s.order, s.entries), cut_estimate(s)
    # the regular clock's discretisation is the bank's first
    cuts = fixed_filter.cut_filters(s, b[0], place), fixed_filter.cut_regressor(s, b[0]), estimate
    theta, unit, aside = estimate[0], estimate[5], s.work[2 * s.order :]
    rings, level = (s.inputs, s.held, s.intervals), ensemble_members.are_level(ints, reals)
    for lane in range(LANES):
        live[lane] = 1
    for k in range(inputs.size):
        now_u, now_y = mapped_input(s, inputs[k]), outputs[k] - s.output_offset
        if level and not (all_within(now_u, at.LARGEST) and all_within(now_y, at.LARGEST)):
            ensemble_members.spread(ints, reals)
            level = False
        if level:
            ensemble_members.admit(s, rings, vectors(recent), now_u, now_y)
        else:
            aside[ensemble_members.INPUT], aside[ensemble_members.OUTPUT] = now_u, now_y
            ensemble_members.admit_each(ints, reals, banks, recent, live)
            now_u, now_y = aside[ensemble_members.INPUT], aside[ensemble_members.OUTPUT]
        error, finite = take(arrays, s, apart, level and not apart, work, cuts, now_u, now_y)
        if not (level and all_within(finite, 0.0)):
            aside[ensemble_members.ERROR], aside[ensemble_members.FINITE] = error, finite
            ensemble_members.undo(ints, reals, banks, live)
            error = aside[ensemble_members.ERROR]
        if not level:
            ensemble_members.count_each(ints, reals, live, False)
        elif ensemble_members.count(s):
            ensemble_members.spread(ints, reals)
            ensemble_members.count_each(ints, reals, live, True)
        told[k] = error
        for i in range(written.shape[1]):
            written[k, i] = theta[i] * unit[i]
    if level:
        ensemble_members.spread(ints, reals)


def are_sound(ints, reals, banks, buffer, recent, apart):
    """Return whether the arrays are large enough for the sizes that each member states."""
    if reals.shape[0] < at.SCALARS or banks.shape[0] < 3 or (buffer.shape[0] if apart else buffer.shape[2]) != LANES:
        return False
    rows, width = buffer.shape[1] if apart else buffer.shape[0], buffer.shape[2] if apart else buffer.shape[1]
    for lane in range(LANES):
        s, first = member(ints, reals, lane), member(ints, reals, 0)
        if not soundness.is_laid_out(s, reals.shape[0], banks.shape[0], banks.shape[1]) or s.instruments or s.collects:
            return False
        if not (soundness.holds_rows(s, rows, width, recent.shape[0], recent.shape[1]) and soundness.is_known(s)):
            return False
        if not (s.entries == first.entries and s.order == first.order and s.batch_size == first.batch_size):
            return False
    return True


def are_within(numbers, u, y, errors):
    """Return whether the numbers are those of members, and the samples have one column or one a member."""
    for lane in range(LANES):
        if not 0 <= numbers[lane] < errors.shape[1]:
            return False
    return (u.shape[1] == 1 or u.shape[1] == errors.shape[1]) and (y.shape[1] == 1 or y.shape[1] == errors.shape[1])


@kernel(
    "ints.shape[0] == LANES and reals.shape[1] == LANES and banks.shape[2] == LANES and recent.shape[2] == LANES",
    "are_sound(ints, reals, banks, buffer, recent, apart)",
    "live.size >= LANES and picked.size >= LANES and numbers.size >= LANES and 1 <= members <= LANES",
    "order.size == member(ints, reals, 0).batch_size and drawn.shape[0] == order.size",
    "drawn.shape[1] == (buffer.shape[2] if apart else buffer.shape[1]) and drawn.shape[2] == LANES",
    "spare.shape[0] >= member(ints, reals, 0).entries + member(ints, reals, 0).memory_size and spare.shape[1] == LANES",
    "tile.shape[0] == 3 and tile.shape[1] >= 1 and tile.shape[2] == LANES",
    "estimates.shape[0] >= tile.shape[1] and estimates.shape[1] == parameters.shape[2]",
    "parameters.shape[2] <= member(ints, reals, 0).entries",
    "estimates.shape[2] == LANES and 0 <= start and y.shape[0] == u.shape[0] <= errors.shape[0]",
    "are_within(numbers, u, y, errors) and errors.shape[1] <= parameters.shape[0]",
    "parameters.shape[1] >= u.shape[0]",
)
def steps(
    ints: IntMatrix, reals: Matrix, banks: Cube, buffer: Cube, recent: Cube, apart: bool, live: Ints, drawn: Cube,
    order: Ints, picked: Ints, spare: Matrix, tile: Cube, estimates: Cube, numbers: Ints, members: int, start: int,
    u: Matrix, y: Matrix, errors: Matrix, parameters: Cube,
):  # fmt: skip
    """Take the samples from row ``start`` on; write error and estimate (physical units) of each member.

    If ``apart``, the members have random streams of their own, and ``buffer`` has the member axis first, so that a row
    of one member is contiguous.

    ``numbers`` (LANES,) are the places of the members among the M of the ensemble; lanes beyond ``members`` repeat the
    first.  ``u`` and ``y`` have a column for each member, (K, M), or one for all, (K, 1); ``errors`` is (K, M),
    ``parameters`` (M, K, size).

    Work: ``live`` (LANES,); ``drawn`` (BATCH, WIDTH, LANES), the drawn rows of the buffer; ``order`` (BATCH,), 0, 1, 2,
    ...; ``picked`` (LANES,); ``spare`` (T + M, LANES).  ``tile`` (3, R, LANES) and ``estimates`` (R, size, LANES) are
    for R samples at once.  Copying many rows ahead is faster than reading them one by one: the copies overlap, while a
    step waits for its input.
    """
    arrays, work = (ints, reals, banks, buffer, recent), (live, drawn, order, picked, spare)
    for row in range(start, u.shape[0], tile.shape[1]):
        rows = min(tile.shape[1], u.shape[0] - row)
        own_u, own_y, told = tile[0, :rows], tile[1, :rows], tile[2, :rows]
        fetch(u, numbers, row, own_u)
        fetch(y, numbers, row, own_y)
        take_tile(arrays, apart, work, own_u, own_y, told, estimates[:rows])
        deliver(numbers, members, row, told, estimates, errors, parameters)
