"""Search for a change within a record of several inputs: of a load, or of the plant.

The scores from each sample on show where one model fits the record worst (`replant.estimation.solver.change_search`):
those of the offset for a load, of the coefficients for the plant.  A model of a record with the change is a bad judge:
a slow branch follows a load, and an autoregression takes it for noise.  Therefore models of the record when it was
shorter, or of parts of it, are judges, too.  At the samples found suppositions then compete, over the same outputs:

    NOTHING   one model, with one offset and one initial state of each branch
    LOAD      one model; from the sample on a step at the output or at one input, or a new offset and new initial
              states
    PLANT     one branch is another one from the sample on, or the whole model is

Each fitted number costs ln(K) / 2 (Bayes' criterion), and either change -ln `ALPHA`, the prior odds against it.  The
noise model is that of the samples before; NOTHING and LOAD may have their own, as a drift is noise to both.

The newest load is tested again in each search: later samples may show that the plant has changed with it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from replant.estimation.simulation.miso import Point, Row, evaluate, noise_of, summed
from replant.estimation.solver.change_contest import HARMLESS
from replant.estimation.solver.change_evidence import dispersion_of, weighed
from replant.estimation.solver.change_search import surest_begin
from replant.estimation.solver.miso_steps import ends_of, path, refine, start
from replant.estimation.solver.srivc_steps import SOONEST
from replant.kernels.schema import Supposition
from replant.numerics.arguments import BoolArray, FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import combined, least_norm, products, quiet, sum_of_squares
from replant.numerics.projections import WEAKEST

# with 12 records of three loads each, 2 to 9 of them give equal results
SUSPECTED = 3  # most samples at which suppositions compete [count]
# a thousandth of the odds against a change
TOLD = 0.01  # gain of evidence by a step below which the fit of a supposition ends [nats]


class Judge(NamedTuple):
    """A model of the record while it was shorter, or of a part of it."""

    theta: FloatArray  # (P,)
    noise: Autoregression  # of its residual

    @classmethod
    def of(cls, row: Row, theta: FloatArray) -> Judge:
        """Return a model with the noise model of its residual in a row."""
        return cls(theta, noise_of(row, evaluate(row, theta, Autoregression.white(1.0, row.count))))


@dataclass(frozen=True)
class Change:
    """What has changed, and the number of samples of the row before it."""

    supposition: Supposition
    begin: int
    evidence: float  # logarithm of the evidence over that of no change, without the prior odds


@quiet
def find_change(row: Row, theta: FloatArray, judges: Sequence[Judge] = ()) -> Change | None:
    """Return the change in a row's last stretch, or at its begin; None without one, or if references move inputs."""
    end = row.record.u.size
    if not row.stretches or row.stretches[-1].rows.stop < end or row.outside is not None:
        return None
    first = row.stretches[-1].rows.start
    newest = row.last(end - first) if first else row
    found = likeliest_change(newest, theta, judges)
    if found is None:
        return plant_change(row, first, theta, judges) if first else None
    if found.supposition is Supposition.PLANT and _changes_on(newest, found.begin, theta):
        return None
    return replace(found, begin=first + found.begin)


def likeliest_change(
    row: Row, theta: FloatArray, judges: Sequence[Judge], *, of_any_noise: bool = True
) -> Change | None:
    """Return the surest change in a row of one stretch; None if none is sure."""
    begins = set(_suspected(row, theta, judges))
    first = row.parted(min(begins))[0] if begins else row
    if not begins or first.count <= row.nuisances + theta.size:
        return None
    before, noise = _model_before(first, theta, judges)
    begins |= {_Fitted.of(row, before).surest(noise, of_plant=False)[0]} - {0}
    known = without_unknown(row, begins)
    found = _surest(known, begins, [theta, before], noise, of_any_noise)
    # among several changes, only the noise from before counts: a noise model of NOTHING includes the other changes
    if found is None or not of_any_noise:
        return found
    # one model that explains all samples may be far from these
    models = [theta, before, *(each.theta for each in start(row.structures, known.record, row.inputs, noise))]
    return _surest(known, {found.begin}, models, noise)


def _surest(
    row: Row, begins: set[int], models: list[FloatArray], noise: Autoregression, of_any_noise: bool = True
) -> Change | None:
    """Return the surest change at one of some samples; None if none is sure."""
    numbers, alike = row.nuisances + models[0].size, _ends(row, models, noise)
    long_enough = [begin for begin in sorted(begins) if all(part.count > numbers for part in row.parted(begin))]
    before = {begin: _best(row.parted(begin)[0], models, noise) for begin in long_enough}
    claims = [
        claim for begin in before for claim in _claims(row, begin, before[begin], alike, models, noise, of_any_noise)
    ]
    load, plant = (
        max((each for each in claims if each.supposition is what), key=lambda each: each.evidence, default=None)
        for what in (Supposition.LOAD, Supposition.PLANT)
    )
    if load is None or plant is None:
        return None
    base, part = max(load.evidence, 0.0), row.parted(plant.begin)[0]
    theta, length = before[plant.begin].theta, row.record.u.size - plant.begin
    more = weighed(plant.evidence - base, *dispersion_before(part, theta, noise, length))
    odds = -math.log(ALPHA)
    # a change that a load explains nearly as well counts as a load, which is tested again
    best = replace(plant, evidence=base + more) if more > (odds if base > odds else 0.0) else load
    return best if best.evidence > odds else None


def _suspected(row: Row, theta: FloatArray, judges: Sequence[Judge]) -> list[int]:
    """Return the most significant begins of a change, the surest first, at most `SUSPECTED`."""
    model = _Fitted.of(row, theta)
    found = [model.surest(model.noise(), of_plant=True)]
    found += [model.surest(noise, of_plant=False) for noise in model.noise_of_parts(2)]
    for judge in judges:
        found.append(model.surest(judge.noise, of_plant=True))
        found.append(_Fitted.of(row, judge.theta).surest(judge.noise, of_plant=False))
    begins: list[int] = []
    for begin, _ in sorted(found, key=lambda each: -each[1]):
        if begin and begin not in begins:
            begins.append(begin)
    return begins[:SUSPECTED]


def is_suspect(row: Row, theta: FloatArray, *, of_plant: bool = False) -> bool:
    """Return whether a load, or another plant, seems to begin in a row of one stretch, by half of the noise models."""
    model = _Fitted.of(row, theta)
    if of_plant and model.surest(model.noise(), of_plant=True)[0]:
        return True
    # the noise model of a part with a load includes the load; with that of a calm part, a drift looks like a load
    noises = [noise for parts in (2, 4) for noise in model.noise_of_parts(parts)]
    return 2 * sum(model.surest(noise, of_plant=False)[0] > 0 for noise in noises) >= len(noises)


def plant_change(row: Row, begin: int, theta: FloatArray, judges: Sequence[Judge] = ()) -> Change | None:
    """Return the change of the plant at the begin of a stretch; None if the samples on both sides show none."""
    before, since = row.parted(begin)
    if not (before.stretches and since.stretches):
        return None
    # to first order; the noise model of both sides would include the change
    quick = Judge.of(before, refine(before, theta, Autoregression.white(1.0, before.count)).theta)
    least = 0.5 * min(each.size for each in row.structures) * math.log(row.count) - math.log(ALPHA)
    if _explained_by_a_step(since, *quick) < least:
        return None
    known, noise = _model_before(before, theta, judges)
    together, *apart = (_best(each, [theta, known], noise).cost for each in (row, before, since))
    evidence = -math.inf
    if all(0.0 < cost < math.inf for cost in (together, *apart)):
        evidence = 0.5 * row.count * math.log(together / sum(apart)) - 0.5 * theta.size * math.log(row.count)
        evidence = weighed(evidence, *dispersion(before, Judge(known, noise), since.record.u.size))
    if begin in row.record.begins:  # not after a gap, over which a branch cannot be followed
        first = max(each.rows.start for each in row.stretches if each.rows.start < begin)
        end = min(each.rows.stop for each in row.stretches if each.rows.stop > begin)
        record = replace(row.record.part(slice(first, end)), begins=())
        joined = row.over(record, row.inputs[first:end])
        # a change that was first taken for a load may have begun elsewhere
        begins = {begin - first, *_suspected(joined, theta, judges)}
        found = _surest(without_unknown(joined, begins), begins, [theta, known], noise)
        if found is not None and found.supposition is Supposition.PLANT:
            return replace(found, begin=first + found.begin)
    return Change(Supposition.PLANT, begin, evidence) if evidence > -math.log(ALPHA) else None


def _explained_by_a_step(row: Row, theta: FloatArray, noise: Autoregression) -> float:
    """Return the log-likelihood gain of a row by one step from a model, to first order."""
    point = evaluate(row, theta, noise)
    told = summed(point.phi, point.error)
    explained = float(told @ least_norm(point.information, told, WEAKEST)[0])
    return 0.5 * row.count * explained / point.cost if point.cost > 0.0 else 0.0


def _model_before(before: Row, theta: FloatArray, judges: Sequence[Judge]) -> tuple[FloatArray, Autoregression]:
    """Return the best model of the samples before a change, and its noise model."""
    # a model that was fitted to the change is no judge of it, nor is its noise model, which includes the change
    models, noise = [theta, *(judge.theta for judge in judges)], Autoregression.white(1.0, before.count)
    for _ in range(2):
        if not judges:
            models += [each.theta for each in start(before.structures, before.record, before.inputs, noise)[:1]]
        point, last = _best(before, models, noise), noise
        noise = noise_of(before, point)
        if noise.order == last.order == 0:  # the same paths would lead to the same point again
            break
    return point.theta, noise


def _claims(
    row: Row, begin: int, before: Point, alike: list[Point], models: list[FloatArray], noise: Autoregression,
    of_any_noise: bool,
) -> Iterator[Change]:  # fmt: skip
    """Yield a load and a change of the plant at a sample with their evidence.

    The best point of the samples ``before``, and the points of all samples that the models lead to, are known.
    """
    numbers, broken = row.nuisances + models[0].size, row.over(replace(row.record, begins=(begin,)))
    since, load = (_best(each, models, noise) for each in (row.parted(begin)[1], broken))
    nothing = _best(row, [load.theta, since.theta], noise, alike)
    fitted = [
        (Supposition.LOAD, load.cost, row.nuisances),
        (Supposition.LOAD, _cost_of_step(row, begin, load.theta, noise), 1),
        (Supposition.PLANT, before.cost + since.cost, numbers),
        *((Supposition.PLANT, *each) for each in _costs_of_branches(row, begin, nothing.theta, noise)),
    ]
    usual = nothing.cost
    if of_any_noise:
        usual, _ = _with_own_noise(row, nothing, noise)
        shifted, own = _with_own_noise(broken, load, noise)
        step = _cost_of_step(row, begin, load.theta, own) * worth_of_lags(row, own, noise)
        fitted += [(Supposition.LOAD, shifted, row.nuisances), (Supposition.LOAD, step, 1)]
    for supposition, cost, count in fitted:
        if 0.0 < cost < math.inf and 0.0 < usual < math.inf:
            evidence = 0.5 * row.count * math.log(usual / cost) - 0.5 * count * math.log(row.count)
            yield Change(supposition, begin, evidence)


def _with_own_noise(row: Row, point: Point, noise: Autoregression) -> tuple[float, Autoregression]:
    """Return the cost of a model, with its own noise model if that is less, and its own noise model."""
    own = noise_of(row, point)
    cost = refine(row, point.theta, own, point, done=_told(row)).cost
    return min(point.cost, cost * worth_of_lags(row, own, noise)), own


def worth_of_lags(row: Row, own: Autoregression, noise: Autoregression) -> float:
    """Return the factor by which a noise model must lower a cost to be worth its more lags than another one's."""
    return float(row.count ** (max(own.order - noise.order, 0) / row.count))


def _cost_of_step(row: Row, begin: int, theta: FloatArray, noise: Autoregression) -> float:
    """Return the cost of a model with a load step at a sample, at the output or at one input."""
    (stretch,) = row.stretches
    model = _Fitted.of(row, theta)
    columns, error = model.whitened(noise)
    step = (np.arange(error.size) >= begin).astype(float)
    driven = Row(row.structures, row.record, np.repeat(step[:, None], len(row.structures), axis=1))
    answers = driven.signals(theta, driven.stretches[0])[0]
    steps, free = row.whitened(noise, np.column_stack([step, answers]), stretch), columns[:, model.size :]
    left = np.column_stack([steps, error])
    left = left - combined(free, least_norm(free, left, WEAKEST)[0])
    steps, error = left[:, :-1], left[:, -1]
    lengths = np.einsum("kt,kt->t", steps, steps)
    explained = products(steps, error) ** 2 / np.where(lengths > 0.0, lengths, np.inf)
    return sum_of_squares(error) - float(explained.max())


def _costs_of_branches(row: Row, begin: int, theta: FloatArray, noise: Autoregression) -> Iterator[tuple[float, int]]:
    """Yield for each branch the cost of another one from a sample on, and the count of its coefficients and states."""
    centred = row.inputs - row.inputs.mean(axis=0)
    is_since = np.arange(len(centred)) >= begin
    for number, (structure, branch) in enumerate(zip(row.structures, row.branches(theta), strict=True)):
        # the state of the old branch decays by its own poles
        inputs = np.column_stack([centred, np.where(is_since, centred[:, number], 0.0)])
        inputs[is_since, number] = 0.0
        both = Row((*row.structures, structure), row.record, inputs)
        point = refine(both, np.concatenate([theta, branch]), noise, done=_told(row))
        yield point.cost, structure.size + structure.poles


def dispersion_before(before: Row, theta: FloatArray, noise: Autoregression, length: int) -> tuple[float, float]:
    """Return `dispersion_of` a model of the samples before a change, in stretches of ``length``."""
    model = _Fitted.of(before, theta)
    score, white = model.whitened(noise)
    variance = sum_of_squares(white) / max(before.count - score.shape[1], 1)
    return dispersion_of(score, white, np.arange(score.shape[1]) < model.size, length, variance)


def dispersion(row: Row, judge: Judge, length: int | None = None) -> tuple[float, float]:
    """Return the mean `dispersion_of` a model over the stretches of a row, and its degrees of freedom."""
    parts = [row.part(stretch.rows) for stretch in row.stretches]
    models = (_best(part, [judge.theta], judge.noise).theta for part in parts)
    found = [
        dispersion_before(part, theta, judge.noise, length or part.record.u.size)
        for part, theta in zip(parts, models, strict=True)
    ]
    known = [(each, numbers) for each, numbers in found if math.isfinite(numbers)]
    numbers = sum(count for _, count in known)
    return (sum(each * count for each, count in known) / numbers, numbers) if numbers else (1.0, math.inf)


def _best(row: Row, models: Sequence[FloatArray], noise: Autoregression, known: Sequence[Point] = ()) -> Point:
    """Return the point of least cost among ``known`` ones and those refined from some models."""
    return min(_ends(row, models, noise, known), key=lambda point: point.cost)


def _ends(row: Row, models: Sequence[FloatArray], noise: Autoregression, known: Sequence[Point] = ()) -> list[Point]:
    """Return ``known`` points of a row, and the distinct ones refined from some models."""
    return ends_of(row, (path(row, theta, noise, done=_told(row)) for theta in models), known=known)


def _told(row: Row) -> float:
    """Return the relative decrease of a cost that is worth `TOLD`."""
    return 2.0 * TOLD / max(row.count, 1)


def _changes_on(row: Row, begin: int, theta: FloatArray) -> bool:
    """Return whether a plant also changes before or after a sample: one that changes continually is not linear."""
    white = Autoregression.white(1.0, row.count)
    away = _fewest(row, theta.size)  # the change itself lies near the sample
    parts = row.parted(max(begin - away, 1))[0], row.parted(min(begin + away, row.record.u.size - 1))[1]
    models = (_Fitted.of(part, refine(part, theta, white).theta) for part in parts if part.stretches)
    return any(model.surest(model.noise(), of_plant=True)[0] for model in models)


def _fewest(row: Row, size: int) -> int:
    """Return the fewest samples needed before and after a change of a model."""
    return max(4 * (size + row.nuisances), SOONEST)


@dataclass(frozen=True, eq=False)
class _Fitted:
    """A model of a row of one stretch with fitted offset and initial states: slopes and residual."""

    row: Row
    size: int  # of the model
    columns: FloatArray  # (K, P + N): slopes, and nuisances
    error: FloatArray  # (K,): zero where not measured

    @classmethod
    def of(cls, row: Row, theta: FloatArray) -> _Fitted:
        (stretch,) = row.stretches
        outputs, slopes, free = row.signals(theta, stretch)
        left, rows = stretch.y - outputs.sum(axis=1), stretch.measured
        left = left - combined(free, least_norm(free[rows], left[rows], WEAKEST)[0])
        return cls(row, theta.size, np.column_stack([slopes, free]), np.where(rows, left, 0.0))

    def noise(self, rows: BoolArray | bool = True) -> Autoregression:
        """Return the noise model of the error, or of some of its rows (K,), minus their mean."""
        (stretch,) = self.row.stretches
        used = stretch.measured & rows
        level = float(self.error[used].mean()) if used.any() else 0.0
        error = np.where(stretch.measured, self.error - level, 0.0)
        return Autoregression.of_residual(error, np.where(rows, stretch.known, 0), int(used.sum()))

    def noise_of_parts(self, count: int) -> list[Autoregression]:
        """Return the noise models of ``count`` parts, as that of the whole includes the step of a load."""
        number = np.arange(self.error.size) * count // self.error.size
        return [self.noise(number == part) for part in range(count)]

    def whitened(self, noise: Autoregression) -> tuple[FloatArray, FloatArray]:
        """Return columns and error filtered by a noise model."""
        (stretch,) = self.row.stretches
        return self.row.whitened(noise, self.columns, stretch), self.row.whitened(noise, self.error, stretch)

    def surest(self, noise: Autoregression, *, of_plant: bool) -> tuple[int, float]:
        """Return the surest begin of a change, and its statistic over the limit; 0 if it may be chance."""
        (stretch,) = self.row.stretches
        if float(np.std(self.error)) < HARMLESS * float(np.std(stretch.y[stretch.measured])):
            return 0, 0.0
        slopes, white = self.whitened(noise)
        told = slopes if of_plant else self.row.whitened(noise, np.ones((white.size, 1)), stretch)
        fewest, size = _fewest(self.row, self.size), self.size if of_plant else 1
        return surest_begin(np.column_stack([told, white]), size, fewest, self.row.count)


def without_unknown(row: Row, begins: set[int]) -> Row:
    """Return the row without outputs that depend on inputs before a begin: all suppositions use the same outputs."""
    measured = row.record.is_measured.copy()
    for begin in begins:
        since = row.record.last(row.record.u.size - begin)
        measured[begin : begin + max(since.unknown(each.delay) for each in row.structures)] = False
    return row.over(replace(row.record, measured=measured))
