"""Members of the default method side by side: each is, to the bit, the single identifier that it would be by itself."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine import vector_blocks
from replant.kernels import schema as at
from replant.kernels.lanes import LANES
from replant.online import ensemble_members
from support.builders import G2
from support.cases import every

DT, SAMPLES, MEMBERS = 0.02, 800, LANES + 1
BEGUN = 480  # samples; the record is solved again at 675, which takes longer than all samples up to there
STRUCTURE = rp.Structure(poles=2, zeros=1)
Members = list[rp.Identifier]


def records(
    seed: int = 0, samples: int = SAMPLES, members: int = MEMBERS, past: Callable[[int], np.ndarray] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs (samples, members), of one plant that goes on from where its ``past`` inputs left it.

    Without it they go on where those of `defaults` ended: an output that leaps would be looked into, which takes long.
    """
    generator = np.random.default_rng(seed)
    u = np.where(np.cumsum(generator.random((samples, members)) < 0.05, axis=0) % 2 == 0, 1.0, -1.0)
    before = [(past or past_inputs)(number) for number in range(members)]
    whole = [np.concatenate([first, column]) for first, column in zip(before, u.T, strict=True)]
    y = np.stack([G2.simulate(column, DT)[-samples:] for column in whole], axis=1)
    return u, y + 0.05 * generator.standard_normal(y.shape)


def no_past(_: int) -> np.ndarray:
    return np.empty(0)


@functools.cache
def first_record() -> tuple[np.ndarray, np.ndarray]:
    """What each member begins with."""
    u, y = records(99, BEGUN, 1, no_past)
    return u[:, 0], y[:, 0]


@functools.cache
def second_records() -> tuple[np.ndarray, np.ndarray]:
    """Of which each member takes more than the one before."""
    return records(98, 80, past=lambda _: first_record()[0])


def past_inputs(number: int) -> np.ndarray:
    """What a member of `defaults` has taken."""
    return np.concatenate([first_record()[0], second_records()[0][: 5 * number, number]])


def disturbed(u: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The records with all that is out of the ordinary, each of some members alone, spread over their length."""
    u, y = u.copy(), y.copy()

    def at(begin: float, end: float) -> slice:
        return slice(round(begin * len(u)), round(end * len(u)))

    u[at(0.17, 0.1701).start, 0], y[at(0.26, 0.27), 0] = np.nan, np.inf
    y[at(0.37, 0.41), 1] = np.nan  # no output
    y[at(0.23, 0.24).start, 2] += 50.0
    y[at(0.235, 0.24), 2] -= 30.0  # outliers
    y[at(0.43, 0.7), 3] = y[at(0.43, 0.7).start, 3]  # a sensor that is stuck
    y[at(0.58, 1.0), 4] *= 3.0  # the plant changes
    u[at(0.5, 0.75), 5] = 0.0  # the input rests
    y[:, 6] = np.round(y[:, 6], 1)  # a coarse scale
    u[at(0.18, 0.19).start, 7] = 1e6  # misread
    u[at(0.92, 1.0), 7] += 1e5  # moved
    return u, y


@functools.cache
def begun(structure: rp.Structure = STRUCTURE, **settings: Any) -> rp.Identifier:
    """One that has begun, so that its start-up need not be waited for again."""
    one = rp.Identifier(structure, DT, startup=300, **settings)
    one.update_many(*first_record())
    assert one.status == "running"
    return one


@functools.cache
def aged(number: int, structure: rp.Structure = STRUCTURE, **settings: Any) -> rp.Identifier:
    """A member, of another age than the others."""
    member, (u, y) = begun(structure, **settings).clone(), second_records()
    member.update_many(u[: 5 * number, number], y[: 5 * number, number])
    return member


def defaults(structure: rp.Structure = STRUCTURE, **settings: Any) -> Members:
    return [aged(number, structure, **settings).clone() for number in range(MEMBERS)]


def arrays_of(member: rp.Identifier) -> list[bytes]:
    """All arrays to the bit, but work space and what is written anew before it is read."""
    state = member.clone()._state
    state.backup[:] = 0.0
    state.work[:] = 0.0
    state.ints[at.ROWS :] = 0
    return [array.tobytes() for array in state.arrays]


def check_twins(make: Callable[[], Members], u: np.ndarray, y: np.ndarray, cuts: tuple[int, ...] = ()) -> None:
    """Compare an ensemble with its members by themselves, to the bit: the ensemble takes the record in chunks."""
    alone, ensemble = make(), rp.Ensemble(make())
    edges = [0, *cuts, len(u)]
    traces = [ensemble.trace(u[a:b], y[a:b]) for a, b in itertools.pairwise(edges)]
    for number, single in enumerate(alone):
        expected = single.update_many(u[:, number], y[:, number])
        errors = np.concatenate([trace[number].errors for trace in traces])
        np.testing.assert_array_equal(errors, expected.errors, str(number))
        parameters = np.concatenate([trace[number].parameters for trace in traces])
        np.testing.assert_array_equal(parameters, expected.parameters, str(number))
        assert arrays_of(ensemble.member(number)) == arrays_of(single), number
        assert ensemble.member(number).rejected == single.rejected


def test_members_start_when_their_own_samples_suffice() -> None:
    u, y = records(samples=420, members=4, past=no_past)
    y *= np.geomspace(0.1, 10.0, 4)
    check_twins(lambda: [rp.Identifier(STRUCTURE, DT, startup=200 + 50 * number) for number in range(4)], u, y)


@every(
    "structure",
    [rp.Structure(1), rp.Structure(2), rp.Structure(1, 1, feedthrough=True)],
    ids=["1", "2", "1, at once"],
    quick=1,
)
def test_members_of_every_structure_get_the_same_bits(structure: rp.Structure) -> None:
    check_twins(lambda: defaults(structure), *records(1, 50))


@pytest.mark.slow
def test_what_is_out_of_the_ordinary_is_each_member_s_own_over_a_long_record() -> None:
    check_twins(defaults, *disturbed(*records()))


@pytest.mark.slow
@every(
    ("samples", "cuts"),
    [(330, (1, 2, 150, 151, 170, 280)), (650, tuple(range(100, 600, 47)))],
    ids=["few", "short"],
)
def test_what_is_out_of_the_ordinary_is_each_member_s_own_in_chunks_of_any_size(
    samples: int, cuts: tuple[int, ...]
) -> None:
    check_twins(defaults, *disturbed(*records(1, samples)), cuts)


@pytest.mark.slow
@pytest.mark.parametrize("stretch", [1, 64])
def test_how_many_samples_members_take_at_once_changes_nothing(stretch: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is out of the ordinary in them, in chunks of one sample and of many."""
    monkeypatch.setattr(vector_blocks, "STRETCH", stretch)
    monkeypatch.setattr(ensemble_members, "PORTION", 100 * stretch)
    check_twins(defaults, *disturbed(*records(2, 120)), (1, 2, 50, 51, 97))


SETTINGS: dict[str, dict[str, Any]] = {
    "forgetting": {"optimizer": rp.RecursiveLeastSquares(0.999)},
    "straight": {"filter": rp.RefinedFilter(input_hold="foh")},
    "working point": {"preprocess": rp.Preprocess("identity", 0.3, -0.2)},
    "not normalized": {"normalize": False},
    "no history": {"history": 0},
    "kalman": {"optimizer": rp.KalmanTracking(1e-4)},
    "fixed filter": {"filter": rp.StateVariableFilter(cutoff=5.0), "optimizer": rp.RecursiveLeastSquares()},
}


@pytest.mark.slow
@every("which", SETTINGS)
def test_every_setting_gets_the_same_bits(which: str) -> None:
    u, y = records(3, 120)
    y[40:50, 2], y[70:, 3] = np.nan, 0.0
    check_twins(lambda: defaults(**SETTINGS[which]), u + 0.1 * np.cos(np.arange(len(u)))[:, None], y)


def test_members_of_several_kinds() -> None:
    def make() -> Members:
        members = defaults()
        members[2] = aged(2, optimizer=rp.RecursiveLeastSquares(0.999)).clone()
        members[3] = aged(3, rp.Structure(2, 1, delay=0.05)).clone()
        members[4] = rp.Identifier(STRUCTURE, DT, preprocess=rp.Preprocess(input_map=np.tanh), startup=5000)
        members[5] = aged(5, optimizer="amsgrad", instruments=False).clone()
        members[6].freeze()
        return members

    check_twins(make, *records(5, 80))


@pytest.mark.slow
def test_threads_change_nothing() -> None:
    u, y = records(6, 60)
    one, two = rp.Ensemble(defaults()), rp.Ensemble(defaults(), n_jobs=2)
    np.testing.assert_array_equal(one.update_many(u, y), two.update_many(u, y))
    for number in range(MEMBERS):
        assert arrays_of(one.member(number)) == arrays_of(two.member(number))


def test_most_ordinary_samples_are_taken_side_by_side(monkeypatch: pytest.MonkeyPatch) -> None:
    whole: list[int] = []
    take = ensemble_members.Company._take_together
    monkeypatch.setattr(
        ensemble_members.Company, "_take_together", lambda *given: (whole.append(len(given[2])), take(*given))[1]
    )
    ensemble = rp.Ensemble(defaults())
    ensemble.update_many(*records(7, 100))
    assert whole == [LANES]  # and the last by itself
