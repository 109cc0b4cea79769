"""Whether a state's arrays are as long as its own numbers say: looked at before a compiled kernel runs.

Of the numbers in ``ints`` those count that serve as an index; the others are looked at where a checkpoint is read.
"""

from typing import Final

from replant.kernels import schema as at
from replant.kernels.filters import bank as bk
from replant.kernels.optimizers import covariance, gradient
from replant.kernels.schema import FIXED, LAGUERRE, ColourSlots, NoiseSlots, PathSlots, StateSlots

MOST: Final = 1 << 24
"""Sizes beyond which their products might leave int64 [count]."""

_POWERS: Final[tuple[dict[str, int], ...]] = (
    {},
    {"n": 1},
    {"n": 2},
    {"T": 1},
    {"T": 2},
    {"M": 1},
    {"S": 1},
    {"RING": 1},
    {"Q": 1},
    {"L": 1},
    {"L": 2},
)


def _shares(block):
    """Return by how much each of `_POWERS` enters the size of a block, which is a polynomial of its dimensions."""

    def size(**own):
        dims = {"n": 0, "T": 0, "M": 0, "S": 0, "RING": 0, "Q": 0, "L": 0} | own
        return block.size(FIXED | dims | {"N": dims["n"] + 2})

    none = size()
    shares = [none]
    for powers in _POWERS[1:]:
        ((name, power),) = powers.items()
        one, two = size(**{name: 1}) - none, size(**{name: 2}) - none
        square = (two - 2 * one) // 2
        shares.append(square if power == 2 else one - square)
    return tuple(shares)


#: For each block: the slot that says where it begins, and the shares of its size.
BLOCKS = tuple((block.index, *_shares(block)) for block in StateSlots.blocks)

#: Numbers that an optimizer's settings have at the least, by its code; those of `KALMAN_TRACKING` have T more.
SETTINGS: Final = {
    gradient.GRADIENT: 1, gradient.ADAM: 4, gradient.AMSGRAD: 4, gradient.ADAGRAD: 2, gradient.RMSPROP: 3,
    gradient.NADAM: 4, gradient.ADADELTA: 3, gradient.INTEGRAL_COST: 3, covariance.RECURSIVE_LEAST_SQUARES: 1,
    covariance.KALMAN_TRACKING: 1,
}  # fmt: skip
#: For each optimizer: its code, the size of its memory, that of its settings.
OPTIMIZERS: Final = tuple(
    (code, *memory.end, SETTINGS[code]) for code, memory in (gradient.MEMORY | covariance.MEMORY).items()
)


#: Numbers of `reals` that serve as an index: the slot that says where their block begins, their place, the largest.
PLACES: Final = tuple(
    (begin, slot.index, int(slot.most))
    for begin, slot in (
        (at.AT_NOISE, NoiseSlots.order), (at.AT_NOISE, NoiseSlots.known), (at.AT_NOISE, NoiseSlots.position),
        (at.AT_COLOUR, ColourSlots.position), (at.AT_PATH, PathSlots.kept),
    )
)  # fmt: skip


def are_within(ints, reals, banks):
    """Return whether the numbers of ``reals`` and of the banks that serve as an index are within their blocks."""
    for begin, place, most in PLACES:
        if not 0 <= reals[ints[begin] + place] <= most:  # nor is one that is no number
            return False
    for row in range(3):
        if not 0 <= banks[row, bk.NEXT] < bk.KEPT:
            return False
    return True


def is_known(ints):
    """Return whether the optimizer is known, and has as much memory and settings as it needs."""
    T, M, S = ints[at.ENTRIES], ints[at.MEMORY_SIZE], ints[at.SETTINGS_SIZE]
    for code, squares, entries, ones, settings in OPTIMIZERS:
        if ints[at.ALGORITHM] == code:
            more = T if code == covariance.KALMAN_TRACKING else 0
            return M >= squares * T * T + entries * T + ones and settings + more <= S
    return False


def is_laid_out(ints, reals, banks, columns):
    """Return whether the blocks lie one after the other within so many ``reals``, and the banks are large enough."""
    if ints.size < at.ROWS:
        return False
    n, T, M, S, ring = (
        ints[at.ORDER],
        ints[at.ENTRIES],
        ints[at.MEMORY_SIZE],
        ints[at.SETTINGS_SIZE],
        ints[at.RING_SIZE],
    )
    if not (1 <= n <= T <= MOST and 0 <= M <= MOST and 0 <= S <= MOST and 1 <= ring <= MOST and n <= 1000):
        return False
    Q = ring if ints[at.HAS_REFERENCE] == 1 else 0
    L = LAGUERRE + 1 if ints[at.HAS_REFERENCE] == 1 else 0
    end = at.SCALARS
    for slot, one, by_n, by_nn, by_T, by_TT, by_M, by_S, by_ring, by_Q, by_L, by_LL in BLOCKS:
        if ints[slot] != end:
            return False
        end += one + by_n * n + by_nn * n * n + by_T * T + by_TT * T * T + by_M * M + by_S * S
        end += by_ring * ring + by_Q * Q + by_L * L + by_LL * L * L
    if not (end <= reals and banks >= 3 and columns >= bk.size(n, T)):
        return False
    inputs, serving = ints[at.INPUT_ENTRIES], ints[at.SERVING_BANK]
    entries = n + inputs + (1 + n if ints[at.REFINED] == 1 else ints[at.HAS_CONSTANT])
    return (0 <= inputs <= n + 1 and entries <= T and 1 <= serving <= 2 and 0 <= ints[at.RING_HEAD] < ring) or (
        ints[at.COLLECTS] == 1
    )


def is_sound(ints, reals, banks, buffer, recent):
    """Return whether all arrays of a state are large enough, and what serves as an index is within them."""
    if not is_laid_out(ints, reals.size, banks.shape[0], banks.shape[1]):
        return False
    T, batch, capacity, rows = ints[at.ENTRIES], ints[at.BATCH_SIZE], ints[at.CAPACITY], ints[at.RECENT_SIZE]
    if not (1 <= batch <= MOST and ints.size >= at.ROWS + batch and 1 <= capacity <= buffer.shape[0]):
        return False
    if not (buffer.shape[1] >= (2 * T + 2 if ints[at.INSTRUMENTS] == 1 else T + 2) or ints[at.COLLECTS] == 1):
        return False
    columns = 6 if ints[at.HAS_REFERENCE] == 1 else 5 if ints[at.EXAMINES_OUTPUT] == 1 else 3
    if not (0 <= rows <= recent.shape[0] and recent.shape[1] >= columns):
        return False
    if not ((is_known(ints) and are_within(ints, reals, banks)) or ints[at.COLLECTS] == 1):
        return False
    heads = 0 <= ints[at.BUFFER_HEAD] < capacity and 0 <= ints[at.BUFFER_FILLED] <= capacity
    return heads and 0 <= ints[at.RECENT_HEAD] < max(rows, 1)
