"""Search for a change within a record of several inputs: of a load, or of the plant.

The scores since each sample tell where one model fits the record worst (`replant.estimation.solver.change_search`): of
the offset for a load, of the coefficients for the plant.  Since the samples found suppositions then compete, over the
same outputs and with one noise model:

    NOTHING   one model, with one offset and one initial state of each branch
    LOAD      one model; offset and initial states are new since the sample
    PLANT     a model before and another one since

Each fitted number costs ln(K) / 2 (Bayes' criterion), and either change -ln `ALPHA`: the odds against it before any
sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from replant.estimation.simulation.miso import Point, Row, noise_of
from replant.estimation.solver.change_contest import HARMLESS
from replant.estimation.solver.change_search import worst_begin
from replant.estimation.solver.known_before import dispersion_of, weighed
from replant.estimation.solver.miso_start import start
from replant.estimation.solver.miso_steps import refine
from replant.estimation.solver.srivc_steps import SOONEST
from replant.kernels.schema import Supposition
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import least_norm, quiet
from replant.numerics.projections import WEAKEST


@dataclass(frozen=True)
class Change:
    """What has changed, and how many samples of the row were before."""

    supposition: Supposition
    begin: int
    evidence: float  # logarithm of the evidence over that of no change, the odds against it beforehand aside


@quiet
def find_change(row: Row, theta: FloatArray) -> Change | None:
    """Return what has changed within the last stretch of a row since it had a model; None where that explains it.

    Nor does one say what has changed where references move inputs.
    """
    end = row.record.u.size
    if not row.stretches or row.stretches[-1].rows.stop < end or row.outside is not None:
        return None
    first = row.stretches[-1].rows.start
    newest = row.last(end - first) if first else row
    found = _likeliest(newest, theta)
    if found is None or (found.supposition is Supposition.PLANT and _changes_on(newest, found.begin, theta)):
        return None
    return replace(found, begin=first + found.begin)


def _likeliest(row: Row, theta: FloatArray) -> Change | None:
    """Return what is surest to have changed in a row of one stretch; None where nothing is."""
    model = _Fitted.of(row, theta)
    begins = {model.worst(model.noise(), of_plant=True)}
    begins = (begins | {model.worst(noise, of_plant=False) for noise in model.noise_of_halves()}) - {0}
    first = _parts(row, min(begins))[0] if begins else row
    if not begins or first.count <= row.nuisances + theta.size:
        return None
    models, before, noise = _judges(first, theta)
    begins |= {_Fitted.of(row, before).worst(noise, of_plant=False)} - {0}
    known = _without_unknown(row, begins)
    claims = [claim for begin in sorted(begins) for claim in _claims(known, begin, models, noise)]
    if not claims:
        return None
    load, plant = (
        max((each for each in claims if each.supposition is what), key=lambda each: each.evidence)
        for what in (Supposition.LOAD, Supposition.PLANT)
    )
    base, part = max(load.evidence, 0.0), _parts(known, plant.begin)[0]
    more = weighed(plant.evidence - base, *_dispersion(part, models, noise, row.record.u.size - plant.begin))
    best = replace(plant, evidence=base + more) if more > 0.0 else load
    return best if best.evidence > -math.log(ALPHA) else None


def _judges(before: Row, theta: FloatArray) -> tuple[list[FloatArray], FloatArray, Autoregression]:
    """Return where to look for models, the best one of the samples before a change, and the noise that this leaves.

    A model that the change has led astray is no judge of it, nor is its noise: it takes the change for noise.
    """
    models, noise = [theta], Autoregression.white(1.0, before.count)
    for _ in range(2):
        models += [each.theta for each in start(before.structures, before.record, before.inputs, noise)[:1]]
        point = _best(before, models, noise)
        noise = noise_of(before, point)
    return models, point.theta, noise


def _claims(row: Row, begin: int, models: list[FloatArray], noise: Autoregression) -> Iterator[Change]:
    """Yield what a load and another plant since a sample explain, where the samples tell."""
    parts, numbers = _parts(row, begin), row.nuisances + models[0].size
    if any(part.count <= numbers for part in parts):
        return
    broken = Row(row.structures, replace(row.record, begins=(begin,)), row.inputs, row.names)
    before, since, nothing, load = (_best(each, models, noise).cost for each in (*parts, row, broken))
    if not all(0.0 < cost < math.inf for cost in (nothing, load, before + since)):
        return
    fitted = (Supposition.LOAD, load, row.nuisances), (Supposition.PLANT, before + since, numbers)
    for supposition, cost, count in fitted:
        evidence = 0.5 * row.count * math.log(nothing / cost) - 0.5 * count * math.log(row.count)
        yield Change(supposition, begin, evidence)


def _dispersion(before: Row, models: Sequence[FloatArray], noise: Autoregression, length: int) -> tuple[float, float]:
    """Return `dispersion_of` the samples before a change, in stretches of so many."""
    model = _Fitted.of(before, _best(before, models, noise).theta)
    score, white = model.whitened(noise)
    variance = float(white @ white) / max(before.count - score.shape[1], 1)
    return dispersion_of(score, white, np.arange(score.shape[1]) < model.size, length, variance)


def _best(row: Row, models: Sequence[FloatArray], noise: Autoregression) -> Point:
    """Return the point of least cost that steps from some models lead to."""
    return min((refine(row, theta, noise) for theta in models), key=lambda point: point.cost)


def _changes_on(row: Row, begin: int, theta: FloatArray) -> bool:
    """Return whether a plant changes before and since a sample, too: what changes on and on is not linear."""
    white = Autoregression.white(1.0, row.count)
    away = _fewest(row, theta.size)  # the change itself lies near the sample
    parts = _parts(row, max(begin - away, 1))[0], _parts(row, min(begin + away, row.record.u.size - 1))[1]
    models = (_Fitted.of(part, refine(part, theta, white).theta) for part in parts if part.stretches)
    return any(model.worst(model.noise(), of_plant=True) for model in models)


def _fewest(row: Row, size: int) -> int:
    """Return the fewest samples before or since a change of a model that are looked into."""
    return max(4 * (size + row.nuisances), SOONEST)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A model of a row of one stretch with the offset and initial states that fit it: slopes and what it leaves."""

    row: Row
    size: int  # of the model
    columns: FloatArray  # (K, P + N): slopes, and responses to offset and initial states
    error: FloatArray  # (K,): zero where not measured

    @classmethod
    def of(cls, row: Row, theta: FloatArray) -> _Fitted:
        (stretch,) = row.stretches
        outputs, slopes, free = row.signals(theta, stretch, np.zeros(row.nuisances - 1))
        left, rows = stretch.y - outputs.sum(axis=1), stretch.measured
        left = left - free @ least_norm(free[rows], left[rows], WEAKEST)[0]
        return cls(row, theta.size, np.column_stack([slopes, free]), np.where(rows, left, 0.0))

    def noise(self, rows: BoolArray | bool = True) -> Autoregression:
        """Return the noise model of the error, or of some of its rows (K,)."""
        (stretch,) = self.row.stretches
        count = int((stretch.measured & rows).sum())
        return Autoregression.of_residual(self.error, np.where(rows, stretch.known, 0), count)

    def noise_of_halves(self) -> list[Autoregression]:
        """Return that of either half: that of both takes the step of a load for noise."""
        is_late = np.arange(self.error.size) >= self.error.size // 2
        return [self.noise(~is_late), self.noise(is_late)]

    def whitened(self, noise: Autoregression) -> tuple[FloatArray, FloatArray]:
        """Return columns and error filtered by a noise model."""
        (stretch,) = self.row.stretches
        return self.row.whitened(noise, self.columns, stretch), self.row.whitened(noise, self.error, stretch)

    def worst(self, noise: Autoregression, *, of_plant: bool) -> int:
        """Return the sample since which coefficients or offset fit worst; 0 where that may be chance."""
        (stretch,) = self.row.stretches
        if float(np.std(self.error)) < HARMLESS * float(np.std(stretch.y[stretch.measured])):
            return 0
        score, white = self.whitened(noise)
        if not of_plant:
            score = np.ascontiguousarray(score[:, self.size : self.size + 1])
        fewest = _fewest(self.row, self.size)
        return worst_begin(score, white, self.size if of_plant else 1, fewest, self.row.count)


def _parts(row: Row, begin: int) -> tuple[Row, Row]:
    """Return the row before and since a sample."""
    before = Row(row.structures, row.record.first(begin), row.inputs[:begin], row.names)
    return before, row.last(row.record.u.size - begin)


def _without_unknown(row: Row, begins: set[int]) -> Row:
    """Return the row without outputs that answer, since some samples, to inputs before these.

    A stretch begun at any of them has none of these; so all suppositions are told by the same outputs.
    """
    measured = row.record.is_measured.copy()
    for begin in begins:
        since = row.record.last(row.record.u.size - begin)
        measured[begin : begin + max(since.unknown(each.delay) for each in row.structures)] = False
    return Row(row.structures, replace(row.record, measured=measured), row.inputs, row.names)
