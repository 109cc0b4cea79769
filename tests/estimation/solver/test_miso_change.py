"""What has changed within a record of several inputs: a load, the plant, or nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest

from replant.estimation.simulation.miso import Point, Row, RowRecord
from replant.estimation.solver import miso_change
from replant.estimation.solver.miso_change import Judge, find_change, likeliest_change, plant_change
from replant.estimation.solver.miso_steps import path, start
from replant.kernels.schema import Supposition
from replant.model.structure import Structure
from replant.model.transfer_function import TransferFunction
from replant.numerics.arguments import FloatArray
from support.cases import every

DT, SAMPLES, CHANGED = 0.1, 1800, 1500
STRUCTURES = Structure(1), Structure(1, delay=0.3)
PLANT = TransferFunction([2.0], [1.0, 0.5]), TransferFunction([1.0], [1.0, 3.0], delay=0.3)
SINCE = np.arange(SAMPLES) >= CHANGED


def answers(plant: Sequence[TransferFunction], u: FloatArray) -> FloatArray:
    return np.sum([g.simulate(each.copy(), DT) for g, each in zip(plant, u.T, strict=True)], axis=0)


def found_in(
    seed: int, *, other: Sequence[TransferFunction] = PLANT, load: float = 0.0, louder: float = 1.0, pole: float = 0.0
) -> tuple[Supposition, int] | None:
    """Return what the model of the samples before says has changed, and where; noise of 0.2 with a pole."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], (SAMPLES // 10, 2)).repeat(10, axis=0)
    y = np.where(SINCE, answers(other, u), answers(PLANT, u)) + PLANT[0].simulate(np.where(SINCE, load, 0.0), DT)
    noise = rng.standard_normal(SAMPLES)
    for k in range(1, SAMPLES):
        noise[k] = pole * noise[k - 1] + np.sqrt(1.0 - pole**2) * noise[k]
    ready = RowRecord.of(u, y + 0.2 * np.where(SINCE, louder, 1.0) * noise, DT)
    row = Row(STRUCTURES, ready.record, ready.inputs)
    change = find_change(row, start(row.structures, row.record.first(CHANGED), row.inputs[:CHANGED])[0].theta)
    return None if change is None else (change.supposition, change.begin)


def changed(*, a0: float = 0.5, b0: float = 2.0, gain: float = 1.0) -> tuple[TransferFunction, TransferFunction]:
    return TransferFunction([b0], [1.0, a0]), TransferFunction([gain], [1.0, 3.0], delay=0.3)


@pytest.mark.slow
@every("seed, pole", [(seed, pole) for seed in range(2) for pole in (0.9, 0.0)], quick=1)
def test_another_plant_is_found_where_it_began(seed: int, pole: float) -> None:
    for other in (changed(b0=3.0), changed(a0=1.0, b0=4.0), changed(gain=2.0)):
        supposition, begin = found_in(seed, other=other, pole=pole) or (None, 0)
        assert supposition is Supposition.PLANT, other
        assert abs(begin - CHANGED) <= 30, other


@every("seed", range(3), quick=1)
def test_a_load_leaves_the_plant_as_it_was(seed: int) -> None:
    supposition, begin = found_in(seed, load=0.4) or (None, 0)
    assert supposition is Supposition.LOAD
    assert abs(begin - CHANGED) <= 30


@every("seed, pole", [(seed, pole) for seed in range(4) for pole in (0.0, 0.9)], quick=2)
def test_what_does_not_change_or_is_noise_is_no_change(seed: int, pole: float) -> None:
    assert found_in(seed, pole=pole) is None
    assert found_in(seed, louder=2.0, pole=pole) is None


def test_too_few_samples_since_tell_of_no_change() -> None:
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], (12, 2)).repeat(10, axis=0)
    ready = RowRecord.of(u, answers(PLANT, u) + 0.1 * rng.standard_normal(120), DT)
    row = Row(STRUCTURES, ready.record, ready.inputs)
    assert find_change(row, np.array([5.0, 20.0, 3.0, 10.0])) is None
    empty = Row(STRUCTURES, ready.record.first(3), ready.inputs[:3])
    assert find_change(empty, np.array([0.5, 2.0, 3.0, 1.0])) is None


def test_of_outputs_that_a_model_explains_to_the_bit_nothing_has_changed() -> None:
    u = np.random.default_rng(0).choice([-1.0, 1.0], (30, 2)).repeat(10, axis=0)
    ready = RowRecord.of(u, np.zeros(300), DT, begins=(150,))
    row = Row(STRUCTURES, ready.record, ready.inputs)
    assert plant_change(row, 150, np.array([0.5, 0.0, 3.0, 0.0])) is None


def test_no_path_is_followed_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Suppositions at several samples share what does not depend on the sample."""
    followed = []

    def follow(row: Row, theta: FloatArray, noise: Any, *others: Any, **named: Any) -> Iterator[Point]:
        followed.append((row.record.y.tobytes(), row.record.begins, theta.tobytes(), noise.coefficients.tobytes()))
        return path(row, theta, noise, *others, **named)

    monkeypatch.setattr(miso_change, "path", follow)
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], (60, 1)).repeat(10, axis=0)
    y = PLANT[0].simulate(u[:, 0].copy(), DT) + 0.3 * (np.arange(600) >= 300) + 0.1 * rng.standard_normal(600)
    ready = RowRecord.of(u, y, DT)
    row, theta = Row(STRUCTURES[:1], ready.record, ready.inputs), np.array([0.51, 2.03])
    likeliest_change(row, theta, [Judge.of(row, 1.2 * theta)], of_any_noise=False)
    assert len(followed) > 4
    # the samples before the first one are also those before any
    assert len(followed) - len(set(followed)) <= 1
