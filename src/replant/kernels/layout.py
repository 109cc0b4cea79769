"""Where each number lies in the arrays ``ints`` and ``reals`` of an identifier: the one owner of that layout.

The slots of ``ints`` below are constants, compiled into the kernels.  The blocks of ``reals`` depend on the structure,
so their offsets are themselves numbers in ``ints`` (the ``AT_...`` slots), filled in by `plan`.
"""

from __future__ import annotations

import numpy as np

# --- ints: the structure and the settings
ORDER = 0  # n, poles
ENTRIES = 1  # P, entries of the regressor
INPUT_ENTRIES = 2  # m + 1, how many of them come from the input
ALGORITHM = 3  # which optimizer (the codes in kernels.step)
SQUARE_INPUT = 4  # 1: the input is squared first
NORMALIZE = 5  # 1: divide by m^2 = 1 + phi' phi (13), 0: by one
LAG = 6  # whole samples of dead time
CAPACITY = 7  # rows of the replay buffer
BATCH = 8  # updates a sample once the buffer is warm
WARMUP = 9  # rows that the buffer must hold more of before batches begin
# --- ints: what changes
STARTED = 10  # 1 after the first accepted sample
SAMPLES = 11  # accepted samples
NOT_FINITE = 12  # rejected samples: NaN or infinite
TOO_LARGE = 13  # rejected samples: their square would leave float64
REFUSED = 14  # updates undone because they left float64
FILLED = 15  # rows of the buffer in use
HEAD = 16  # the row that the next sample goes to
SEED = 17
DRAWN = 18  # position in the random stream
PAST = 19  # where in the ring of past inputs the newest one lies
# --- ints: where the blocks of reals begin
AT_TRANSITION = 20  # (n, n)  Ad of the filters
AT_OUTPUT_TAPS = 21  # (2, n)  filter input vectors for y[k-1], y[k]
AT_INPUT_TAPS = 22  # (3, n)  filter input vectors for u[k-LAG-2], u[k-LAG-1], u[k-LAG]
AT_CHARACTERISTIC = 23  # (n,)  lambda_i / lambda^(n-i): rebuilds s^n/Lambda y
AT_GAIN = 24  # (P,)  from filter state to scaled regressor entry
AT_UNIT = 25  # (P,)  from scaled to physical parameter
AT_OUTPUT_STATE = 26  # (n,)  filter states of y
AT_INPUT_STATE = 27  # (n,)  filter states of u
AT_PAST = 28  # (LAG + 3,)  ring of past inputs
AT_PHI = 29  # (P,)  scaled regressor of the newest sample
AT_THETA = 30  # (P,)  scaled estimate
AT_MEMORY = 31  # (M,)  the optimizer's own memory
AT_SETTINGS = 32  # (S,)  the optimizer's settings
AT_BACKUP = 33  # (max(P + M, 2 n),)  theta and memory before the newest sample; new filter states on their way
MEMORY_SIZE = 34  # M
SETTINGS_SIZE = 35  # S
ROWS = 36  # from here: (BATCH,) rows drawn for the newest sample

# The largest magnitude whose square is still far inside float64: beyond it m^2 of (13) would overflow.
LARGEST = 1e150

# --- reals: scalars
INPUT_OFFSET = 0  # working point, subtracted from the mapped input
OUTPUT_OFFSET = 1  # working point, subtracted from the output
OUTPUT_SCALE = 2  # sigma_y
LAST_OUTPUT = 3  # y[k-1]
SCALARS = 4


def plan(
    order: int, entries: int, input_entries: int, lag: int, memory: int, settings: int, batch: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return fresh ``ints`` and ``reals``, all zero but the sizes and offsets."""
    ints = np.zeros(ROWS + batch, np.int64)
    ints[ORDER], ints[ENTRIES], ints[INPUT_ENTRIES] = order, entries, input_entries
    ints[LAG], ints[BATCH], ints[MEMORY_SIZE], ints[SETTINGS_SIZE] = lag, batch, memory, settings
    blocks = {
        AT_TRANSITION: order * order,
        AT_OUTPUT_TAPS: 2 * order,
        AT_INPUT_TAPS: 3 * order,
        AT_CHARACTERISTIC: order,
        AT_GAIN: entries,
        AT_UNIT: entries,
        AT_OUTPUT_STATE: order,
        AT_INPUT_STATE: order,
        AT_PAST: lag + 3,
        AT_PHI: entries,
        AT_THETA: entries,
        AT_MEMORY: memory,
        AT_SETTINGS: settings,
        AT_BACKUP: max(entries + memory, 2 * order),
    }
    end = SCALARS
    for slot, size in blocks.items():
        ints[slot] = end
        end += size
    return ints, np.zeros(end)


def block(ints: np.ndarray, reals: np.ndarray, slot: int, size: int) -> np.ndarray:
    """Return a view of one block of ``reals``."""
    return reals[ints[slot] : ints[slot] + size]
