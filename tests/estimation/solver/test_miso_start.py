"""Where the solution of several inputs begins."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from replant.estimation.engine.record import Record
from replant.estimation.simulation.miso import Row, RowRecord, evaluate
from replant.estimation.solver.miso_steps import is_near, refine, start, truncated
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.autoregression import Autoregression
from support.cases import every
from support.rows import DT, noisy, row_of, toggling


def test_poles_that_zeros_cancel_are_truncated() -> None:
    for seed in range(50):
        rng = np.random.default_rng(seed)
        real = -np.exp(rng.uniform(-2.0, 4.0, 2))
        pair = np.exp(rng.uniform(-2.0, 4.0)) * np.exp(1j * rng.uniform(1.7, 3.0) * np.array([1.0, -1.0]))
        kept, cancelled = (real, pair) if seed % 2 else (pair, real)
        denominator = np.poly(np.concatenate([kept, cancelled])).real
        found = truncated(np.polymul([3.0, 1.0], np.poly(cancelled).real), denominator[1:], 2)
        assert np.poly(found).real == pytest.approx(np.poly(kept).real, rel=1e-5), seed


def test_no_pole_is_left_of_what_does_nothing_or_has_a_pole_twice() -> None:
    assert truncated(np.zeros(2), np.array([3.0, 2.0]), 1) is None
    assert truncated(np.array([1.0, 2.0]), np.array([2.0, 1.0]), 1) is None


def test_nothing_is_near_a_model_of_which_the_samples_tell_nothing() -> None:
    """Steps from other models ended there: of two poles that are too fast to be seen its slopes are nearly nought."""
    plant, u = TransferFunction([20.0], [1.0, 11.0, 10.0]), toggling(0, inputs=1, samples=1000)
    y = noisy(0, row_of(u, plant))
    row = Row((Structure(2),), Record(u[:, 0].copy(), y - y.mean(), np.array([DT])), u)
    white = Autoregression.white(1.0, row.count)
    true, unseen = (evaluate(row, np.array(each), white) for each in ([11.0, 10.0, 20.0], [5e8, 4e8, 8e8]))
    assert is_near(row, true, true)
    assert not is_near(row, true, unseen)
    assert not is_near(row, unseen, true)


@pytest.mark.slow
@every("seed", range(3))
def test_a_begin_leads_to_the_minimum_near_the_truth(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = [TransferFunction([k * w * w], [1.0, 1.2 * w, w * w]) for k, w in ((1.0, 8.0), (-0.5, 2.0), (2.0, 0.7))]
    u = rng.choice([-1.0, 1.0], (200, 3)).repeat(10, axis=0)
    y = np.sum([g.simulate(column.copy(), 0.05) for g, column in zip(plant, u.T, strict=True)], axis=0)
    y += 0.3 * y.std() * rng.standard_normal(y.size)
    ready, structures = RowRecord.of(u, y, 0.05), (Structure(2),) * 3
    row, white = Row(structures, ready.record, ready.inputs), Autoregression.white(1.0, y.size)
    truth = np.concatenate([[*g.den[1:], *g.num] for g in plant])
    near = refine(row, truth, white, evaluate(row, truth, white))
    begins = start(structures, row.record, row.inputs)
    assert min(refine(row, each.theta, white).cost for each in begins) == pytest.approx(near.cost, rel=1e-6)
    broken = replace(ready.record, y=np.where(np.arange(y.size) == 700, 1e300, ready.record.y))
    start(structures, broken, row.inputs)  # whatever comes of it, it comes without an error


@every("seed", range(8), quick=2)
def test_a_row_of_steps_leads_to_the_least_cost(seed: int) -> None:
    """Of each input there is one step: dealt models that are alike at first lead to minima of very different cost."""
    u = np.where(np.arange(300)[:, None] < np.array([1, 150]), 0.0, np.array([4.0, 1.0]))
    plant = TransferFunction([0.1], [1.0, 1 / 15], 4.0), TransferFunction([0.05], [1.0, 0.1], 2.0)
    y = np.sum([g.simulate(column.copy(), 1.0) for g, column in zip(plant, u.T, strict=True)], axis=0)
    y += 0.05 * np.random.default_rng(seed).standard_normal(300)
    structures = Structure(1, delay=4.0), Structure(1, delay=2.0)
    ready = RowRecord.of(u, y, 1.0)
    row = Row(structures, ready.record, ready.inputs)
    best = start(structures, ready.record, ready.inputs)[0]
    near = refine(row, np.array([1 / 15, 0.1, 0.1, 0.05]), Autoregression.white(1.0, row.count))
    assert best.cost <= 1.01 * near.cost
