"""The schema of an identifier's state: each number declared once, for kernels and checkpoint.

An identifier's state is five arrays: ``ints`` (int64), ``reals`` (float64), three filter banks, the replay buffer and
the newest raw samples.  `StateSlots` lists the numbers of the first two.  The list defines

* the fields of kernels, ``s.alarm``, ``s.error``, ``s.theta[i]``, ``s.noise.models[j, i]``: a struct in C, a `Fields`
  in the interpreter;
* the properties of `replant.estimation.engine.state.State`, with the same names;
* the layout of a checkpoint, and the ranges that are checked when one is loaded.

To add a number, add a line.  `FIXED` and `DIMENSIONS` have the dimensions of blocks.
"""

from __future__ import annotations

from enum import IntEnum
from functools import lru_cache
from typing import Any, Final

import numpy as np

from replant.kernels import slot_tables
from replant.kernels.slot_tables import Array, Block, Choice, Fields, Flag, Integer, Nested, Numbers, Part, Real, Slot

Ints = np.ndarray[Any, np.dtype[np.int64]]

# kept one step apart, so the oldest is three to four steps old: the samples held out are at least three quarters of the
# most; two estimates would give a half, eight would add an eighth for twice the room
PAST: Final = 4  # past estimates kept; the samples after the oldest are held out from it, for assessment [count]

LAGS: Final = 4
"""Order of the residual's autoregression [samples].
Origin: with eight, right estimates under slow noise are no longer trusted; two model less of the colour.
Sensitivity: halved, the program fails; doubled, right estimates no longer trusted: 'noise of 1 s', 'slow noise',
'gaps', 'a little nonlinear'; error of 'gaps' times 1.3.
"""

LAGUERRE: Final = 12
"""Number of Laguerre functions that a reference is expanded in [count].
Origin: compared with a finite impulse response of 150 taps, errors are the same within 3 % if the taps span the
response, and smaller under slow noise.
Sensitivity: halved or doubled, nothing changes on these records.
"""

# 32 rows estimate the standard deviation of white noise to an eighth
ROOM: Final = 64  # rows of the estimate's path; in a long record at least half of them are in use [count]
LINE: Final = 64  # cache line of the processor [bytes]
# its square, and sums of squares, are far inside float64
LARGEST: Final = 1e150  # largest magnitude of a sample that is accepted [number]
# probability 2e-9 in normal noise
OUTLYING: Final = 6.0  # distance of a residual from its expected value that is an outlier [robust standard deviations]

# Columns of the raw samples kept.  A state that does not examine outputs has the first three; the last one exists only
# with a reference.
INPUT, OUTPUT, STEP, BRIDGED, DOUBTED, REFERENCE = range(6)

BELIEVED: Final = -1  # HELD_AT while a sample is taken without the test for leaps: held back or judged before [number]
# above the 40 sampling times that a reset clock counts as: at half, the first sample after each reset would leap; a
# misread stamp that is less far ahead costs the samples up to it: at twice, learning would pause for too long
LEAP: Final = 50.0  # interval beyond which a stamp leaps ahead: the next one must confirm it [sampling times]
# seconds since 1970 reach it at 26 kHz; a tenth would reject them at 3 kHz, ten times would admit jitter of 10 %
FARTHEST: Final = 0.01 * 2.0**52  # time at which the resolution of stamps is 1 % of a sampling time [sampling times]

MOST_EARLIER: Final = 10
"""Advancing stamps in a row before the newest accepted one, after which the clock counts as reset [samples].
Origin: a packet of ten samples that arrives twice must not count as a reset; a reset costs as many samples.
Sensitivity: halved or doubled, nothing changes on these records.
"""

FIXED: Final = {"PAST": PAST, "LAGS": LAGS}
#: The other dimensions, by slots of the state.
DIMENSIONS: Final = {
    "n": "order",
    "N": "order + 2",
    "T": "entries",  # the parameters, then the nuisances of the refined filter
    "M": "memory_size",
    "S": "settings_size",
    "RING": "ring_size",
    "PATH": "path_size",  # ROOM, or 0
    "Q": "ring_size * has_reference",  # past inputs kept with a reference
    "L": f"{LAGUERRE + 1} * has_reference",  # Laguerre functions of the reference, and a constant
}

LAYOUT: Final = True  # of a slot: the settings decide it, once, when the state is laid out


class Alarm(IntEnum):
    """State of the alarm on a residual that has grown."""

    NONE = 0
    RAISED = 1  # the CUSUM test has just raised it
    RESTS = 3  # a model of the samples since is sought: learning pauses
    FLOATS = 4  # no model explains the output, as with a disconnected cable: learning pauses until this ends


class Supposition(IntEnum):
    """What has changed when a residual has grown; see `replant.estimation.solver.change_contest`."""

    NOTHING = 0
    NOISE = 1  # variance or colour of the noise
    LOAD = 2  # offset and initial state
    PART = 3  # these and some directions of the coefficients, such as the gain
    PLANT = 4  # these and every coefficient
    CUT = 5  # the output no longer responds to the input
    WHOLE = 6  # not the plant: the model was wrong

    @property
    def is_of_plant(self) -> bool:
        """Whether the response of the output to the input has changed."""
        return self in (Supposition.PART, Supposition.PLANT, Supposition.CUT)


class Doubt(IntEnum):
    """Why the model's output replaces the newest output."""

    NONE = 0
    OUTLIER = 1
    STUCK = 2
    MISSING = 3  # no output came


# stored in place of the `Doubt` of the sample at which a solution has found a new load
LOAD = -1  # mark of a change of load in the raw samples kept [number]


class ColourSlots(Part):
    """Power and colour of the residual e; see `replant.kernels.monitoring.scatter`."""

    count = Real("effective number of residuals, after forgetting", finite=False)
    power = Real("sum of e^2 / alpha: unbiased by the parameters' own error", finite=False)
    position = Real("row of `filtered` that holds the newest one", least=0.0, most=LAGS - 1.0)
    model = Block("LAGS + 1", "D(q): 1, d_1 .., the autoregression D(q) e = w", finite=False)
    covariances = Block("LAGS + 1", "sums of e_k e_{k - lag}", finite=False)
    errors = Block("LAGS", "the last residuals, newest first", finite=False)
    filtered = Block("LAGS, T", "zeta / D(q) of the last samples, a ring", finite=False)
    squares = Block("T, T", "Q, sum of zeta_f zeta_f'", finite=False)


class NoiseSlots(Part):
    """The noise model, an autoregression of the residual; see `replant.kernels.filters.autoregressions`."""

    order = Real("p, order in use", least=0.0, most=float(LAGS))
    filters = Real("1: rows are filtered by the model; 0: it is only kept", least=0.0, most=1.0)
    gain = Real("V_p / V_0 of the model that the covariance was begun with", least=0.0)
    count = Real("effective number of residuals in `sums`, after forgetting", least=0.0)
    known = Real("rows in `rows` without a break, the newest included", least=0.0, most=LAGS + 1.0)
    position = Real("row of `rows` that holds the newest one", least=0.0, most=float(LAGS))
    models = Block("LAGS + 1, LAGS + 1", "row j: D(q) of order j: 1, d_1 .. d_j, 0 ..")
    variances = Block("LAGS + 1", "V_j, variance of the residual filtered by row j [sigma_y^2]")
    sums = Block("LAGS + 1, LAGS + 1", "of e_(k-i) e_(k-j), lower triangle [sigma_y^2]", finite=False)
    rows = Block("LAGS + 1, 2 * T + 1", "phi, zeta and target of the last samples, a ring", finite=False)


class ReferenceSlots(Part):
    """The parts of input and output that a reference explains; see `replant.kernels.filters.reference`."""

    pole = Real("a, pole of the Laguerre functions", least=0.0, most=1.0)
    origin = Real("r_0, which is subtracted from the reference [of r]")
    states = Block("L", "states of the functions at the newest sample, and a one [of r]")
    weights = Block("2, L", "weights of the states: for the input, for the output", finite=False)
    factors = Block("L, L", "U of the weights' covariance U D U'", finite=False)
    diagonal = Block("L", "D of the same", finite=False)


class PathSlots(Part):
    """The path of the estimate; see `replant.kernels.monitoring.scatter`."""

    step = Real("learned samples between two rows", finite=False)
    due = Real("learned samples at which the next row is due", finite=False)
    kept = Real("complete rows", least=0.0, most=float(ROOM - 1))
    rows = Block("PATH, 2, T", "rows of W and the diagonal of P; the last estimate", finite=False)


class SumsSlots(Part):
    """The data of a verdict without raw samples; see `replant.kernels.monitoring.scatter`."""

    count = Real("outputs that were measured and plausible", least=0.0)
    output_mean = Real("moving mean of these outputs [of y]")
    output_power = Real("moving variance of these outputs [of y^2]", least=0.0)
    error_power = Real("moving mean square of the a-priori error [of y^2]", least=0.0)
    missing = Real("newest samples in a row without an output", least=0.0)
    refuted = Real("1: the samples of the start-up refuted its model; else 0", least=0.0, most=1.0)


#: The arrays of a state, in the order of a checkpoint.
STATE_ARRAYS: Final = ("ints", "reals", "banks", "buffer", "recent")


class StateSlots(slot_tables.Table):
    """The arrays of a state, and every number of ``ints`` and ``reals``.

    ``banks`` (3, size): the bank of the fixed filter and two of the auxiliary model, see
    `replant.kernels.filters.bank`; ``buffer`` (capacity, width): a row for each learned sample, with its regressor,
    target, weight and any instruments; ``recent`` (R, 3), (R, 5) or (R, 6): raw input, output and interval; if outputs
    are examined, also the output that the filters saw and the `Doubt`; with a reference, also the reference.

    `replant.estimation.engine.state.State` lays them out; kernels use their `fields`.
    """

    __slots__ = STATE_ARRAYS

    def __init__(self, ints: Ints, reals: Array, banks: Array, buffer: Array, recent: Array) -> None:
        self.ints, self.reals, self.banks, self.buffer, self.recent = ints, reals, banks, buffer, recent

    # --- structure and settings
    order = Integer("n, poles", LAYOUT)
    entries = Integer("T, entries of the regressor", LAYOUT)
    parameter_count = Integer("P, number of entries that are parameters of the plant", LAYOUT)
    input_entries = Integer("m + 1, number of entries made of the input", LAYOUT)
    algorithm = Integer("code of the optimizer", LAYOUT)
    square_input = Flag("the input is squared first", LAYOUT)
    normalize = Flag("updates are divided by m^2 = 1 + phi' phi, (13) of the article", LAYOUT)
    straight_input = Flag("the input is linear between samples (first-order hold); else it is held", LAYOUT)
    bilinear = Flag("the filters are the article's generalised bilinear ones; else exact", LAYOUT)
    has_constant = Flag("the regressor has a constant", LAYOUT)
    refined = Flag("the filter is 1/A of the estimate, with initial states as nuisances; else fixed", LAYOUT)
    instruments = Flag("the regressor has a noise-free companion", LAYOUT)
    has_noise_model = Flag("regressor, instruments and target are filtered by the noise model", LAYOUT)
    has_reference = Flag("instruments are made from a reference", LAYOUT)
    collects = Flag("samples of the start-up are collected: there is no estimate yet", LAYOUT)
    coloured = Flag("power and colour of the residual are kept", LAYOUT)
    examines_output = Flag("outputs are examined before they are learned", LAYOUT)
    memory_size = Integer("M, numbers of the optimizer's memory", LAYOUT)
    settings_size = Integer("S, numbers of the optimizer's settings", LAYOUT)
    ring_size = Integer("past inputs kept for the dead time", LAYOUT)
    recent_size = Integer("raw samples kept", LAYOUT)
    path_size = Integer("rows of the estimate's path; 0 if few raw samples are kept: sums are kept instead", LAYOUT)
    past_step = Integer("most samples between two past estimates kept", LAYOUT)
    rests_with_input = Flag("updates pause while the input is at rest")
    rest_after = Integer("samples of a constant input after which learning pauses; 0: its variance alone decides")
    adapt = Flag("the estimate learns; the user clears it to freeze the estimate")

    # --- replay
    capacity = Integer("rows of the replay buffer", LAYOUT)
    batch_size = Integer("updates a sample once the buffer is warm", LAYOUT)
    warmup = Integer("rows that the buffer must exceed before batches begin", LAYOUT)
    seed = Integer("seed of the random stream", LAYOUT, below=str(2**63))
    drawn = Integer("position in the random stream")
    buffer_filled = Integer("rows of the buffer in use", below="capacity + 1")
    buffer_head = Integer("row that the next sample goes to", below="capacity")

    # --- samples
    started = Flag("the first sample has been accepted")
    samples = Integer("accepted samples")
    learned = Integer("accepted samples when the estimate last took one in", below="samples + 1")
    rested = Integer("samples that were not learned because the input rested or the estimate was frozen")
    refused = Integer("updates undone because they overflowed")
    not_finite = Integer("rejected samples: NaN or infinite")
    too_large = Integer("rejected samples: their square would overflow")
    not_later = Integer("rejected samples: the time stamp does not advance")
    too_dense = Integer("rejected samples: so dense that the ring of past inputs does not span the dead time")
    time_leaps = Integer("rejected samples, or held back: the time stamp leaps ahead")
    too_coarse = Integer("rejected samples: stamps so far from zero do not resolve a sampling time")
    input_leaps = Integer("rejected samples, or held back: the input is far beyond all earlier ones")
    no_output = Integer("samples without an output: only the input was used")
    no_reference = Integer("samples with a reference not finite or too large: the previous one was held")
    recent_head = Integer("row of the raw samples that the next one goes to")
    past_kept = Integer("past estimates kept so far", below="samples + 1")
    past_due = Integer("accepted samples at which the next past estimate is kept", below="samples + past_step + 1")
    attention_at = Integer("accepted samples at which the identifier has work to do; 0: none is planned")
    solved_at = Integer("accepted samples when the record was last solved as a whole", below="samples + 1")
    finished_at = Integer("accepted samples when their record ended, if it was then solved", below="samples + 1")
    trusted_at = Integer(
        "accepted samples when the model was last known to be trusted while the input rested; 0: it is not",
        below="samples + 1",
    )
    attention = Flag("the identifier has work to do now, or the alarm was raised")

    # --- a sample that leaps, held back until the next one confirms it
    held_at = Integer(
        "number of accepted samples plus one when it arrived; any other number: none is held", below="samples + 2"
    )
    held_input = Real("its input, preprocessed [of u]", finite=False)
    held_output = Real("its output, preprocessed [of y]", finite=False)
    held_time = Real("its time stamp [s]", finite=False)
    held_reference = Real("its reference [of r]", finite=False)

    # --- clock
    gaps = Integer("interruptions after which the filters were restarted")
    gap_at = Integer("accepted samples before the last interruption", below="samples + 1")
    earlier_stamps = Integer(
        "stamps in a row that advance but lie before the newest accepted one; without stamps, samples in a row that "
        "were rejected"
    )
    interval = Real("nominal sampling time [s]", LAYOUT)
    longest_gap = Real("a longer interval is an interruption [s]", LAYOUT, finite=False)
    last_time = Real("time stamp of the newest sample [s]")
    earlier_time = Real("newest stamp that lay before the newest accepted one [s]")
    elapsed = Real("time since the first sample [s]", least=0.0)
    learn_from = Real("elapsed time until which learning waits after a gap [s]")

    # --- input and output
    ring_head = Integer("place of the newest input in the ring of past inputs", below="ring_size")
    input_still = Integer("samples since the input last moved")
    input_offset = Real("working point, subtracted from the mapped input [of u]", LAYOUT)
    output_offset = Real("working point, subtracted from the output [of y]", LAYOUT)
    output_scale = Real("sigma_y [of y]", LAYOUT)
    delay = Real("dead time [s]", LAYOUT)
    input_now = Real("the delayed input at the newest sample [of u]")
    unknown_input = Real("time until the delayed input is one of the record [s]", least=0.0)
    input_by_reference = Real("part of the newest input that the reference explains [of u]")
    output_by_reference = Real("part of the newest output that the reference explains [of y]")
    reference_input_now = Real("part of the delayed input that the reference explains [of u]")
    reference_now = Real("newest reference [of r]")
    last_output = Real("the previous output as the filters saw it [of y]")
    input_mean = Real("moving mean of the input [of u]")
    input_power = Real("moving variance of the input [of u^2]", least=0.0)
    largest_power = Real("largest moving variance so far [of u^2]", least=0.0)
    forget_input = Real("share of the newest sample in mean and variance", least=0.0, most=1.0)
    input_anchor = Real("the input when it last moved [of u]")

    # --- auxiliary model
    serving_bank = Integer("bank of the auxiliary model in use, 1 or 2", least=1, below="3")
    warming = Flag("the other bank warms up with the newest estimate")
    ready_at = Real("elapsed time at which the warming bank takes over [s]", least=0.0, finite=False)
    stability_margin = Real("least distance of a filter's pole from the imaginary axis [rad/s]", least=0.0)
    largest_bandwidth = Real("largest bandwidth of a filter [rad/s]", least=0.0)

    # --- outliers and stuck sensors
    doubt = Choice(Doubt, "why the newest output was bridged")
    outliers = Integer("samples whose output was bridged as an outlier")
    stuck = Integer("samples whose output was bridged as that of a stuck sensor")
    stuck_outputs = Integer("number of outputs at which the sensor is known to have stuck, 0 to 2")
    stuck_last = Integer("accepted samples when the sensor was last stuck", below="samples + 1")
    ties = Integer("samples in a row whose output equals the previous one to the bit")
    error = Real("a-priori error of the newest sample as it was measured [sigma_y]", finite=False)
    used_output = Real("the output that the filters saw, measured or bridged [of y]")
    last_raw = Real("the previous output as it was measured [of y]", finite=False)
    tie_share = Real("share of the samples whose output equals the previous one", least=0.0, most=1.0)
    tie_model = Real("the modelled output when the measured one last changed [of y]")
    stuck_at = Real("output at which the sensor last stuck, perhaps the end of its scale [of y]")
    stuck_also = Real("the stuck output before that: a scale has two ends [of y]")
    sensor_step = Real(
        "least non-zero difference of two successive outputs: the step of the sensor's scale [of y]",
        least=0.0,
        finite=False,
    )

    # --- residual and change
    alarm = Choice(Alarm, "whether the residual has grown")
    change_began = Integer("accepted samples when the residual was last at its usual power", below="samples + 1")
    look_at = Integer("accepted samples at which an alarm is investigated; 0: not planned")
    record_began = Integer("accepted samples before the record that the estimate is made from", below="samples + 1")
    revised_from = Integer(
        "accepted samples before those that revised the estimate after a change; 0: none", below="samples + 1"
    )
    change = Choice(Supposition, "kind of the last change that was accepted")
    undecided = Flag("the samples since do not yet show whether G(s) has changed in another way")
    change_price = Real("penalty for the numbers fitted at that change", least=0.0)
    disagreement = Real("disagreement of two estimates of the record that was last solved, see `Refined`", least=0.0)
    changed_at = Integer("accepted samples before that change; 0: none", below="samples + 1")
    before_began = Integer("accepted samples before the record that ended at that change", below="samples + 1")
    variance_ratio = Real("variance of the newest a-priori error over that of the residual", finite=False)
    residuals_seen = Real("number of residuals in the next two variances", least=0.0)
    late_variance = Real("recent variance of the residual; large residuals are clipped [sigma_y^2]", finite=False)
    usual_variance = Real("usual variance of the residual [sigma_y^2]", finite=False)
    late_innovation = Real("recent variance of the residual filtered by the noise model [sigma_y^2]", finite=False)
    usual_innovation = Real("usual variance of the same [sigma_y^2]", finite=False)
    largest_output = Real("recent largest square of the modelled output [sigma_y^2]", finite=False)
    cusum = Real(
        "sum of the residual's power above the usual one; during an alarm, below it [usual variances]", finite=False
    )
    cusum_limit = Real("limit of the sum that raises the alarm; 0: it is never raised [usual variances]", least=0.0)

    # --- blocks
    inputs = Block("RING", "past inputs [of u]")
    intervals = Block("RING", "interval before each of them [s]")
    held = Block("RING", "mean of a held input over that interval [of u]")
    reference_inputs = Block("Q", "parts of the past inputs that the reference explains [of u]")
    reference_held = Block("Q", "means of these over the intervals [of u]")
    output_before = Block("n", "states of the output's filters before the newest sample", finite=False)
    sigma = Block("T", "scaling of the regressor, (10)-(12) of the article", LAYOUT)
    unit = Block("T", "factors from scaled to physical parameters", LAYOUT)
    phi = Block("T", "scaled regressor of the newest sample", finite=False)
    zeta = Block("T", "its noise-free companion", finite=False)
    theta = Block("T", "scaled estimate")
    memory = Block("M", "the optimizer's own memory")
    settings = Block("S", "the optimizer's settings", LAYOUT)
    backup = Block("T + M", "estimate and memory before the newest sample")
    work = Block("4 * N * N", "work; N = n + 2", finite=False)
    past = Block("PAST, 1 + T", "rows of a number of samples and the estimate after them")
    prior = Block("1 + T, T", "the estimate before a change and its information matrix, physical", finite=False)
    colour = Nested(ColourSlots, "power and colour of the residual")
    path = Nested(PathSlots, "the estimate at some of the samples")
    noise = Nested(NoiseSlots, "the noise model")
    reference = Nested(ReferenceSlots, "the projection on a reference")
    sums = Nested(SumsSlots, "moving moments of outputs and errors")

    @property
    def dimensions(self) -> Numbers:
        """The dimensions used in the shapes of the blocks."""
        return _dimensions_of(self.ints[:LAID_OUT].tobytes())

    def begin_of(self, block: Slot[Any]) -> int:
        """Return where in ``reals`` a block begins."""
        return int(self.ints[block.index])

    @property
    def rows(self) -> Ints:
        """The rows of the buffer that were drawn for the newest sample."""
        return self.ints[ROWS:]

    @property
    def fields(self) -> Fields:
        """The fields that interpreted kernels get."""
        return Fields(self, (*STATE_ARRAYS, "rows"))


#: First place in ``ints`` of the rows of the buffer that were drawn for the newest sample, (batch_size,).
ROWS: Final = len(StateSlots.integers) + len(StateSlots.blocks)
#: First place in ``reals`` of the blocks.
SCALARS: Final = len(StateSlots.scalars)
#: All slots that define dimensions lie in ``ints`` before this place.
LAID_OUT: Final = StateSlots.path_size.index + 1


@lru_cache(maxsize=256)
def dimensions(**slots: int) -> Numbers:
    """Return all dimensions by name, computed from the slots that define them."""
    known = Numbers(slots)
    return Numbers(FIXED | {name: slot_tables.sizes(text, known)[0] for name, text in DIMENSIONS.items()})


@lru_cache(maxsize=256)  # needed for each access to a block; reading seven slots would take longer than the access
def _dimensions_of(layout: bytes) -> Numbers:
    ints = np.frombuffer(layout, np.int64)
    names = ("order", "entries", "memory_size", "settings_size", "ring_size", "path_size", "has_reference")
    return dimensions(**{name: int(ints[getattr(StateSlots, name).index]) for name in names})


class Attention(Exception):  # noqa: N818 - nothing went wrong
    """Raised instead of taking a sample: `attention` is set, or another call is running."""
