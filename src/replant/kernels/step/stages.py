"""The stages of one sample that every variant of the step kernel uses: checks, the update, what is kept.

    mapped_input, acceptable,       the raw sample: working point, magnitude, an output that is missing
    lacks_output_alone
    note_reference                  the reference of an accepted sample
    cut_estimate, keep_and_write,   the update of the estimate: keep what it changes, write the sample into the buffer,
    draw_rows, undo_unless_finite   draw the batch, (let the optimizer learn it), undo what left float64
    keep_sample, keep_estimate,     what is kept for assessment
    keep_guarded_sample
    renew_model, take_many          general variants: the auxiliary model, and the loop over many samples

`regressors` is the chain of filters alone, for a record.
"""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.filters import chain, whitening
from replant.kernels.monitoring import residual_colour
from replant.kernels.native import LAID_OUT, Ints, Matrix, Reals, inlined, kernel
from replant.kernels.optimizers.random_stream import draw_below
from replant.kernels.schema import LAGS, Doubt

KEEP_AFTER_PART = 8
"""Part by which the samples must have grown until the estimate is kept again [part: one in so many].
Derivation: of the four kept the oldest lies then three to four of these steps back, so that a quarter to a third of
all samples, and later three to four times PAST_STEP, are held out from it.
Sensitivity: halved or doubled, no verdict changes, and no error by a quarter.
"""

KEEP_AFTER_LEAST = 32
"""Samples between two past estimates kept, at the least [samples].
Derivation: four of them, as many as are kept, span more samples than a test needs.
Sensitivity: halved, nothing changes on these records; doubled, no verdict changes, and no error by a quarter.
"""

FEW = 16
"""Numbers up to which they are looked at one by one: just written one by one, they cannot be read as vectors before
they have all reached the cache, for which everything after would wait [count].
"""


@inlined
def mapped_input(ints, reals, u):
    """Return the input as the filters see it, u or u^2 less the working point; ``u`` and ``reals`` may be vectors."""
    return (u * u if ints[at.SQUARE_INPUT] == 1 else u) - reals[at.INPUT_OFFSET]


@inlined
def acceptable(ints, u, y):
    """Return whether input and output are finite and small enough for float64; count a sample that is not."""
    if abs(u) <= at.LARGEST and abs(y) <= at.LARGEST:
        return True
    if math.isfinite(u) and math.isfinite(y):
        ints[at.TOO_LARGE] += 1
    else:
        ints[at.NOT_FINITE] += 1
    return False


def lacks_output_alone(ints, u, y):
    """Return whether a sample that was turned away has an input that can be used, and no output."""
    if not (math.isnan(y) and abs(u) <= at.LARGEST):
        return False
    ints[at.NOT_FINITE] -= 1
    return True


def note_reference(ints, reals, r):
    """Take the reference of an accepted sample; of one that is not finite or too large, the last."""
    if abs(r) <= at.LARGEST:
        reals[at.REFERENCE_NOW] = r
    else:
        ints[at.NO_REFERENCE] += 1


@inlined
def may_learn(ints, reals):
    """Say whether the user has not frozen the estimate, and the filters have settled after a gap."""
    return not (ints[at.ADAPT] == 0 or reals[at.ELAPSED] < reals[at.LEARN_FROM])


@inlined
def cut_estimate(ints, reals):
    """Return what is learned, and with what.

    theta (T,) and the optimizer's memory (M,); both as they were before the newest sample; phi (T,); the unit of
    theta (T,); the optimizer's settings (S,); the drawn rows (BATCH,).
    """
    T, M, S = ints[at.ENTRIES], ints[at.MEMORY_SIZE], ints[at.SETTINGS_SIZE]
    theta, memory, backup = ints[at.AT_THETA], ints[at.AT_MEMORY], ints[at.AT_BACKUP]
    phi, unit, settings = ints[at.AT_PHI], ints[at.AT_UNIT], ints[at.AT_SETTINGS]
    return (
        reals[theta : theta + T],
        reals[memory : memory + M],
        reals[backup : backup + T],
        reals[backup + T : backup + T + M],
        reals[phi : phi + T],
        reals[unit : unit + T],
        reals[settings : settings + S],
        ints[at.ROWS : at.ROWS + ints[at.BATCH_SIZE]],
    )


@inlined
def keep_and_write(ints, row, estimate, target):
    """Keep the estimate as it is and write a sample into its row of the buffer; return the a-priori error, scaled.

    ``row`` becomes [phi (T,), target, 1/m^2], m^2 = 1 + phi' phi where updates are normalised.  In one pass: for a few
    parameters to begin a loop takes longer than to run it.
    """
    theta, memory, kept_theta, kept_memory, phi = estimate[:5]
    T, squares, error = phi.size, 0.0, target
    for i in range(phi.size):
        entry, parameter = phi[i], theta[i]
        row[i], kept_theta[i] = entry, parameter
        squares += entry * entry
        error -= parameter * entry
    row[T] = target
    row[T + 1] = 1.0 / (1.0 + squares) if ints[at.NORMALIZE] == 1 else 1.0
    for i in range(memory.size):
        kept_memory[i] = memory[i]
    return error


@inlined
def draw_rows(ints, rows):
    """Draw the rows of the newest sample's batch into ``rows``, and move on in the buffer; return how many."""
    head, capacity = ints[at.BUFFER_HEAD], ints[at.CAPACITY]
    ints[at.BUFFER_HEAD] = head + 1 if head + 1 < capacity else 0
    filled = min(ints[at.BUFFER_FILLED] + 1, capacity)
    ints[at.BUFFER_FILLED] = filled
    batch = ints[at.BATCH_SIZE] if filled > ints[at.WARMUP] else 1
    seed, drawn = ints[at.SEED], ints[at.DRAWN]
    for i in range(batch - 1):
        rows[i] = draw_below(seed, drawn + i, filled)
    rows[batch - 1] = head
    ints[at.DRAWN] = drawn + batch - 1
    return batch


def remember(ints, reals, buffer, target):
    """Keep the estimate, store the sample in the buffer and draw the rows of its batch; return how many.

    With instruments zeta (T,) lies behind the row of `keep_and_write`, and m^2 = 1 + zeta' zeta: the noise of phi would
    correlate with it.  Once the buffer is full the newest sample takes the place of the oldest: Algorithm 3 of the
    article, mended; as printed it takes the buffer for empty again each time the index wraps.
    """
    T, row, estimate = ints[at.ENTRIES], buffer[ints[at.BUFFER_HEAD]], cut_estimate(ints, reals)
    keep_and_write(ints, row, estimate, target)
    if ints[at.INSTRUMENTS] == 1:
        zeta, companion = reals[ints[at.AT_ZETA] : ints[at.AT_ZETA] + T], row[T + 2 :]
        squares = 0.0
        for i in range(zeta.size):
            companion[i] = zeta[i]
            squares += zeta[i] * zeta[i]
        row[T + 1] = 1.0 / (1.0 + squares) if ints[at.NORMALIZE] == 1 else 1.0
    return draw_rows(ints, estimate[7])


def direction_of(ints):
    """Return the column of the buffer where the vector begins that updates follow: that of zeta, or of phi."""
    return ints[at.ENTRIES] + 2 if ints[at.INSTRUMENTS] == 1 else 0


def all_finite(size, numbers):
    """Say whether so many numbers are finite."""
    if size <= FEW:
        for i in range(size):
            if not math.isfinite(numbers[i]):
                return False
        return True
    finite = True
    for i in range(size):  # no return from within: a loop that runs to its end is vectorised
        finite &= math.isfinite(numbers[i])
    return finite


@inlined
def left_float64(theta, unit, memory):
    """Say whether a physical parameter, or a number of the optimizer's memory, is not finite."""
    for i in range(theta.size):
        if not math.isfinite(theta[i] * unit[i]):
            return True
    return memory.size > 0 and not all_finite(memory.size, memory)


@inlined
def undo_unless_finite(ints, estimate):
    """Undo an update that left float64, and count it."""
    theta, memory, kept_theta, kept_memory, _, unit, _, _ = estimate
    if left_float64(theta, unit, memory):
        ints[at.REFUSED] += 1
        for i in range(theta.size):
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            memory[i] = kept_memory[i]


def update_estimate(ints, reals, buffer, target, interval, learn):
    """Let ``learn`` consume the newest sample, whose scaled target this is, and its batch: the general variants."""
    batch = remember(ints, reals, buffer, target)
    learn(ints, reals, buffer, batch, interval)
    undo_unless_finite(ints, cut_estimate(ints, reals))
    ints[at.LEARNED] = ints[at.SAMPLES]


def keep_estimate(ints, reals):
    """Keep the estimate as it is now, in the place of the oldest one kept: later samples are held out from it."""
    T, samples = ints[at.ENTRIES], ints[at.SAMPLES]
    theta = reals[ints[at.AT_THETA] : ints[at.AT_THETA] + T]
    row = ints[at.AT_PAST] + (ints[at.PAST_KEPT] % at.PAST) * (1 + T)
    kept = reals[row + 1 : row + 1 + T]
    reals[row] = samples
    for i in range(theta.size):
        kept[i] = theta[i]
    ints[at.PAST_KEPT] += 1
    ints[at.PAST_DUE] = samples + min(max(samples // KEEP_AFTER_PART, KEEP_AFTER_LEAST), ints[at.PAST_STEP])


@inlined
def keep_sample(ints, recent, u, y, interval):
    """Keep the raw sample, over the oldest one."""
    head = ints[at.RECENT_HEAD]
    row = recent[head]
    row[0], row[1], row[2] = u, y, interval
    ints[at.RECENT_HEAD] = head + 1 if head + 1 < ints[at.RECENT_SIZE] else 0


def keep_guarded_sample(ints, reals, recent, u, y, interval):
    """Keep the raw sample, over the oldest one, with the output that the filters saw and why.

    Where there is no output, what the filters saw stands for it; where no reference came, the last one.
    """
    head = ints[at.RECENT_HEAD]
    row = recent[head]
    row[at.INPUT], row[at.STEP] = u, interval
    row[at.OUTPUT] = reals[at.USED_OUTPUT] if ints[at.DOUBT] == Doubt.MISSING else y
    row[at.BRIDGED], row[at.DOUBTED] = reals[at.USED_OUTPUT], ints[at.DOUBT]
    if ints[at.HAS_REFERENCE] == 1:
        row[at.REFERENCE] = reals[at.REFERENCE_NOW]
    ints[at.RECENT_HEAD] = head + 1 if head + 1 < ints[at.RECENT_SIZE] else 0


def renew_model(ints, reals, banks):
    """Make the newest estimate the auxiliary model where that is due, and renew what is known of the noise with it."""
    if chain.renew_model(ints, reals, banks):
        if ints[at.HAS_NOISE_MODEL] == 1:
            whitening.renew(ints, reals)
        colour = ints[at.AT_COLOUR]
        if ints[at.COLOURED] == 1:
            residual_colour.autoregression(
                reals[colour + residual_colour.COVARIANCES : colour + residual_colour.COVARIANCES + LAGS + 1],
                reals[colour + residual_colour.MODEL : colour + residual_colour.MODEL + LAGS + 1],
                reals[ints[at.AT_WORK] :],
            )


def take_many(ints, reals, banks, buffer, recent, u, y, t, r, errors, parameters, take):
    """Take samples by ``take``, until the identifier has work to do; return how many.

    ``u`` and ``y`` are (K,); ``t`` (K,) are time stamps in s, or it is empty where the clock is regular; ``r`` (K,) is
    the reference, or empty where there is none.  Writes ``errors`` (K,), in the unit of y, and ``parameters`` (K, P),
    the estimate after each sample in physical units.
    """
    theta, unit = ints[at.AT_THETA], ints[at.AT_UNIT]
    for k in range(u.size):
        stamp = t[k] if t.size > 0 else np.nan
        reference = r[k] if r.size > 0 else np.nan
        errors[k] = take(ints, reals, banks, buffer, recent, u[k], y[k], stamp, reference)
        for i in range(parameters.shape[1]):
            parameters[k, i] = reals[theta + i] * reals[unit + i]
        if ints[at.ATTENTION] == 1:
            return k + 1
    return u.size


@kernel(
    LAID_OUT,
    "y.size >= u.size and target.size >= u.size and output.size >= u.size",
    "intervals.size == 1 or intervals.size >= u.size",
    "by_reference.shape[0] == 0 or (by_reference.shape[0] >= u.size and by_reference.shape[1] >= 2)",
    "phi.shape[0] >= u.size and phi.shape[1] >= ints[at.ENTRIES]",
    "ints[at.INSTRUMENTS] == 0 or (zeta.shape[0] >= u.size and zeta.shape[1] >= ints[at.ENTRIES])",
)
def regressors(
    ints: Ints, reals: Reals, banks: Matrix, u: Reals, y: Reals, intervals: Reals, by_reference: Matrix, phi: Matrix,
    zeta: Matrix, target: Reals, output: Reals,
):  # fmt: skip
    """Run the chain alone over a record, for offline use: regressors, instruments, target, auxiliary output.

    ``u`` and ``y`` are (K,), ``intervals`` (K,) or (1,) in s; ``by_reference`` (K, 2) is what a reference explains of
    them, or (0, 2) where there is none.  Writes ``phi`` and ``zeta`` (K, T), ``target`` (K,),
    scaled, and ``output`` (K,) in the unit of y.  Rows of rejected samples are NaN.  ``zeta`` and ``output`` are left
    alone where there are no instruments.
    """
    T = ints[at.ENTRIES]
    regular = intervals.size == 1
    for k in range(u.size):
        interval = intervals[0] if regular else intervals[k]
        uk, yk = mapped_input(ints, reals, u[k]), y[k] - reals[at.OUTPUT_OFFSET]
        if by_reference.shape[0] > 0:
            reals[at.INPUT_BY_REFERENCE], reals[at.OUTPUT_BY_REFERENCE] = by_reference[k, 0], by_reference[k, 1]
        if acceptable(ints, uk, yk):
            target[k] = chain.observe(ints, reals, banks, uk, yk, interval)
            for i in range(T):
                phi[k, i] = reals[ints[at.AT_PHI] + i]
                if ints[at.INSTRUMENTS] == 1:
                    zeta[k, i] = reals[ints[at.AT_ZETA] + i]
            if ints[at.INSTRUMENTS] == 1:
                output[k] = banks[ints[at.SERVING_BANK], bk.MODEL_OUTPUT]
        else:
            target[k] = np.nan
            for i in range(T):
                phi[k, i] = np.nan
