"""The evidence for a verdict: estimates and samples, and the estimates run over the samples."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from replant.arguments import BoolArray, FloatArray, IntArray
from replant.assessment.score_test import MATTERS
from replant.assessment.verdict import duration
from replant.engine.record import Record
from replant.model.structure import Structure
from replant.model.uncertainty import UncertainMode, Uncertainty
from replant.simulation.model_run import ModelRun, run_model
from replant.statistics.linear_algebra import roots

FEWEST = 100
"""Samples held out below which they say nothing for a model [samples].
Derivation: one column explains 1 / 100 of the noise's power by chance, as much as MATTERS.
Sensitivity: halved, no verdict changes, and no error by a quarter; doubled, nothing changes on these records.
"""

PER_COEFFICIENT = 10
"""Samples held out for each coefficient below which they say nothing [samples].
Derivation: by chance a model explains a tenth of the noise's power then.
Sensitivity: halved or doubled, nothing changes on these records.
"""

LEAST_POWER = 0.01 * MATTERS
"""Variance of the input over the newest samples below which it rests [part of the largest that it has been].
Derivation: a hundredth of what matters, a hundredth of the amplitude.
Sensitivity: halved or doubled, nothing changes on these records.
"""

RESTED = 2500
"""Samples for which an input must have rested before it is noted whether the model is trusted [samples].
Derivation: half of the samples between two reviews.
Sensitivity: halved or doubled, nothing changes on these records.
"""

UNSTABLE_SIGMAS = 3.0
"""Standard deviations by which a pole must lie right of the imaginary axis for the model to count as unstable: an
estimate of an integrator lies on either side [standard deviations].
Level: 99.7 %.
Sensitivity: halved or doubled, nothing changes on these records.
"""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The estimates and samples that a verdict is made from, and what was noticed about them online.

    Attributes
    ----------
    structure : Structure
    dt : float
        Nominal sampling time in s.
    record : Record
        The newest samples.
    estimate : (P,) array
    covariance : (P, P) array or None
        Of the estimate; None where none is known.
    earlier : (P,) array
        An earlier estimate, which has not used the newest ``unseen`` samples.
    unseen : int
        How many samples came after ``earlier``.
    learned : int
        How many samples ``earlier`` was made from.
    in_sample : bool
        Whether there is no earlier estimate: every sample was used, as in an offline fit.
    refused : bool
        Whether an update was undone because it would have left float64.
    adapts : bool
        False where the user froze the estimate.
    instruments : bool
        False where noise biases the estimate.
    follows : bool
        Whether the estimate follows a plant that changes: it is then tested on the newest samples alone.
    largest_power : float
        Largest moving variance that the input has had; 0 where it is not known.
    usual_interval : float
        Median time between samples in s, interruptions included; 0 where there are no time stamps.
    disagreement : float
        By how much two estimates of the record differ that a right structure makes equal; 0 where they do not.
    grown : int
        Samples since the residual began to exceed its usual size, if that is statistically significant; else 0.
    after_change : bool
        Whether the estimate was begun anew, or revised, after a change of the plant; an estimate that forgets counts as
        such only while the newest samples kept reach back to the change.
    since_change : int
        Samples since the plant has changed within the record, so that no one model explains it; else 0.
    undecided : bool
        Whether the samples since the last change do not yet tell what it was.
    after_alarm : bool
        Whether the record begins where an alarm ended, and nothing is believed to have changed.
    trusted_before : bool
        Whether the model was trusted when the input came to rest, and nothing has been noticed since.
    since_trusted : int
        Samples since that was last known.
    finished : bool
        Whether the record has ended, and the estimate was then made from all of it.
    missing : int
        Newest samples in a row that came without an output.
    stuck : bool
        Whether the sensor is stuck or saturated, or was just now.
    left_out : int
        Outputs that neither the estimate nor the verdict is made from, as the sensor was stuck or at its limit.
    input_zero : float
        The record's input where that of the actuator is zero.
    slowness : float
        Standard deviation of the estimate over that which the residual's power and colour predict; 1 where they agree.
    output_unit : float
        Unit of the record's output, in the user's unit.
    measured : (W,) array or None
        The output as the sensor gave it; None where the record's output is just that.
    bridged : (W,) array of bool or None
        The samples whose output in the record is the model's, because it is in doubt: the tests of the model leave
        them out.
    """

    structure: Structure
    dt: float
    record: Record
    estimate: FloatArray
    covariance: FloatArray | None
    earlier: FloatArray
    unseen: int
    learned: int
    in_sample: bool = False
    refused: bool = False
    adapts: bool = True
    instruments: bool = True
    follows: bool = False
    largest_power: float = 0.0
    usual_interval: float = 0.0
    disagreement: float = 0.0
    grown: int = 0
    after_change: bool = False
    since_change: int = 0
    undecided: bool = False
    after_alarm: bool = False
    trusted_before: bool = False
    since_trusted: int = 0
    finished: bool = False
    missing: int = 0
    stuck: bool = False
    left_out: int = 0
    input_zero: float = 0.0
    slowness: float = 1.0
    output_unit: float = 1.0
    measured: FloatArray | None = None
    bridged: BoolArray | None = None

    def in_own_units(self) -> Evidence:
        """Return the same evidence with input and output scaled to about one, so that their squares fit into float64.

        The scales are powers of two, so that no sample is rounded.
        """
        of_input, of_output = _power_of_two(self.record.u), _power_of_two(self.record.y)
        n = self.structure.poles
        with np.errstate(over="ignore"):
            factors = np.full(self.estimate.size, of_input / of_output)
        factors[:n] = 1.0
        factors[self.coefficients :] = 1.0 / of_output
        record = dataclasses.replace(self.record, u=self.record.u / of_input, y=self.record.y / of_output)
        if record.before is not None:
            before = record.before
            record = dataclasses.replace(
                record, before=dataclasses.replace(before, u=before.u / of_input, y=before.y / of_output)
            )
        return dataclasses.replace(
            self,
            record=record,
            estimate=self.estimate * factors,
            earlier=self.earlier * factors,
            covariance=None if self.covariance is None else self.covariance * factors * factors[:, None],
            largest_power=self.largest_power / of_input / of_input,
            input_zero=self.input_zero / of_input,
            output_unit=self.output_unit * of_output,
            measured=None if self.measured is None else self.measured / of_output,
        )

    def as_whole(self) -> Evidence:
        """Return the same evidence with nothing held out: every sample tests the present estimate."""
        learned = self.learned + self.unseen
        return dataclasses.replace(self, earlier=self.estimate, unseen=0, learned=learned, in_sample=True)

    @property
    def is_solved(self) -> bool:
        """Whether the estimate is the solution of just these samples."""
        return self.finished and self.in_sample and self.instruments

    @property
    def raw(self) -> FloatArray:
        """The output (W,) as the sensor gave it."""
        return self.record.y if self.measured is None else self.measured

    @property
    def used(self) -> BoolArray:
        """Which samples (W,) the tests of the model use."""
        return self.record.is_measured if self.bridged is None else self.record.is_measured & ~self.bridged

    @property
    def past(self) -> IntArray:
        """How many used samples in a row come before each of those that the estimate should explain, up to LAGS."""
        record = dataclasses.replace(self.record, measured=self.used, before=None)
        return np.minimum(record.predecessors[self.known], np.arange(self.samples)[: self.samples - self.known.start])

    @property
    def coefficients(self) -> int:
        """How many coefficients G(s) has."""
        return self.structure.coefficients

    @property
    def samples(self) -> int:
        """How many samples there are."""
        return self.record.u.size

    @property
    def modes(self) -> tuple[UncertainMode, ...]:
        """The estimate's poles with their uncertainty; none where no covariance is known."""
        if self.covariance is None:
            return ()
        size, structure = self.coefficients, dataclasses.replace(self.structure, bias=False)
        return Uncertainty(structure, self.estimate[:size], self.covariance[:size, :size]).first_order_modes

    @property
    def unstable_pole(self) -> float:
        """Real part of the pole farthest to the right, in rad/s, if the model is unstable; else 0.

        It is not where what grows by that pole grows less than e-fold over the record, nor where the pole may as well
        lie on the axis.
        """
        pole = float(roots(np.concatenate([[1.0], self.estimate[: self.structure.poles]])).real.max())
        if not pole * self.record.span > 1.0:
            return 0.0
        squares = [float(mode.covariance[0, 0]) for mode in self.modes]
        known = zip(self.modes, squares, strict=True)
        is_sure = [mode.mode.pole.real > UNSTABLE_SIGMAS * math.sqrt(max(square, 0.0)) for mode, square in known]
        return pole if any(is_sure) or not is_sure else 0.0

    @property
    def enough(self) -> int:
        """How many samples a test needs."""
        return max(FEWEST, PER_COEFFICIENT * self.coefficients)

    @property
    def counted(self) -> int:
        """Samples that count for whether there are enough: of a whole record those that wait for a dead time, too."""
        return self.record.joined.u.size if self.in_sample else self.samples

    @property
    def is_young(self) -> bool:
        """Whether too few samples came since the earlier estimate to test it on."""
        return not self.in_sample and self.unseen < self.enough

    @property
    def held_out(self) -> int:
        """How many of the newest samples the earlier estimate is tested on; 0 for all."""
        return 0 if self.in_sample or self.is_young else self.unseen

    @property
    def moving(self) -> int:
        """Samples before the input came to rest: what follows stays within a hundredth of its amplitude."""
        away = np.abs(self.record.u - self.record.u[-1])
        far = np.flatnonzero(away > math.sqrt(LEAST_POWER * max(self.largest_power, float(np.var(self.record.u)))))
        return int(far[-1]) + 1 if far.size else 0

    @property
    def was_trusted(self) -> bool:
        """Whether the model was trusted when the input came to rest, and it has rested since."""
        rested = self.samples - self.moving
        return self.trusted_before and (not self.moving or rested >= self.since_trusted + RESTED)

    @property
    def newest(self) -> slice:
        """The samples that the earlier estimate is tested on."""
        return slice(self.samples - self.held_out, self.samples) if self.held_out else slice(0, self.samples)

    @property
    def known(self) -> slice:
        """The samples that the present estimate should explain."""
        return self.newest if self.follows else slice(0, self.samples)

    def seconds(self, samples: int) -> float:
        """Return how long the newest ``samples`` lasted, in s."""
        intervals = self.record.intervals
        return float(intervals[0]) * samples if intervals.size == 1 else float(intervals[-samples:].sum())

    @property
    def span(self) -> str:
        """In words, how long the samples last that the earlier estimate is tested on."""
        return f"the last {self.age}"

    @property
    def age(self) -> str:
        """In words, how long ago the earlier estimate was made."""
        return duration(self.seconds(self.held_out or self.samples))


@dataclass(frozen=True, eq=False)
class Runs:
    """The earlier and the present estimate, each run over the samples.

    Attributes
    ----------
    old, now : ModelRun
    error : (N,) array
        Error of the earlier estimate over the N newest samples, its mean subtracted.
    power : float
        Variance of the output over the newest samples.
    """

    old: ModelRun
    now: ModelRun
    error: FloatArray
    power: float

    @classmethod
    def of(cls, evidence: Evidence, by_reference: FloatArray | None = None) -> Runs | None:
        """Run both estimates; None where a signal leaves float64.

        ``by_reference`` (K, 2) is what a reference explains of input and output.
        """
        old = run_model(evidence.structure, evidence.earlier, evidence.record, evidence.dt, by_reference)
        if old is None:
            return None
        now: ModelRun | None = old
        if not np.array_equal(evidence.earlier, evidence.estimate):
            now = run_model(evidence.structure, evidence.estimate, evidence.record, evidence.dt, by_reference)
        if now is None:
            return None
        error = old.error[evidence.newest]
        return cls(old, now, error - error.mean(), float(np.var(evidence.record.y[evidence.newest])))

    def size(self, step: FloatArray, speeds: FloatArray) -> float:
        """Return the relative size of a step (n,) or (n + m + 1,) of the coefficients; ``speeds`` (n,) of the poles.

        It is the largest of two kinds of terms.  For a_i: abs(step) over the coefficient of prod(s + speed), which is
        the size that a_i would have if all poles were real.  For b_j: half of the output that the step makes, over the
        output.
        """
        n = self.now.structure.poles
        sizes = np.poly(-speeds)[1:]
        largest = float((np.abs(step[:n]) / sizes).max())
        output = float(self.now.forced.std())
        if step.size == n or not output > 0.0:
            return largest
        made = np.abs(step[n:]) * self.now.zeta[:, n:].std(axis=0) / output
        return max(largest, 0.5 * float(made.max()))


def _power_of_two(signal: FloatArray) -> float:
    """Return the largest power of two not above the largest magnitude of a signal; 1 for a signal that is zero."""
    largest = float(np.abs(signal).max(initial=0.0))
    return 2.0 ** math.floor(math.log2(largest)) if largest > 0.0 else 1.0
