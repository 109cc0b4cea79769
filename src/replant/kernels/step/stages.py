"""The stages of one sample that all variants of the step kernel share: checks, the update, the samples kept.

`regressors` runs the chain of filters alone over a record; `unroll` and `variance` read the samples kept, as a whole.
"""

import math

import numpy as np

from replant.kernels import schema as at
from replant.kernels.filters import autoregressions, chain
from replant.kernels.filters import bank as bk
from replant.kernels.lanes import copy
from replant.kernels.monitoring import scatter
from replant.kernels.native import LAID_OUT, Matrix, Reals, in_turn, inlined, kernel
from replant.kernels.optimizers.gradient import telling_part
from replant.kernels.optimizers.memory import draw_below
from replant.kernels.schema import DOUBTED, INPUT, OUTPUT, STEP, Doubt, StateSlots

# the oldest of the four kept is then three to four steps old: a quarter to a third of all samples, and later three to
# four times PAST_STEP, are held out from it
KEEP_AFTER_PART = 8  # an estimate is kept each time the samples have grown by 1 / 8 [reciprocal share]
# four estimates are kept: four of these steps span more samples than a test needs
KEEP_AFTER_LEAST = 32  # least number of samples between two past estimates kept [samples]
# a vector load of numbers just stored one by one would stall until all stores have reached the cache
FEW = 16  # up to this many numbers are read one by one [count]


@inlined
def mapped_input(s, u):
    """Return the input of the filters, u or u^2 less the working point; ``u`` and the state may be vectors."""
    return (u * u if s.square_input else u) - s.input_offset


@inlined
def acceptable(s, u, y):
    """Return whether input and output are finite and small enough for float64; count a rejected sample."""
    if abs(u) <= at.LARGEST and abs(y) <= at.LARGEST:
        return True
    if math.isfinite(u) and math.isfinite(y):
        s.too_large += 1
    else:
        s.not_finite += 1
    return False


def lacks_output_alone(s, u, y):
    """Return whether a rejected sample has a usable input and no output; if so, it no longer counts as rejected."""
    if not (math.isnan(y) and abs(u) <= at.LARGEST):
        return False
    s.not_finite -= 1
    return True


def note_reference(s, r):
    """Take the reference of an accepted sample; keep the previous one if it is not finite or too large."""
    if abs(r) <= at.LARGEST:
        s.reference_now = r
    else:
        s.no_reference += 1


@inlined
def may_learn(s):
    """Return whether the estimate is not frozen by the user, and the filters have settled after a gap."""
    return s.adapt and not s.elapsed < s.learn_from


@inlined
def cut_estimate(s):
    """Return the arrays of an update.

    theta (T,) and the optimizer's memory (M,); copies of both from before the newest sample; phi (T,); the unit of
    theta (T,); the optimizer's settings (S,); the drawn rows (BATCH,).
    """
    T, M = s.entries, s.memory_size
    return s.theta, s.memory, s.backup[:T], s.backup[T : T + M], s.phi, s.unit, s.settings, s.rows


@inlined
def keep_and_write(s, row, estimate, target):
    """Save the estimate and write a sample into its row of the buffer; return the a-priori error, scaled.

    ``row`` becomes [phi (T,), target, 1/m^2], with m^2 = 1 + phi' phi if updates are normalised, else 1.  All in one
    loop: with few parameters the start of a loop costs more than its passes.
    """
    theta, memory, kept_theta, kept_memory, phi = estimate[:5]
    T, squares, error = phi.size, 0.0, target
    for i in range(phi.size):
        entry, parameter = phi[i], theta[i]
        row[i], kept_theta[i] = entry, parameter
        squares += entry * entry
        error -= parameter * entry  # epsilon of (12)
    row[T] = target
    row[T + 1] = 1.0 / (1.0 + squares) if s.normalize else 1.0  # 1 / m^2 of (13)
    if memory.size > FEW:
        copy(kept_memory, memory)
    else:
        for i in range(memory.size):
            kept_memory[i] = memory[i]
    return error


@inlined
def draw_rows(s, rows):
    """Draw the rows of the newest sample's batch into ``rows``, and advance in the buffer; return their number."""
    head, capacity = s.buffer_head, s.capacity
    s.buffer_head = head + 1 if head + 1 < capacity else 0
    filled = min(s.buffer_filled + 1, capacity)
    s.buffer_filled = filled
    batch = s.batch_size if filled > s.warmup else 1
    seed, drawn = s.seed, s.drawn
    for i in in_turn(0, batch - 1):  # not all processors have vectors of 64-bit products
        rows[i] = draw_below(seed, drawn + i, filled)
    rows[batch - 1] = head
    s.drawn = drawn + batch - 1
    return batch


def remember(s, target):
    """Save the estimate, store the sample in the buffer and draw the rows of its batch; return their number.

    With instruments, zeta (T,) follows the row of `keep_and_write`, and m^2 = 1 + zeta' zeta: 1 + phi' phi would
    correlate with the noise.  A full buffer replaces its oldest sample.  This corrects Algorithm 3 of the article: as
    printed it treats the buffer as empty each time the index wraps.
    """
    T, row, estimate = s.entries, s.buffer[s.buffer_head], cut_estimate(s)
    keep_and_write(s, row, estimate, target)
    if s.instruments:
        zeta, companion = s.zeta, row[T + 2 :]
        squares = 0.0
        for i in range(zeta.size):
            companion[i] = zeta[i]
            squares += zeta[i] * zeta[i]
        row[T + 1] = 1.0 / (1.0 + squares) if s.normalize else 1.0
    return draw_rows(s, estimate[7])


def direction_of(s):
    """Return the first column in the buffer of the vector that updates follow: zeta, or phi without instruments."""
    return s.entries + 2 if s.instruments else 0


def all_finite(size, numbers):
    """Return whether the first ``size`` numbers are finite."""
    if size <= FEW:
        for i in range(size):
            if not math.isfinite(numbers[i]):
                return False
        return True
    finite = True
    for i in range(size):  # no early return: only a loop that runs to its end is vectorised
        finite &= math.isfinite(numbers[i])
    return finite


@inlined
def left_float64(theta, unit, telling):
    """Return whether a physical parameter or the optimizer's memory is not finite: see `telling_part`."""
    for i in range(theta.size):
        if not math.isfinite(theta[i] * unit[i]):
            return True
    return telling.size > 0 and not all_finite(telling.size, telling)


@inlined
def undo_unless_finite(s, estimate):
    """Undo an update that overflowed, and count it."""
    theta, memory, kept_theta, kept_memory, _, unit, _, _ = estimate
    if left_float64(theta, unit, telling_part(s.algorithm, theta.size, memory)):
        s.refused += 1
        for i in range(theta.size):
            theta[i] = kept_theta[i]
        for i in range(memory.size):
            memory[i] = kept_memory[i]


def update_estimate(s, target, interval, learn):
    """Learn the newest sample, with this scaled ``target``, and its batch; ``learn`` is the optimizers' function."""
    batch, estimate = remember(s, target), cut_estimate(s)
    theta, memory, _, _, _, _, settings, rows = estimate
    learn(s.algorithm, theta, memory, settings, s.buffer, rows, batch, direction_of(s), interval)
    undo_unless_finite(s, estimate)
    s.learned = s.samples


def keep_estimate(s):
    """Keep the present estimate in place of the oldest one kept: later samples are held out from it."""
    samples = s.samples
    kept = s.past_kept % at.PAST
    s.past[kept, 0] = samples
    for i in range(s.entries):
        s.past[kept, 1 + i] = s.theta[i]
    s.past_kept += 1
    s.past_due = samples + min(max(samples // KEEP_AFTER_PART, KEEP_AFTER_LEAST), s.past_step)


@inlined
def keep_sample(s, recent, u, y, interval):
    """Store the raw sample in place of the oldest one."""
    head = s.recent_head
    row = recent[head]
    row[0], row[1], row[2] = u, y, interval
    s.recent_head = head + 1 if head + 1 < s.recent_size else 0


def keep_guarded_sample(s, u, y, interval):
    """Store the raw sample as `keep_sample` does, with the output that the filters saw, the doubt, the reference."""
    row = s.recent[s.recent_head]
    row[at.BRIDGED], row[at.DOUBTED] = s.used_output, s.doubt
    if s.has_reference:
        row[at.REFERENCE] = s.reference_now
    # a missing output is stored as the one that the filters saw
    keep_sample(s, s.recent, u, s.used_output if s.doubt == Doubt.MISSING else y, interval)


def renew_model(s):
    """If due, make the newest estimate the auxiliary model, and renew the noise models with it."""
    if chain.renew_model(s):
        if s.has_noise_model:
            autoregressions.renew(s)
        if s.coloured:
            scatter.autoregression(s.colour.covariances, s.colour.model, s.work)


def take_many(s, u, y, t, r, errors, parameters, take):
    """Take samples by ``take`` until the identifier needs attention; return how many were taken.

    ``u`` and ``y`` are (K,); ``t``, stamps in s, and ``r``, references, are (K,) or empty.  Writes ``errors`` (K,), in
    the unit of y, and ``parameters`` (K, P), the estimate after each sample in physical units.
    """
    for k in range(u.size):
        stamp = t[k] if t.size > 0 else np.nan
        reference = r[k] if r.size > 0 else np.nan
        errors[k] = take(s, u[k], y[k], stamp, reference)
        for i in range(parameters.shape[1]):
            parameters[k, i] = s.theta[i] * s.unit[i]
        if s.attention:
            return k + 1
    return u.size


@kernel(
    LAID_OUT,
    "y.size >= u.size and target.size >= u.size and output.size >= u.size",
    "intervals.size == 1 or intervals.size >= u.size",
    "by_reference.shape[0] == 0 or (by_reference.shape[0] >= u.size and by_reference.shape[1] >= 2)",
    "phi.shape[0] >= u.size and phi.shape[1] >= s.entries",
    "not s.instruments or (zeta.shape[0] >= u.size and zeta.shape[1] >= s.entries)",
)
def regressors(
    s: StateSlots, u: Reals, y: Reals, intervals: Reals, by_reference: Matrix, phi: Matrix,
    zeta: Matrix, target: Reals, output: Reals,
):  # fmt: skip
    """Run the chain alone over a record, for offline use: regressors, instruments, target, auxiliary output.

    ``u`` and ``y`` are (K,), ``intervals`` (K,) or (1,) in s; ``by_reference`` (K, 2) is the part of each that a
    reference explains, or (0, 2) without one.  Writes ``phi`` and ``zeta`` (K, T), ``target`` (K,), scaled, and
    ``output`` (K,) in the unit of y.  ``phi`` and ``target`` are NaN for rejected samples.  ``zeta`` and ``output`` are
    written only with instruments, and not for rejected samples.
    """
    T = s.entries
    regular = intervals.size == 1
    for k in range(u.size):
        interval = intervals[0] if regular else intervals[k]
        uk, yk = mapped_input(s, u[k]), y[k] - s.output_offset
        if by_reference.shape[0] > 0:
            s.input_by_reference, s.output_by_reference = by_reference[k, 0], by_reference[k, 1]
        if acceptable(s, uk, yk):
            target[k] = chain.observe(s, uk, yk, interval)
            for i in range(T):
                phi[k, i] = s.phi[i]
                if s.instruments:
                    zeta[k, i] = s.zeta[i]
            if s.instruments:
                output[k] = s.banks[s.serving_bank, bk.MODEL_OUTPUT]
        else:
            target[k] = np.nan
            for i in range(T):
                phi[k, i] = np.nan


def place_of(ring, end, rows, i):
    """Return the place of the i-th of the newest ``rows`` rows, which end before ``end``."""
    k = end - rows + i
    return k if k >= 0 else k + ring.shape[0]


@kernel("ring.shape[0] >= u.size and 0 <= end <= ring.shape[0] and y.size == u.size and ring.shape[1] > STEP")
def unroll(ring: Matrix, end: int, dt: float, u: Reals, y: Reals):
    """Write the newest inputs and outputs (K,) of a ring, oldest first, up to the row before ``end``.

    Return how many of them came after another interval than ``dt``, or without an output.
    """
    odd = 0
    for i in range(u.size):
        k = place_of(ring, end, u.size, i)
        u[i], y[i] = ring[k, INPUT], ring[k, OUTPUT]
        if not math.isfinite(y[i]) or (i > 0 and ring[k, STEP] != dt):
            odd += 1
        elif ring.shape[1] > DOUBTED and ring[k, DOUBTED] == Doubt.MISSING:
            odd += 1
    return odd


@kernel("0 < rows <= ring.shape[0] and 0 <= end <= ring.shape[0] and 0 <= column < ring.shape[1]")
def variance(ring: Matrix, end: int, rows: int, column: int):
    """Return the variance of a column in the newest rows of a ring, up to that before ``end``."""
    mean, total = 0.0, 0.0
    for i in range(rows):
        mean += ring[place_of(ring, end, rows, i), column]
    mean /= rows
    for i in range(rows):
        away = ring[place_of(ring, end, rows, i), column] - mean
        total += away * away
    return total / rows
