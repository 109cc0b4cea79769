"""Where each number lies in the arrays of an identifier: the one owner of that layout.

The slots of ``ints`` below are constants, compiled into the kernels.  The blocks of ``reals`` depend on the structure,
so their offsets are themselves numbers in ``ints`` (the ``AT_...`` slots), filled in by `plan`.

Symbols: n poles, T entries of the regressor (the P parameters, then the nuisances of the refined filter), M numbers
of memory and S of settings of the optimizer.
"""

from __future__ import annotations

import numpy as np

# --- ints: the structure and the settings
ORDER = 0  # n, poles
ENTRIES = 1  # T, entries of the regressor
PARAMETERS = 2  # P, how many of them the user asked for
INPUT_ENTRIES = 3  # m + 1, how many of them come from the input
ALGORITHM = 4  # which optimizer (the codes in kernels.step)
SQUARE_INPUT = 5  # 1: the input is squared first
NORMALIZE = 6  # 1: divide by m^2 = 1 + phi' phi (13), 0: by one
STRAIGHT_INPUT = 7  # 1: the input runs straight between samples (first-order hold), 0: it is held
BILINEAR = 8  # 1: the article's generalised bilinear filters, 0: exact ones
CONSTANT = 9  # 1: the regressor has a constant
REFINED = 10  # 1: the filter is 1/A of the estimate, with initial states as nuisances; 0: it is fixed
INSTRUMENTS = 11  # 1: the regressor has noise-free companions
CAPACITY = 12  # rows of the replay buffer
BATCH = 13  # updates a sample once the buffer is warm
WARMUP = 14  # rows that the buffer must hold more of before batches begin
RING = 15  # past inputs kept, for the dead time
RECENT = 16  # raw samples kept, for assessment
GUARD = 17  # 1: updates rest while the input rests
ADAPT = 18  # 0: the estimate is frozen by the user
COLOURED = 19  # 1: power and colour of the residual are kept
# --- ints: what changes
STARTED = 20  # 1 after the first accepted sample
SAMPLES = 21  # accepted samples
NOT_FINITE = 22  # rejected samples: NaN or infinite
TOO_LARGE = 23  # rejected samples: their square would leave float64
NOT_LATER = 24  # rejected samples: their time stamp does not advance
REFUSED = 25  # updates undone because they left float64
RESTED = 26  # samples that were not learned because the input rested
GAPS = 27  # interruptions after which the filters began anew
FILLED = 28  # rows of the buffer in use
HEAD = 29  # the row that the next sample goes to
SEED = 30
DRAWN = 31  # position in the random stream
NEWEST = 32  # where in the ring of past inputs the newest one lies
ACTIVE = 33  # which bank of the auxiliary model serves, 1 or 2
WARMING = 34  # 1 while the other one warms up
RECENT_HEAD = 35  # the row of the raw samples kept that the next one goes to: SAMPLES modulo RECENT
LEARNED = 36  # accepted samples when the estimate last took one in
PAST_KEPT = 37  # estimates kept so far
PAST_DUE = 38  # accepted samples at which the estimate is kept next
PAST_STEP = 39  # samples between two estimates kept, at the most
# --- ints: where the blocks of reals begin
AT_INPUTS = 40  # (RING,)  past inputs
AT_PAST = 55  # (PAST, 1 + T)  past estimates, scaled, each behind the samples that it had taken in
AT_HELD = 54  # (RING,)  what a held input was, on the mean, over that interval
AT_INTERVALS = 41  # (RING,)  the interval that led to each of them
AT_SIGMA = 42  # (T,)  scaling of the regressor
AT_UNIT = 43  # (T,)  from scaled to physical parameter
AT_PHI = 44  # (T,)  scaled regressor of the newest sample
AT_ZETA = 45  # (T,)  its noise-free companion
AT_THETA = 46  # (T,)  scaled estimate
AT_MEMORY = 47  # (M,)  the optimizer's own memory
AT_SETTINGS = 48  # (S,)  the optimizer's settings
AT_BACKUP = 49  # (T + M,)  theta and memory before the newest sample
AT_WORK = 50  # (4 (n + 2)^2,)  work
AT_COLOUR = 51  # (see kernels.residuals)  power and colour of the residual
MEMORY_SIZE = 52  # M
SETTINGS_SIZE = 53  # S
AT_PATH = 74  # (see kernels.path)  where the estimate was after some of the samples
# --- ints: whether a measured output can be, and whether the plant has changed (see kernels.guard)
GUARDED = 56  # 1: outputs are examined before they are learned
DOUBT = 57  # of the newest sample: 0 none, 1 an outlier, 2 a stuck sensor
OUTLIERS = 58  # samples whose output was bridged as an outlier
STUCK = 59  # samples whose output was bridged as that of a stuck sensor
STILL = 60  # samples in a row whose output was the same as the one before, to the bit
IS_STUCK = 61  # how many outputs are known at which the sensor was found stuck: STUCK_AT, STUCK_ALSO
CHANGE_BEGAN = 62  # accepted samples when the residual last was as usual
ALARM = 63  # 1: the residual has grown for so long that it is no chance; 2: that is looked into,
# 3: and nothing learned, 4: ... since no model explains the output, as of a cable that floats
# --- ints: clock, rest and record
EARLIER = 64  # stamps in a row that advance, but lie before LAST_TIME
TOO_DENSE = 65  # rejected samples: so close to the one before that the past inputs kept would not reach back far enough
REST_AFTER = 66  # samples of an input that stands still, after which learning rests; 0: only its variance tells
INPUT_STILL = 67  # samples since the input last moved
GAP_AT = 68  # accepted samples before the last interruption
ORIGIN = 69  # accepted samples before the record that the estimate is made from
STUCK_LAST = 70  # accepted samples when the sensor was last stuck
LOOK_AT = 71  # accepted samples at which an alarm is looked into; 0: not planned
DUE = 72  # accepted samples at which the identifier has something to do; 0: nothing is planned
ATTENTION = 73  # 1: it has so now, or the residual has raised an alarm
REVISED = 75  # accepted samples before those by which the estimate was revised after a change; 0: it was not
AT_PRIOR = 76  # (2, T)  the estimate before that change, physical, and its standard deviations
ROWS = 77  # from here: (BATCH,) rows drawn for the newest sample

# --- reals: scalars
INPUT_OFFSET = 0  # working point, subtracted from the mapped input
OUTPUT_OFFSET = 1  # working point, subtracted from the output
OUTPUT_SCALE = 2  # sigma_y
LAST_OUTPUT = 3  # y[k-1]
DELAY = 4  # dead time, s
INTERVAL = 5  # nominal sampling time, s
ELAPSED = 7  # s since the first sample
READY = 8  # when the warming bank takes over, s since the first sample
INPUT_NOW = 9  # the delayed input at the newest sample
MARGIN = 10  # least distance from the imaginary axis of a filter's pole, rad/s
WIDEST = 11  # largest bandwidth of a filter, rad/s
INPUT_MEAN = 12  # moving mean of the input
INPUT_POWER = 13  # moving variance of the input
LARGEST_POWER = 14  # largest that it has been
FORGET_INPUT = 15  # share of the newest sample in both
LONGEST_GAP = 16  # s; a longer interval is an interruption
LAST_TIME = 18  # time stamp of the newest sample, s
LEARN_FROM = 17  # s since the first sample; after a gap, learning waits until then
ERROR = 19  # a-priori error of the newest sample as it was measured, scaled
USED = 20  # the output that the filters saw, measured or bridged
RATIO = 21  # variance of the newest a-priori error, over that of the residual
SEEN = 22  # residuals that the next two are made from
SPREAD = 23  # variance of the residual lately, scaled; large ones count in part
USUAL = 24  # variance of the residual as it usually is, scaled
PEAK = 25  # largest square of the modelled output lately, scaled
CUSUM = 26  # how far the residual's power is beyond the usual one, summed since it was not; in an alarm: within it
LIMIT = 27  # of CUSUM, beyond which it is no chance
LAST_RAW = 28  # the output of the sample before as it was measured
EQUAL = 29  # share of the samples whose output is that of the one before, to the bit
STILL_MODEL = 30  # the modelled output when the measured one began to stand still
STUCK_AT = 31  # the output at which the sensor was last found stuck, or at the end of its scale
EARLIER_TIME = 32  # the newest stamp that lay before LAST_TIME
ANCHOR = 33  # the input when it last moved
STUCK_ALSO = 6  # the one before that: a scale has two ends
LEAST_STEP = 34  # the least by which two outputs in a row have lately differed: the step of a sensor's scale
SCALARS = 35

# Columns of the raw samples kept; only a guarded state has the last two.
INPUT, OUTPUT, STEP, BRIDGED, DOUBTED = range(5)

# Past estimates kept, the oldest given up for each new one: what came after the oldest is held out from it.
PAST = 4

# Bytes of a line of the cache.
LINE = 64

# The largest magnitude whose square is still far inside float64: beyond it m^2 of (13) would overflow.
LARGEST = 1e150


class Attention(Exception):  # noqa: N818 - nothing went wrong
    """Raised after a sample, by kernels that return one number: ATTENTION is set, the error of the sample in ERROR."""


def plan(
    *, order: int, entries: int, ring: int, memory: int, settings: int, batch: int, colour: int, path: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return fresh ``ints`` and ``reals``, all zero but the sizes and offsets."""
    ints = np.zeros(ROWS + batch, np.int64)
    ints[ORDER], ints[ENTRIES], ints[RING], ints[BATCH] = order, entries, ring, batch
    ints[MEMORY_SIZE], ints[SETTINGS_SIZE] = memory, settings
    blocks = {
        AT_INPUTS: ring,
        AT_INTERVALS: ring,
        AT_HELD: ring,
        AT_SIGMA: entries,
        AT_UNIT: entries,
        AT_PHI: entries,
        AT_ZETA: entries,
        AT_THETA: entries,
        AT_MEMORY: memory,
        AT_SETTINGS: settings,
        AT_BACKUP: entries + memory,
        AT_PAST: PAST * (1 + entries),
        AT_WORK: 4 * (order + 2) ** 2,
        AT_COLOUR: colour,
        AT_PATH: path,
        AT_PRIOR: 2 * entries,
    }
    end = SCALARS
    for slot, size in blocks.items():
        ints[slot] = end
        end += size
    return ints, np.zeros(end)


def block(ints: np.ndarray, reals: np.ndarray, slot: int, size: int) -> np.ndarray:
    """Return a view of one block of ``reals``."""
    return reals[ints[slot] : ints[slot] + size]
