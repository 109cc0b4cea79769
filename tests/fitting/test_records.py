"""Records of one plant solved together, and a record solved with what earlier ones have told."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.refined_estimate import Prior
from replant.estimation.solver.solve import solve
from replant.estimation.solver.srivc_steps import Problem
from replant.kernels.schema import LAGS, Doubt
from support.builders import binary

DT = 0.05
TRUE = np.array([0.8, 4.0, 4.0])
STRUCTURE = rp.Structure(2)


def record(seed: int, level: float, *, noise: float = 0.0, delay: float = 0.0, samples: int = 600) -> Record:
    """A record that begins in motion, at a level of its own."""
    u = binary(seed, samples + 200, 10)
    y = rp.TransferFunction([4.0], [1.0, 0.8, 4.0], delay=delay).simulate(u, DT)
    y += level + noise * np.random.default_rng(seed).standard_normal(u.size)
    return Record(u[200:], y[200:], np.array([DT]))


def join(records: Sequence[Record]) -> Record:
    """Return records of one plant as one record: of each the offset and the initial state are its own."""
    first, *others = records
    if not others:
        return first
    ends = np.cumsum([each.u.size for each in records]).tolist()
    u, y, measured = (np.concatenate([getattr(each, name) for each in records]) for name in ("u", "y", "is_measured"))
    clocks = [each.intervals for each in records]
    regular = all(clock.size == 1 and clock == clocks[0] for clock in clocks)
    intervals = np.concatenate([np.broadcast_to(each.intervals, each.u.size) for each in records])
    r = None if first.r is None else np.concatenate([each.r for each in records if each.r is not None])
    begins = [begin + last for last, each in zip([0, *ends], records, strict=False) for begin in (0, *each.begins)]
    return Record(
        u, y, clocks[0] if regular else intervals, first.input_hold, r, None,
        min(each.usual for each in records), None if measured.all() else measured, tuple(begins[1:]),
    )  # fmt: skip


@pytest.mark.parametrize("delay", [0.0, 0.4])
def test_each_has_an_offset_and_an_initial_state_of_its_own(delay: float) -> None:
    records = [record(seed, level, delay=delay) for seed, level in ((1, 0.0), (2, 50.0), (3, -7.0))]
    found = solve(rp.Structure(2, delay=delay), join(records))
    assert found is not None
    np.testing.assert_allclose(found.found.theta[:3], TRUE, rtol=1e-7)
    assert not found.is_bad.any()


def test_a_scrap_in_front_does_not_bring_its_offset() -> None:
    scrap, whole = record(1, 1e3), record(2, 5.0)
    found = solve(STRUCTURE, join([scrap.first(3), whole]))
    assert found is not None
    np.testing.assert_allclose(found.found.theta[:3], TRUE, rtol=1e-7)


def test_the_sampling_time_may_differ() -> None:
    first, second = record(1, 0.0), record(2, 5.0)
    u = np.repeat(second.u[::4], 4)[:600]
    y = 5.0 + rp.TransferFunction([4.0], [1.0, 0.8, 4.0]).simulate(u, DT)
    slow = Record(u[::4], y[::4], np.array([4.0 * DT]))
    found = solve(STRUCTURE, join([first, slow]))
    assert found is not None
    np.testing.assert_allclose(found.found.theta[:3], TRUE, rtol=1e-6)


def test_a_common_bias_of_the_structure_is_common() -> None:
    together = solve(rp.Structure(2, bias=True), join([record(1, 3.0), record(2, 3.0)]))
    assert together is not None
    assert together.found.theta[3] == pytest.approx(3.0 * TRUE[1], rel=1e-6)  # of A y = B u + bias


def test_bad_samples_are_found_in_each() -> None:
    records = [record(seed, level, noise=0.02) for seed, level in ((1, 0.0), (2, 50.0))]
    records[1].y[[0, 300]] = 1e4, -1e4
    found = solve(STRUCTURE, join(records))
    assert found is not None
    assert np.flatnonzero(found.doubt == Doubt.OUTLIER).tolist() == [600, 900]


def test_they_know_as_much_as_all_of_them() -> None:
    """The information adds up: four records have half the standard deviation of one, and the truth lies within."""
    alone = solve(STRUCTURE, record(1, 0.0, noise=0.1))
    together = solve(STRUCTURE, join([record(seed, seed, noise=0.1) for seed in (1, 2, 3, 4)]))
    assert alone is not None
    assert together is not None
    std, single = (np.sqrt(np.diag(each.found.covariance)[:3]) for each in (together, alone))
    assert (std < 0.7 * single).all()
    assert (np.abs(together.found.theta[:3] - TRUE) < 4.0 * std).all()


def test_a_prior_stands_for_the_records_that_it_was_made_from() -> None:
    """The estimate of one record as the prior of the next is, to first order, the estimate of both."""
    first, second = (record(seed, 0.0, noise=0.02) for seed in (1, 2))
    earlier, both = solve(STRUCTURE, first), solve(STRUCTURE, join([first, second]))
    assert earlier is not None
    assert both is not None
    information = np.zeros((earlier.found.theta.size,) * 2)
    information[:3, :3] = np.linalg.inv(earlier.found.covariance[:3, :3])
    prior = Prior(earlier.found.theta, information, earlier.found.variance)
    later, _, converged = Problem(STRUCTURE, second).polish(prior.mean, prior=prior)
    assert converged
    std = np.sqrt(np.diag(both.found.covariance)[:3])
    alone = solve(STRUCTURE, second)
    assert alone is not None
    assert (np.abs(later - both.found.theta)[:3] < 0.3 * std).all()
    assert (np.abs(alone.found.theta - both.found.theta)[:3] > 0.3 * std).any()


def test_a_part_of_records_joined_knows_where_records_begin() -> None:
    whole = join([record(1, 0.0, samples=30), record(2, 1.0, samples=20), record(3, 2.0, samples=10)])
    assert whole.begins == (30, 50)
    assert whole.last(35).begins == (5, 25)
    assert whole.first(40).records == [slice(0, 30), slice(30, 40)]
    assert join([whole, whole]).begins == (30, 50, 60, 90, 110)
    assert whole.predecessors[[0, 29, 30, 31, 50]].tolist() == [0, min(29, LAGS), 0, 1, 0]
