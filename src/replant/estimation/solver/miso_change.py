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

from replant.estimation.simulation.miso import Point, Row, evaluate, noise_of
from replant.estimation.solver.change_contest import HARMLESS
from replant.estimation.solver.change_search import worst_begin
from replant.estimation.solver.known_before import dispersion_of, weighed
from replant.estimation.solver.miso_start import start
from replant.estimation.solver.miso_steps import refine
from replant.estimation.solver.srivc_steps import SOONEST
from replant.kernels.schema import Supposition
from replant.numerics.arguments import FloatArray
from replant.numerics.autoregression import Autoregression
from replant.numerics.levels import ALPHA
from replant.numerics.linear_algebra import quiet


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
    newest = row.last(end - row.stretches[-1].rows.start)
    found = _likeliest(newest, theta)
    if found is None or (found.supposition is Supposition.PLANT and _changes_on(newest, found.begin, theta)):
        return None
    return replace(found, begin=end - newest.record.u.size + found.begin)


def _likeliest(row: Row, theta: FloatArray) -> Change | None:
    """Return what is surest to have changed in a row of one stretch; None where nothing is."""
    point = evaluate(row, theta, Autoregression.white(1.0, row.count))
    noises = _noise_of_halves(row, point)
    begins = {_worst(row, point, noise_of(row, point), of_plant=True)}
    begins = (begins | {_worst(row, point, noise, of_plant=False) for noise in noises}) - {0}
    first = _parts(row, min(begins))[0] if begins else row
    if not begins or first.count <= row.nuisances + theta.size:
        return None
    models, point, noise = _judges(first, theta)
    begins |= {_worst(row, evaluate(row, point.theta, noise), noise, of_plant=False)} - {0}
    known = _without_unknown(row, begins)
    claims = [claim for begin in sorted(begins) for claim in _claims(known, begin, models, noise)]
    if not claims:
        return None
    load, plant = (
        max((each for each in claims if each.supposition is what), key=lambda each: each.evidence)
        for what in (Supposition.LOAD, Supposition.PLANT)
    )
    base, before = max(load.evidence, 0.0), _parts(known, plant.begin)[0]
    more = weighed(plant.evidence - base, *_dispersion(before, models, noise, row.record.u.size - plant.begin))
    best = replace(plant, evidence=base + more) if more > 0.0 else load
    return best if best.evidence > -math.log(ALPHA) else None


def _noise_of_halves(row: Row, point: Point) -> Iterator[Autoregression]:
    """Yield the noise model of either half of a stretch: that of both takes the step of a load for noise."""
    (stretch,), (residual,) = row.stretches, point.residual
    is_late = np.arange(residual.size) >= residual.size // 2
    for half in (~is_late, is_late):
        yield Autoregression.of_residual(residual, np.where(half, stretch.known, 0), int(stretch.measured[half].sum()))


def _judges(before: Row, theta: FloatArray) -> tuple[list[FloatArray], Point, Autoregression]:
    """Return where to look for models, the best one of the samples before a change, and the noise that this leaves.

    A model that the change has led astray is no judge of it, nor is its noise: it takes the change for noise.
    """
    models, noise = [theta], Autoregression.white(1.0, before.count)
    for _ in range(2):
        models += [each.theta for each in start(before.structures, before.record, before.inputs, noise)[:1]]
        point = _best(before, models, noise)
        noise = noise_of(before, point)
    return models, point, noise


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
    (stretch,), point = before.stretches, _best(before, models, noise)
    _, slopes, free = before.signals(point.theta, stretch, point.nuisances[0][1:])
    score = before.whitened(noise, np.column_stack([slopes, free]), stretch)
    white = before.whitened(noise, point.residual[0], stretch)
    variance = float(white @ white) / max(before.count - score.shape[1], 1)
    return dispersion_of(score, white, np.arange(score.shape[1]) < point.theta.size, length, variance)


def _best(row: Row, models: Sequence[FloatArray], noise: Autoregression) -> Point:
    """Return the point of least cost that steps from some models lead to."""
    return min((refine(row, theta, noise) for theta in models), key=lambda point: point.cost)


def _changes_on(row: Row, begin: int, theta: FloatArray) -> bool:
    """Return whether a plant changes before and since a sample, too: what changes on and on is not linear."""
    white, away = Autoregression.white(1.0, row.count), _fewest(row, theta)  # the change itself lies near the sample
    parts = _parts(row, max(begin - away, 1))[0], _parts(row, min(begin + away, row.record.u.size - 1))[1]
    fitted = ((part, refine(part, theta, white)) for part in parts if part.stretches)
    return any(_worst(part, point, noise_of(part, point), of_plant=True) for part, point in fitted)


def _worst(row: Row, point: Point, noise: Autoregression, *, of_plant: bool) -> int:
    """Return the sample since which a point fits a row of one stretch worst; 0 where that may be chance."""
    (stretch,), size, error = row.stretches, point.theta.size, point.residual[0]
    if float(np.std(error)) < HARMLESS * float(np.std(stretch.y[stretch.measured])):
        return 0
    _, slopes, free = row.signals(point.theta, stretch, point.nuisances[0][1:])
    score = row.whitened(noise, np.column_stack([slopes, free]) if of_plant else free[:, :1], stretch)
    white = row.whitened(noise, error, stretch)
    return worst_begin(score, white, size if of_plant else 1, _fewest(row, point.theta), row.count)


def _fewest(row: Row, theta: FloatArray) -> int:
    """Return the fewest samples before or since a change that are looked into."""
    return max(4 * (theta.size + row.nuisances), SOONEST)


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
