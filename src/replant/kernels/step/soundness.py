"""Check, before a compiled kernel runs, that the arrays of a state are as long as its own numbers state.

Of the numbers in ``ints`` only those used as an index are checked; the others are checked when a checkpoint is read.
"""

from typing import Final

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.monitoring import scatter
from replant.kernels.native import kernel
from replant.kernels.optimizers import covariance, gradient
from replant.kernels.schema import LAGS, StateSlots
from replant.kernels.slot_tables import Flag

MOST: Final = 1 << 24  # largest size: products of larger ones may overflow int64 [count]

#: The blocks of a state: the place in ``ints`` that holds the begin of each, and its name.
BLOCKS: Final = tuple((block.index, block.name) for block in StateSlots.blocks)

#: The slots that kernels use as flags.
FLAGS: Final = tuple(slot.name for slot in StateSlots.integers if isinstance(slot, Flag))

#: For each optimizer: its code, the size of its memory (three coefficients), the least number of its settings.
OPTIMIZERS: Final = tuple(
    (code, *memory.end, settings) for code, _, memory, settings in gradient.OPTIMIZERS + covariance.OPTIMIZERS
)


def are_within(s):
    """Return whether numbers of ``reals`` and of the banks that are used as an index are within their blocks."""
    noise = s.noise
    if not (0 <= noise.order <= LAGS and 0 <= noise.known <= LAGS + 1 and 0 <= noise.position <= LAGS):
        return False  # also for NaN
    if not (0 <= s.colour.position < LAGS and 0 <= s.path.kept < max(s.path_size, 1)):
        return False
    for row in range(3):
        if not 0 <= s.banks[row, bk.NEXT] < bk.KEPT:
            return False
    return scatter.lasting(s) <= 2 * s.order + 2  # else the work arrays are too short for the covariance


def is_known(s):
    """Return whether the optimizer is known, and its memory and settings are large enough."""
    T, M, S = s.entries, s.memory_size, s.settings_size
    for code, squares, entries, ones, settings in OPTIMIZERS:
        if s.algorithm == code:
            more = T if code == covariance.KALMAN_TRACKING else 0
            return M >= squares * T * T + entries * T + ones and settings + more <= S
    return False


def is_laid_out(s, reals, banks, columns):
    """Return whether the blocks lie one after the other within the ``reals``, and the banks are large enough."""
    if s.ints.size < at.ROWS:
        return False
    n, T, M, S, ring = s.order, s.entries, s.memory_size, s.settings_size, s.ring_size
    if not (1 <= n <= T <= MOST and 0 <= M <= MOST and 0 <= S <= MOST and 1 <= ring <= MOST and n <= 1000):
        return False
    if not 0 <= s.path_size <= MOST:
        return False
    for name in FLAGS:
        if not 0 <= getattr(s, name) <= 1:
            return False
    end = at.SCALARS
    for place, name in BLOCKS:
        if s.ints[place] != end:
            return False
        end += getattr(s, name).size
    if not (end <= reals and banks >= 3 and columns >= bk.size(n, T)):
        return False
    inputs, serving = s.input_entries, s.serving_bank
    entries = n + inputs + (1 + n if s.refined else s.has_constant)
    return (0 <= inputs <= n + 1 and entries <= T and 1 <= serving <= 2 and 0 <= s.ring_head < ring) or (s.collects)


def holds_rows(s, rows, width, recent_rows, recent_width):
    """Return whether a buffer and raw samples of these shapes are as large as a state says, and their heads within."""
    T, batch, capacity, kept = s.entries, s.batch_size, s.capacity, s.recent_size
    if not (1 <= batch <= MOST and s.ints.size >= at.ROWS + batch and 1 <= capacity <= rows):
        return False
    if not (width >= (2 * T + 2 if s.instruments else T + 2) or s.collects):
        return False
    columns = 6 if s.has_reference else 5 if s.examines_output else 3
    if not (0 <= kept <= recent_rows and recent_width >= columns and 0 <= s.recent_head < max(kept, 1)):
        return False
    return 0 <= s.buffer_head < capacity and 0 <= s.buffer_filled <= capacity


@kernel()
def is_sound(s: StateSlots):
    """Return whether all arrays of a state are large enough, and all indices are within them."""
    if not is_laid_out(s, s.reals.size, s.banks.shape[0], s.banks.shape[1]):
        return False
    if not holds_rows(s, s.buffer.shape[0], s.buffer.shape[1], s.recent.shape[0], s.recent.shape[1]):
        return False
    return (is_known(s) and are_within(s)) or s.collects
