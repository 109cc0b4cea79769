"""The evidence for a verdict: estimates and samples, and the estimates run over the samples."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import PER_COEFFICIENT, ModelRun, run_model
from replant.estimation.solver.change_search import PlantChange
from replant.model.structure import Structure
from replant.model.uncertainty import UncertainMode, Uncertainty
from replant.numerics.arguments import BoolArray, FloatArray, IntArray
from replant.numerics.levels import MATTERS
from replant.numerics.linear_algebra import inner, quiet, roots, sum_of_squares
from replant.numerics.robust import usual_step
from replant.verdict.verdict import duration

FEWEST = 100  # samples held out below which one column explains as much as MATTERS by chance [samples]
LEAST_POWER = 0.01 * MATTERS  # variance of the newest input below which it rests [part of its largest so far]
RESTED = 2500  # rest after which the status of the model is noted: half of the time between reviews [samples]
CONSTANT = "the input is constant: move it"
STANDS_STILL = "the output is constant over {} while the input moves"  # {}: for how long
COPY_OF = (
    "the output is a copy of the input{}, sample for sample: name the output's column; or a proportional controller "
    "makes that input: move its set-point, and give it as the reference"
)  # {}: its name, if any
ALLOWED = "which is no more than the uncertainty of the model allows: fit it to these samples, too"
COPY = COPY_OF.format("")
RESTING = 1e-12  # movement that is rounding of float64, some thousand times its precision [part of the largest value]
ROUNDING = 1e-6  # rounding of a log, whose numbers have at least six digits [part of a signal]
UNSTABLE_SIGMAS = 3.0  # distance of an unstable pole from the axis: an integrator's varies [standard deviations]


def is_constant(u: FloatArray) -> bool:
    """Return whether an input (K,) is constant, except for rounding."""
    return u.size > 0 and float(np.ptp(u)) <= RESTING * float(np.abs(u).max())


@quiet
def is_copy(u: FloatArray, y: FloatArray) -> bool:
    """Return whether an output (K,) is the input (K,), perhaps with another scale and offset."""
    if u.size < FEWEST or is_constant(u) or is_constant(y):
        return False
    u, y = ((each - each.mean()) / np.ptp(each) for each in (u, y))
    power = sum_of_squares(u)
    return 0.0 < power < math.inf and float(np.std(y - u * (inner(u, y) / power))) <= ROUNDING * float(y.std())


@dataclass(frozen=True, eq=False)
class Evidence:
    """The estimates and samples (W) for a verdict, and the findings of the online monitoring about them."""

    structure: Structure
    dt: float  # nominal sampling time in s
    record: Record  # the newest samples
    estimate: FloatArray  # (P,)
    covariance: FloatArray | None  # (P, P): of the estimate; None where none is known
    earlier: FloatArray  # (P,): an estimate that has not used the newest ``unseen`` samples
    unseen: int
    learned: int  # samples that ``earlier`` was made from
    in_sample: bool = False  # whether there is no earlier estimate: every sample was used, as in an offline fit
    refused: bool = False  # whether an update was undone because it would have left float64
    adapts: bool = True  # False where the user froze the estimate
    instruments: bool = True  # False where noise biases the estimate
    follows: bool = False  # whether the estimate follows a plant that changes: the newest samples alone test it
    largest_power: float = 0.0  # largest moving variance of the input so far; 0 if not known
    usual_interval: float = 0.0  # median interval in s, gaps included; 0 if not known
    filtered: bool | None = None  # whether the estimate was found with its noise model as a filter; None: not known
    disagreement: float = 0.0  # difference of two estimates of the record, which are equal for a right structure
    usual_power: float = 0.0  # usual variance of the residual since the noise has grown; 0 if it has not
    grown: int = 0  # samples since the residual began to exceed its usual size beyond chance; else 0
    after_change: bool = False  # whether the estimate was begun anew, or revised, after a change that it remembers
    begun_anew: int = 0  # samples since a change of the plant that the estimate has followed
    plant_change: PlantChange | None = None  # change found in the record, which no single model explains
    # of a record solved as a whole
    loads: tuple[float, ...] = ()  # times at which new loads begin to act, in s after its first sample
    undecided: bool = False  # whether it is unknown what has changed; with loads: whether they act
    after_alarm: bool = False  # whether the record begins where an alarm ended without a detected change
    trusted_before: bool = False  # whether the model was trusted when the input came to rest, and no alarm came since
    since_trusted: int = 0  # samples since ``trusted_before`` was noted
    finished: bool = False  # whether the record has ended, and the estimate was then made from all of it
    missing: int = 0  # newest samples in a row that came without an output
    stuck: bool = False  # whether the sensor is stuck or saturated, or was just now
    left_out: int = 0  # outputs left out of estimate and verdict, as the sensor was stuck or at its limit
    input_zero: float = 0.0  # value of the record's input at which the actuator's is zero
    slowness: float = 1.0  # standard deviation of the estimate over that predicted by the residual's power and colour
    input_unit: float = 1.0  # unit of the record's input, in the user's unit
    output_unit: float = 1.0  # unit of the record's output, in the user's unit
    measured: FloatArray | None = None  # (W,): the output as the sensor gave it; None if it is the record's
    bridged: BoolArray | None = None  # (W,): samples not tested, as their doubtful output was replaced by the model's

    @classmethod
    def of_record(cls, structure: Structure, dt: float, record: Record, estimate: FloatArray, **more: Any) -> Evidence:
        """Return the evidence of an estimate that was made from all samples of a record, scaled to about one."""
        given = {"covariance": None, "earlier": estimate, "unseen": 0, "learned": record.u.size, "in_sample": True}
        return cls(structure, dt, record, estimate, **(given | more)).in_own_units()

    def in_own_units(self) -> Evidence:
        """Return the same evidence scaled to about one by powers of two, so that squares fit into float64."""
        of_input, of_output = _power_of_two(self.record.u), _power_of_two(self.record.y)
        n = self.structure.poles
        with np.errstate(over="ignore"):
            factors = np.full(self.estimate.size, of_input / of_output)
        factors[:n] = 1.0
        factors[self.coefficients :] = 1.0 / of_output

        def scaled(record: Record) -> Record:
            before = None if record.before is None else scaled(record.before)
            return replace(record, u=record.u / of_input, y=record.y / of_output, before=before)

        return replace(
            self,
            record=scaled(self.record),
            estimate=self.estimate * factors,
            earlier=self.earlier * factors,
            covariance=None if self.covariance is None else self.covariance * factors * factors[:, None],
            largest_power=self.largest_power / of_input / of_input,
            input_zero=self.input_zero / of_input,
            usual_power=self.usual_power / of_output / of_output,
            input_unit=self.input_unit * of_input,
            output_unit=self.output_unit * of_output,
            measured=None if self.measured is None else self.measured / of_output,
        )

    def as_whole(self) -> Evidence:
        """Return the same evidence with no sample held out: all samples test the present estimate."""
        learned = self.learned + self.unseen
        return replace(self, earlier=self.estimate, unseen=0, learned=learned, in_sample=True)

    @property
    def is_solved(self) -> bool:
        """Whether the estimate is a solution, with instruments, of a record that has ended."""
        return self.finished and self.instruments

    @property
    def raw(self) -> FloatArray:
        """The output (W,) as the sensor gave it."""
        return self.record.y if self.measured is None else self.measured

    @property
    def used(self) -> BoolArray:
        """Which samples (W,) the tests of the model use."""
        return self.record.is_measured if self.bridged is None else self.record.is_measured & ~self.bridged

    def tested(self, error: FloatArray) -> FloatArray:
        """Return an error (W,) with NaN at samples that no test uses."""
        return np.where(self.used, error, np.nan)

    @property
    def own(self) -> FloatArray | None:
        """Covariance (n + m + 1, ..) by which the estimate's error adds to the samples' noise; None: by nothing.

        An estimate that learns from the samples is compared with what they say, and one without a covariance is taken
        as it is.
        """
        if self.adapts or self.covariance is None:
            return None
        return self.covariance[: self.coefficients, : self.coefficients]

    def past_of(self, rows: slice, *, unbroken: bool = False) -> IntArray:
        """Return the number of used samples (if ``unbroken``, of any) in a row before each of some rows, up to LAGS."""
        record = replace(self.record, measured=None if unbroken else self.used, before=None)
        return np.minimum(record.predecessors[rows], np.arange(self.samples)[: self.samples - rows.start])

    @property
    def past(self) -> IntArray:
        """`past_of` the samples that the estimate should explain."""
        return self.past_of(self.known)

    @property
    def coefficients(self) -> int:
        """Number of coefficients of G(s)."""
        return self.structure.coefficients

    @property
    def samples(self) -> int:
        """Number of samples, W."""
        return self.record.u.size

    @cached_property
    def poles(self) -> npt.NDArray[np.complex128]:
        """The estimate's poles (n,), in rad/s."""
        return roots(np.concatenate([[1.0], self.estimate[: self.structure.poles]]))

    @property
    def modes(self) -> tuple[UncertainMode, ...]:
        """The estimate's poles with their uncertainty; empty without a covariance."""
        return () if self.covariance is None else self.uncertainty(self.covariance).first_order_modes

    def uncertainty(self, covariance: FloatArray) -> Uncertainty:
        """Return the uncertainty of the estimate's G(s), without the bias, by a covariance (n + m + 1, ..)."""
        size = self.coefficients
        return Uncertainty(replace(self.structure, bias=False), self.estimate[:size], covariance[:size, :size])

    @property
    def diverging_pole(self) -> float:
        """Real part of the rightmost pole, in rad/s, if it grows more than e-fold over the record; else 0."""
        pole = float(self.poles.real.max())
        return pole if pole * self.record.span > 1.0 else 0.0

    @property
    def unstable_pole(self) -> float:
        """`diverging_pole` if an unstable pole is significant, or no covariance is known; else 0 (integrators vary)."""
        pole = self.diverging_pole
        if not pole:
            return 0.0
        squares = [float(mode.covariance[0, 0]) for mode in self.modes]
        known = zip(self.modes, squares, strict=True)
        is_sure = [mode.mode.pole.real > UNSTABLE_SIGMAS * math.sqrt(max(square, 0.0)) for mode, square in known]
        return pole if any(is_sure) or not is_sure else 0.0

    @property
    def enough(self) -> int:
        """Number of samples that a test needs."""
        return max(FEWEST, PER_COEFFICIENT * self.coefficients)

    @property
    def counted(self) -> int:
        """Samples to compare with ``enough``; in sample, those during the first dead time count, too."""
        return self.record.joined.u.size if self.in_sample else self.samples

    @property
    def is_young(self) -> bool:
        """Whether there are too few samples since the earlier estimate to test it."""
        return not self.in_sample and self.unseen < self.enough

    @property
    def held_out(self) -> int:
        """Number of newest samples that test the earlier estimate; 0 for all."""
        return 0 if self.in_sample or self.is_young else self.unseen

    @property
    def moving(self) -> int:
        """Samples before the input came to rest."""
        return moving(self.record.u, self.largest_power)

    @property
    def newest(self) -> slice:
        """The samples that test the earlier estimate."""
        return slice(self.samples - self.held_out, self.samples) if self.held_out else slice(0, self.samples)

    @property
    def known(self) -> slice:
        """The samples that the present estimate should explain."""
        return self.newest if self.follows else slice(0, self.samples)

    def seconds(self, samples: int) -> float:
        """Return the duration of the newest ``samples`` in s, without the rest that was added before the log."""
        intervals, samples = self.record.intervals, min(samples, max(self.samples - self.record.rest, 1))
        return float(intervals[0]) * samples if intervals.size == 1 else float(intervals[-samples:].sum())

    @property
    def span(self) -> str:
        """The time span of the samples that test the earlier estimate, in words."""
        return f"the last {self.age}"

    @property
    def age(self) -> str:
        """The age of the earlier estimate, in words."""
        return duration(self.seconds(self.held_out or self.samples))


@dataclass(frozen=True, eq=False)
class Runs:
    """The model runs of the earlier and the present estimate over the samples."""

    old: ModelRun
    now: ModelRun
    error: FloatArray  # (N,): of the earlier estimate over the N newest samples, its mean subtracted
    power: float  # variance of the output over them

    @classmethod
    def of(cls, evidence: Evidence, by_reference: FloatArray | None = None) -> Runs | None:
        """Run both estimates; None if a signal exceeds float64; ``by_reference`` (K, 2) as for `run_model`."""
        old = now = run_model(evidence.structure, evidence.earlier, evidence.record, evidence.dt, by_reference)
        if not np.array_equal(evidence.earlier, evidence.estimate):
            now = run_model(evidence.structure, evidence.estimate, evidence.record, evidence.dt, by_reference)
        if old is None or now is None:
            return None
        error = old.error[evidence.newest]
        return cls(old, now, error - error.mean(), float(np.var(evidence.record.y[evidence.newest])))

    def size(self, step: FloatArray, speeds: FloatArray) -> float:
        """Return the largest relative size of a step (n,) or (n + m + 1,) of coefficients; ``speeds`` (n,) of poles.

        For a_i: abs(step) over the coefficient of prod(s + speed), the size of a_i if all poles were real.  For b_j:
        half of the standard deviation of the output by the step, over that of the output.
        """
        n = self.now.structure.poles
        return relative_size(step, speeds, self.now.zeta[:, n:], self.now.forced)


def relative_size(step: FloatArray, speeds: FloatArray, slopes: FloatArray, output: FloatArray) -> float:
    """Return the size of a step, see `Runs.size`, given the slopes (K, m + 1) by b_m .. b_0 and the output (K,)."""
    n, made_of = speeds.size, float(output.std())
    largest = float((np.abs(step[:n]) / np.poly(-speeds)[1:]).max())
    if step.size == n or not made_of > 0.0:
        return largest
    made = np.abs(step[n:]) * slopes.std(axis=0) / made_of
    return max(largest, 0.5 * float(made.max()))


def rounding_of(modelled: FloatArray, output: FloatArray) -> float:
    """Return the standard deviation below which a residual is rounding, which carries no information."""
    # the rounding of a sensor depends on past inputs, but is white if the noise is 0.4 steps: both together are half a
    # step
    return max(ROUNDING * float(modelled.std()), 0.5 * usual_step(output))


def moving(u: FloatArray, power: float = 0.0) -> int:
    """Return the number of samples before an input (K,) stays at its last value, within 1 % of its amplitude."""
    far = np.flatnonzero(np.abs(u - u[-1]) > math.sqrt(LEAST_POWER * max(power, float(np.var(u)))))
    return int(far[-1]) + 1 if far.size else 0


def _power_of_two(signal: FloatArray) -> float:
    """Return the largest power of two up to the largest magnitude of a signal; 1 for a signal of zeros."""
    largest = float(np.abs(signal).max(initial=0.0))
    return 2.0 ** math.floor(math.log2(largest)) if largest > 0.0 else 1.0
