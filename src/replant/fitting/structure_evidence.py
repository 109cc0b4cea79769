r"""Evidence for a structure: how likely a model of it makes all samples of a record.

A model gives the density of every output, given its past: that of the innovation, the error of the output predicted one
step ahead, filtered by its own autoregression D(q).  For a stable model this error is that of the simulation; an
unstable one is judged by the same figure.  The evidence is

.. math:: \ln p(y \mid \hat\theta) - \tfrac12 N \ln K,

with N numbers fitted to K samples: the coefficients, a dead time, the initial state, the autoregression.  It is
Laplace's approximation of the marginal likelihood.  A wrong model can leave the response of the plant to its
autoregression, but pays for that, too.

All structures are compared over the same samples.  With a dead time the first outputs depend on inputs before the
record.  Either the input was held before it, as before a step test: the record is then extended backwards.  Or the
plant was in motion: these outputs are then predicted from the outputs before them, without a model of the plant.

Source: Schwarz (1978), "Estimating the dimension of a model", Annals of Statistics 6; Ljung (1999), "System
Identification: Theory for the User", section 16.4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel, stability_margin
from replant.estimation.solver.refined_estimate import Refined, without_nuisances
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.undetermined_poles import INFINITE, grown, with_poles
from replant.kernels.schema import LAGS
from replant.model.state_space import unknown_outputs
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import quiet, real_coefficients, sum_of_squares
from replant.verdict.assess import MOST_SAMPLES
from replant.verdict.estimate_tests import MOST_UNCERTAIN, without_longer
from replant.verdict.verdict import Assessment

# a converter of 20 bits resolves as much
FINEST = 1e-6  # deviation of a residual below which it is no evidence [part of the output's standard deviation]


@dataclass(frozen=True, eq=False)
class Judged:
    """How likely a model makes a record of K samples."""

    likelihood: float  # logarithm of that of all samples
    price: float  # ln(K) / 2 for every number that was fitted
    fit: float  # in percent, of the simulated output, or of an unstable model of that predicted one step ahead

    @property
    def evidence(self) -> float:
        """The log-likelihood less the price."""
        return self.likelihood - self.price


@dataclass(frozen=True, eq=False)
class Trial(Judged):
    """A structure fitted to a record."""

    structure: Structure
    found: Refined

    def grown(self, structure: Structure, dt: float) -> FloatArray:
        """Return the model as one of a larger structure, with very fast additional poles."""
        less, theta = self.structure, self.found.theta
        model = np.zeros(theta.size + structure.coefficients - less.coefficients + structure.poles - less.poles)
        model[: structure.coefficients] = grown(less, theta, structure, dt / INFINITE)
        return model


@quiet
def least_known(structure: Structure, theta: FloatArray, covariance: FloatArray, span: float) -> float:
    """Return the largest standard deviation of a coefficient as a part of its size."""
    std = np.sqrt(np.maximum(np.diag(covariance)[: structure.coefficients], 0.0))
    # of a_i the size is that of the coefficient of prod(s + abs(pole)), as if all poles were real; of b_j its own
    denominator = real_coefficients(theta[structure.denominator], 1.0 / span)
    sizes = np.concatenate([denominator, np.abs(theta[structure.numerator])])
    largest = float((std / np.maximum(sizes, np.finfo(float).tiny)).max())
    return largest if math.isfinite(largest) else math.inf


class Evidence:
    """Fits structures to one record, and computes their evidence."""

    @quiet
    def __init__(self, record: Record, *, at_rest: bool) -> None:
        self.record, self.at_rest = record, at_rest
        self._known = record.is_measured
        # variance of a residual below which it is no evidence
        self.least = (FINEST * float(np.std(record.y[self._known]))) ** 2
        self._alone = self._densities(record.y - record.y[self._known].mean(), self._known)[0]
        self._alone[: LAGS + 1] = np.median(self._alone[self._known])  # the first outputs are free in every model
        self._alone[~self._known] = 0.0  # missing outputs do not count

    @quiet
    def of(self, structure: Structure, given: Sequence[FloatArray], *, afresh: bool = False) -> Trial | None:
        """Return the trial of a structure, started from given estimates; None if no start leads to a model."""
        record, own = self._with_beginning(structure.delay)
        found = refine(structure, record, given, afresh=afresh)
        if found is None:
            return None
        referenced = record.r is not None
        model = AuxiliaryModel(
            structure, record.dt, record.input_hold, margin=stability_margin(record), reference=referenced
        )
        error = model.run(found.theta, record, np.zeros((record.u.size, 2)) if referenced else None).ahead[own]
        explained = self._explained(structure.delay)
        if not (np.isfinite(error).all() and explained.any()):
            return None
        return Trial(*self.judged(error, explained, numbers_of(structure)), structure, found)

    @quiet
    def of_error(self, structure: Structure, error: FloatArray) -> tuple[float, Autoregression]:
        """Return the evidence of a model with an error (K,), and the autoregression of that."""
        explained = self._explained(structure.delay)
        likelihood, price, _ = self.judged(error, explained, numbers_of(structure))
        return likelihood - price, self._noise(error, explained)

    def judged(
        self, error: FloatArray, explained: BoolArray, numbers: int, *, whitened: bool = True
    ) -> tuple[float, float, float]:
        """Return the log-likelihood of all samples by a model's error (K,), its price, and its fit in percent."""
        densities, order = self._densities(error, explained, whitened=whitened)
        measured = self.record.y[explained]
        spread = max(math.sqrt(sum_of_squares(measured - measured.mean())), np.finfo(float).tiny)
        return (
            float(np.where(explained, densities, self._alone).sum()),
            0.5 * (numbers + order) * math.log(error.size),
            100.0 * (1.0 - math.sqrt(sum_of_squares(error[explained])) / spread),
        )

    def _with_beginning(self, delay: float) -> tuple[Record, BoolArray]:
        """Return the record, extended backwards by a dead time if it begins at rest, and which samples are its own."""
        record, own = self.record, self._known
        intervals = np.broadcast_to(record.intervals, own.shape)
        usual = float(np.median(intervals))
        count = unknown_outputs(delay, usual)
        if not (self.at_rest and count):
            return record, np.ones(own.size, bool)
        begins = np.array([rows.start for rows in record.parts])
        at = np.repeat(begins, count)
        if record.intervals.size > 1:
            longer, firsts = np.insert(intervals, at, usual), begins + count * np.arange(begins.size)
            longer[firsts], longer[firsts + count] = intervals[begins], usual
        else:
            longer = record.intervals
        u, y = (np.insert(signal, at, signal[at]) for signal in (record.u, record.y))
        r = None if record.r is None else np.insert(record.r, at, record.r[at])
        measured = None if record.measured is None else np.insert(record.measured, at, record.measured[at])
        later = {int(begin): int(begin) + count * k for k, begin in enumerate(begins)}
        own_begins = tuple(later[begin] for begin in record.begins)
        longer_record = replace(record, u=u, y=y, r=r, intervals=longer, measured=measured, begins=own_begins)
        return longer_record, np.insert(np.ones(own.size, bool), at, False)

    def _explained(self, delay: float) -> BoolArray:
        """Return which outputs (K,) depend on known inputs alone."""
        return self._known if self.at_rest else self._known & self.record.answers(delay)

    def _densities(self, error: FloatArray, explained: BoolArray, *, whitened: bool = True) -> tuple[FloatArray, int]:
        """Return the log-densities (K,) of an error (K,) under an autoregression of its own, and its order."""
        known = replace(self.record, measured=explained).predecessors
        noise = self._noise(error, explained) if whitened else Autoregression.white(1.0, error.size)
        white = noise.whiten_known(error, known)
        variance = max(float(np.mean(white[explained] ** 2)), self.least, np.finfo(float).tiny)
        # a sample with a shorter past is predicted less well
        power = max(float(noise.powers[noise.order]), np.finfo(float).tiny)
        wider = np.maximum(noise.powers[np.minimum(known, noise.order)] / power, 1.0)
        return -0.5 * (white**2 / variance + np.log(2.0 * math.pi * variance * wider)), noise.order

    def _noise(self, error: FloatArray, explained: BoolArray) -> Autoregression:
        power = sum_of_squares(error[explained])
        if power > self.least * error.size:
            known = replace(self.record, measured=explained).predecessors
            return Autoregression.of_residual(error, known, error.size)
        return Autoregression.white(power, error.size)


def numbers_of(structure: Structure) -> int:
    """Return how many numbers are fitted: coefficients, a dead time, the initial state."""
    return structure.size + structure.poles + bool(structure.delay)


def with_fewer_poles(verdict: Assessment, structure: Structure, parameters: FloatArray, record: Record) -> Assessment:
    """Return the verdict on a model (P,), with a reason if fewer poles have more evidence: first, unless trusted."""
    is_uncertain = verdict.excited and verdict.uncertainty > MOST_UNCERTAIN
    if structure.poles == 1 or structure.feedthrough or not is_uncertain:  # no smaller model is worth trying
        return verdict
    evidence = Evidence(record.last(MOST_SAMPLES), at_rest=not structure.delay)
    trials = [evidence.of(structure, [without_nuisances(structure, parameters)])]
    trials += [evidence.of(with_poles(structure, poles), ()) for poles in range(1, structure.poles)]
    best = max(filter(None, trials), key=lambda trial: trial.evidence, default=None)
    if best is None or best.structure.poles == structure.poles:
        return verdict
    fewer = best.structure.poles
    reason = f"with fewer poles the record is likelier: ask for {'one pole' if fewer == 1 else f'{fewer} poles'}"
    verdict = without_longer(verdict)  # no longer record determines a pole that does not exist
    reasons = (*verdict.reasons, reason) if verdict.status == "trusted" else (reason, *verdict.reasons)
    return replace(verdict, reasons=reasons)
