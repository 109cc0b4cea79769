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
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.engine.record import Record
from replant.estimation.simulation.auxiliary_model import AuxiliaryModel, stability_margin
from replant.estimation.simulation.miso import Point, Row, evaluate
from replant.estimation.solver.miso_steps import start
from replant.estimation.solver.refined_estimate import without_nuisances
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.undetermined_poles import INFINITE, grown, with_poles
from replant.fitting.miso_solve import covariance_of, differs, likeliest
from replant.kernels.schema import LAGS
from replant.model.state_space import unknown_outputs
from replant.model.structure import Structure
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import chi2_quantile, quiet, real_coefficients, sum_of_squares
from replant.verdict.assess import MOST_SAMPLES
from replant.verdict.estimate_tests import MOST_UNCERTAIN, without_longer
from replant.verdict.verdict import Assessment

ALPHA = 1e-2  # level at which a better likelihood is more than chance [probability]

# a converter of 20 bits resolves as much
FINEST = 1e-6  # deviation of a residual below which it is no evidence [part of the output's standard deviation]


Structures = tuple[Structure, ...]  # one for each input


@dataclass(frozen=True, eq=False)
class Trial:
    """Structures fitted to a record of K samples, and how likely the model makes them."""

    likelihood: float  # logarithm of that of all samples
    price: float  # ln(K) / 2 for every number that was fitted
    fit: float  # in percent, of the simulated output, or of an unstable model of that predicted one step ahead
    structures: Structures
    models: list[FloatArray]  # of each input: its coefficients, and the numbers that a solver has found with them
    covariances: Callable[[], list[FloatArray]]  # of each of these

    @property
    def evidence(self) -> float:
        """The log-likelihood less the price."""
        return self.likelihood - self.price

    def is_within(self, structures: Structures) -> bool:
        """Return whether the structures are no larger than others with the same dead times."""
        pairs = zip(self.structures, structures, strict=True)
        return all(a.delay == b.delay and a.poles <= b.poles and a.zeros <= b.zeros for a, b in pairs)

    def grown(self, structures: Structures, lag: float) -> list[FloatArray]:
        """Return the models as those of larger structures, whose additional poles have a lag in s."""
        return [
            theta
            if sizes_of([less]) == sizes_of([more])
            else np.append(
                grown(less, theta, more, lag), np.zeros(theta.size - less.coefficients + more.poles - less.poles)
            )
            for less, theta, more in zip(self.structures, self.models, structures, strict=True)
        ]

    @quiet
    def uncertainty(self, span: float) -> float:
        """Return the largest standard deviation of a coefficient as a part of its size."""
        parts = []
        for structure, theta, covariance in zip(self.structures, self.models, self.covariances(), strict=True):
            std = np.sqrt(np.maximum(np.diag(covariance)[: structure.coefficients], 0.0))
            # the size of a_i is that of the coefficient of prod(s + abs(pole)), as if all poles were real
            denominator = real_coefficients(theta[structure.denominator], 1.0 / span)
            sizes = np.concatenate([denominator, np.abs(theta[structure.numerator])])
            parts.append(std / np.maximum(sizes, np.finfo(float).tiny))
        largest = float(np.concatenate(parts).max())
        return largest if math.isfinite(largest) else math.inf


def sizes_of(structures: Iterable[Structure]) -> list[tuple[int, int]]:
    """Return the numbers of poles and zeros."""
    return [(each.poles, each.zeros) for each in structures]


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
        judged = self.judged(error, explained, numbers_of(structure))
        return Trial(*judged, (structure,), [found.theta], lambda: [found.covariance])

    def trials(self, structures: Structures, begin: Trial | None, *, afresh: bool) -> tuple[Trial, Trial] | None:
        """Return the trial of a structure twice, started from another one or ``afresh``, as `RowEvidence` does."""
        given = [] if begin is None else begin.grown(structures, self.record.dt / INFINITE)
        trial = self.of(structures[0], given, afresh=afresh) if np.ptp(self.record.u) > 0.0 else None
        return None if trial is None else (trial, trial)

    def in_motion(self, trial: Trial) -> Evidence | None:
        """Return the evidence without the rest before the record, if that makes a trial likelier than by chance."""
        (structure,) = trial.structures
        if not (self.at_rest and structure.delay):
            return None
        moving = Evidence(self.record, at_rest=False)
        found = moving.of(structure, trial.models)
        unknown = self.record.unknown(structure.delay) * len(self.record.parts)
        gain = -math.inf if found is None else found.evidence - trial.evidence
        return moving if gain > 0.5 * chi2_quantile(1.0 - ALPHA, unknown) else None

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


class RowEvidence:
    """Fits the structures of several inputs to one record, and computes their evidence.

    If a structure is wrong, an autoregression explains its error as noise: with little noise in the record it predicts
    a smooth error almost as well as a right structure does, and the evidence does not discriminate.  As long as this
    holds for all trials (`differs`), they are judged by their errors without a noise model.
    """

    def __init__(self, record: Record, inputs: FloatArray) -> None:
        self.record, self.inputs, self._evidence = record, inputs, Evidence(record, at_rest=False)

    @quiet
    def trials(self, structures: Structures, begin: Trial | None, *, afresh: bool) -> tuple[Trial, Trial] | None:
        """Return the trials without and with noise model, from another trial, ``afresh`` also from new starts."""
        row = Row(structures, self.record, self.inputs)
        if row.count <= sum(each.size for each in structures) + row.nuisances:
            return None
        begins = start(structures, self.record, self.inputs) if afresh else []
        if begin is not None:
            pairs = zip(begin.grown(structures, row.dt), structures, strict=True)
            theta = np.concatenate([each[: structure.coefficients] for each, structure in pairs])
            begins += [evaluate(row, theta, Autoregression.white(1.0, row.count))] if row.is_stable(theta) else []
        if not begins:
            return None
        free, point, noise, *_ = likeliest(row, begins, lambda noise: [])
        found = self._judged(row, point, whitened=True)
        if found is None or not noise.order or not differs(row, free, point):
            return None if found is None else (found, found)  # the noise model explains nothing but noise
        plain = self._judged(row, free, whitened=False)
        return None if plain is None else (plain, found)

    def in_motion(self, trial: Trial) -> None:
        """Return None: the rest before the record is never assumed."""

    def _judged(self, row: Row, point: Point, *, whitened: bool) -> Trial | None:
        error, explained = np.zeros(self.record.u.size), np.zeros(self.record.u.size, bool)
        for stretch, residual in zip(row.stretches, point.residual, strict=True):
            error[stretch.rows], explained[stretch.rows] = residual, stretch.measured
        if not (np.isfinite(error).all() and explained.any()):
            return None
        judged = self._evidence.judged(error, explained, sum(map(numbers_of, row.structures)), whitened=whitened)

        def covariances() -> list[FloatArray]:
            covariance = covariance_of(row, point)
            return [covariance[rows, rows] for rows in row.places]

        return Trial(*judged, row.structures, row.branches(point.theta), covariances)


def with_fewer_poles(verdict: Assessment, structure: Structure, parameters: FloatArray, record: Record) -> Assessment:
    """Return the verdict on a model (P,), with a reason if fewer poles have more evidence: first, unless trusted."""
    is_uncertain = verdict.excited and verdict.uncertainty > MOST_UNCERTAIN
    if structure.poles == 1 or structure.feedthrough or not is_uncertain:  # no smaller model is worth trying
        return verdict
    evidence = Evidence(record.last(MOST_SAMPLES), at_rest=not structure.delay)
    trials = [evidence.of(structure, [without_nuisances(structure, parameters)])]
    trials += [evidence.of(with_poles(structure, poles), ()) for poles in range(1, structure.poles)]
    best = max(filter(None, trials), key=lambda trial: trial.evidence, default=None)
    if best is None or best.structures[0].poles == structure.poles:
        return verdict
    fewer = best.structures[0].poles
    reason = f"with fewer poles the record is likelier: ask for {'one pole' if fewer == 1 else f'{fewer} poles'}"
    verdict = without_longer(verdict)  # no longer record determines a pole that does not exist
    reasons = (*verdict.reasons, reason) if verdict.status == "trusted" else (reason, *verdict.reasons)
    return replace(verdict, reasons=reasons)
