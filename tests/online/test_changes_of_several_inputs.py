"""Several inputs: loads that come again and again, and a change of one branch that looks like a load at first."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.solver.miso_change import Change
from replant.kernels.schema import Supposition
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import chi2_quantile
from replant.online import miso_state
from support.cases import every

DT, SAMPLES = 0.05, 5000
FAST, SLOW = rp.TransferFunction([10.0], [1.0, 11.0, 10.0]), rp.TransferFunction([0.1], [1.0, 0.1], delay=0.3)
TRUE = np.array([11.0, 10.0, 10.0, 0.1, 0.1])
LOADS, SIZES = (1150, 2700, 4000), (1.0, -1.0, 0.8)
NEAR, TOGGLED = 60, 300  # samples that tell a load from the noise, and in which the slow input toggles thrice


def inputs(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.choice([-1.0, 1.0], SAMPLES // hold).repeat(hold) for hold in (20, 100)])


def answer(u: FloatArray, slow: rp.TransferFunction = SLOW) -> FloatArray:
    return np.asarray(FAST.simulate(u[:, 0].copy(), DT) + slow.simulate(u[:, 1].copy(), DT))


def noisy(seed: int, y: FloatArray, pole: float) -> FloatArray:
    noise = np.random.default_rng([seed, 1]).standard_normal(y.size)
    for k in range(1, y.size):
        noise[k] = pole * noise[k - 1] + np.sqrt(1.0 - pole**2) * noise[k]
    return y + 0.3 * noise


def identified(u: FloatArray, y: FloatArray) -> Any:
    ident = rp.Identifier(poles=(2, 1), delay=(0.0, 0.3), dt=DT)
    ident.update_many(u, y)
    return ident


def distance(ident: Any, true: FloatArray) -> float:
    error = ident.parameters - true
    return float(error @ np.linalg.solve(ident.covariance, error))


def steps() -> FloatArray:
    """What the loads add to the output."""
    return np.asarray(
        np.sum([size * (np.arange(SAMPLES) >= at) for size, at in zip(SIZES, LOADS, strict=True)], axis=0)
    )


def changed_at(u: FloatArray, at: int) -> FloatArray:
    """The output where the pole of one branch is doubled, its gain kept."""
    y = answer(u)
    y[at:] = answer(u, rp.TransferFunction([0.2], [1.0, 0.2], delay=0.3))[at:]
    return y


@cache
def of_another_plant(seed: int, at: int) -> Any:
    u = inputs(seed)
    return identified(u, noisy(seed, changed_at(u, at), 0.0))


def finds(loads: Sequence[int], begins: Sequence[int]) -> bool:
    return len(loads) == len(begins) and all(abs(a - b) <= NEAR for a, b in zip(loads, begins, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_each_of_several_loads_is_found(seed: int) -> None:
    """A slow branch follows a load that it was solved with, so that later ones are missed, and the pole is wrong."""
    u = inputs(seed)
    ident = identified(u, noisy(seed, answer(u) + steps(), 0.0))
    assert finds(LOADS, ident.begins[1:])
    assert distance(ident, TRUE) < chi2_quantile(0.9999, TRUE.size)
    assert ident.assess().status == "trusted"


@pytest.mark.slow
def test_a_load_at_an_input_is_found() -> None:
    u = inputs(5)
    load = np.where(np.arange(SAMPLES) >= 2500, 0.8, 0.0)
    ident = identified(u, noisy(5, answer(u) + SLOW.simulate(load, DT), 0.9))
    assert len(ident.begins) == 2
    assert distance(ident, TRUE) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
@every("seed", range(8), quick=1)
def test_one_branch_that_changes_is_learned_anew(seed: int) -> None:
    """The first samples since are explained by a load as well."""
    at = 2100
    ident = of_another_plant(seed, at)
    (begin,) = ident.begins
    assert abs(begin - at) <= TOGGLED
    assert distance(ident, np.array([11.0, 10.0, 10.0, 0.2, 0.2])) < chi2_quantile(0.9999, TRUE.size)
    assert ident.assess().status == "trusted"


@pytest.mark.slow
def test_a_load_that_was_one_stays_one() -> None:
    u = inputs(6)
    y = noisy(6, answer(u) + np.where(np.arange(SAMPLES) >= 1500, 1.0, 0.0), 0.0)
    ident = identified(u, y)
    assert finds((1500,), ident.begins[1:])
    assert ident.parameters == pytest.approx(TRUE, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_fit_parts_a_record_at_its_loads(seed: int) -> None:
    u = inputs(seed)
    y = noisy(seed, answer(u) + steps(), 0.0)
    fitted = rp.fit(u, y, DT, poles=(2, 1), delay=(0.0, 0.3))
    assert finds(LOADS, fitted.loads)
    assert distance(fitted, TRUE) < chi2_quantile(0.9999, TRUE.size)
    assert fitted.verdict.status == "trusted"
    assert any(reason.startswith("another load acts since 57.") for reason in fitted.verdict.reasons)
    left = y - fitted.output
    assert np.nanstd(left) < 1.1 * np.sqrt(fitted.noise.residual_variance)


def doubled(seed: int, at: int, samples: int) -> tuple[FloatArray, FloatArray]:
    """A record in which the gain of the fast branch is twice as large since a sample."""
    u = inputs(seed)[:samples]
    y = answer(u)
    y[at:] += FAST.simulate(u[:, 0].copy(), DT)[at:]
    return u, noisy(seed, y, 0.0)


@pytest.mark.slow
@every("seed", range(4), quick=1)
def test_a_change_raises_an_alarm(seed: int) -> None:
    """The next look is due 200 samples later; the innovations tell sooner."""
    at, before, after = 1180, 1175, 1325
    u, y = doubled(seed, at, after)
    ident = rp.Identifier(poles=(2, 1), delay=(0.0, 0.3), dt=DT)
    ident.update_many(u[:before], y[:before])
    assert ident.assess().status == "trusted"
    ident.update_many(u[before:], y[before:])
    assert ident.assess().status != "trusted" or abs(ident.begins[-1] - at) <= 10


@pytest.mark.slow
def test_an_alarm_within_a_chunk_is_one_of_single_samples() -> None:
    u, y = doubled(3, 700, 850)
    whole, pieces, single = (rp.Identifier(poles=(2, 1), delay=(0.0, 0.3), dt=DT) for _ in range(3))
    trace = whole.update_many(u, y)
    for begin in range(0, len(y), 7):
        pieces.update_many(u[begin : begin + 7], y[begin : begin + 7])
    estimates = []
    for row, output in zip(u.tolist(), y.tolist(), strict=True):
        single.update(row, output)
        estimates.append(single.parameters)
    assert whole.begins[-1] > 0
    assert whole.to_bytes() == pieces.to_bytes() == single.to_bytes()
    np.testing.assert_array_equal(trace.parameters, np.array(estimates))


@pytest.mark.slow
def test_larger_noise_is_an_alarm_until_no_change_explains_it() -> None:
    u, at = inputs(4)[:3500], 2000
    noise = np.random.default_rng(4).standard_normal(3500) * np.where(np.arange(3500) < at, 0.2, 0.5)
    ident, statuses = rp.Identifier(poles=(2, 1), delay=(0.0, 0.3), dt=DT), []
    for k in range(0, 3500, 100):
        ident.update_many(u[k : k + 100], (answer(u) + noise)[k : k + 100])
        statuses.append(ident.assess().status)
    assert statuses[at // 100 - 1] == "trusted"
    assert statuses[at // 100 + 1] == "inconsistent"
    assert set(statuses[-5:]) == {"trusted"}
    assert ident.begins == (0,)


@pytest.mark.slow
@every("pole", [0.0, 0.9], quick=1)
def test_noise_and_outliers_raise_no_alarm(pole: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once in some thousand records, where the variance is known; of the shortest records it is not quite."""
    looks, counts = [], []
    monkeypatch.setattr(miso_state, "find_change", lambda *_: looks.append(1))
    for seed in range(6):
        u, rng = inputs(seed)[:2000], np.random.default_rng([seed, 2])
        y = noisy(seed, answer(u), pole)
        y[rng.random(y.size) < 0.005 * (seed % 2)] += 5.0
        looks.clear()
        identified(u, y)
        counts.append(len(looks))
    assert sum(count > min(counts) for count in counts) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_fit_says_that_the_plant_has_changed(seed: int) -> None:
    u, at = inputs(seed), 2100
    fitted = rp.fit(u, noisy(seed, changed_at(u, at), 0.0), DT, poles=(2, 1), delay=(0.0, 0.3))
    assert fitted.verdict.status == "inconsistent"
    assert any("the plant seems to have changed" in reason for reason in fitted.verdict.reasons)


@every("seed", range(4), quick=1)
def test_a_record_without_a_change_is_not_parted(seed: int) -> None:
    u = inputs(seed)
    fitted = rp.fit(u, noisy(seed, answer(u), [0.0, 0.9][seed % 2]), DT, poles=(2, 1), delay=(0.0, 0.3))
    assert not fitted.loads.size
    assert not any("load" in reason or "changed" in reason for reason in fitted.verdict.reasons)


@pytest.mark.slow
@every("supposition", [Supposition.LOAD, Supposition.PLANT], quick=1)
def test_the_end_takes_back_a_change_that_was_none(supposition: Supposition, monkeypatch: pytest.MonkeyPatch) -> None:
    u = inputs(7)[:2500]
    y, claims = noisy(7, answer(u), 0.0), iter([Change(supposition, 400, 50.0)])
    monkeypatch.setattr(miso_state, "find_change", lambda *_: next(claims, None))
    ident = identified(u, y)
    assert ident.begins != (0,)
    ident.finish()
    fitted = rp.fit(u, y, DT, poles=(2, 1), delay=(0.0, 0.3))
    assert ident.begins == (0,)
    assert ident.parameters == pytest.approx(fitted.parameters, rel=1e-6)


@pytest.mark.slow
def test_the_end_keeps_a_change_that_was_one() -> None:
    ident = copy.deepcopy(of_another_plant(0, 2100))
    begins = ident.begins
    ident.finish()
    assert ident.begins == begins != (0,)


@pytest.mark.slow
def test_the_end_finds_a_load_that_was_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(miso_state, "find_change", lambda *_: None)
    u = inputs(9)
    ident = identified(u, noisy(9, answer(u) + np.where(np.arange(SAMPLES) >= 2500, 1.0, 0.0), 0.0))
    assert ident.begins == (0,)
    ident.finish()
    assert finds((2500,), ident.begins[1:])
    assert distance(ident, TRUE) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
def test_the_end_finds_another_plant_that_was_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(miso_state, "find_change", lambda *_: None)
    u, at = inputs(10)[:2500], 1200
    ident = identified(u, noisy(10, changed_at(u, at), 0.0))
    assert ident.begins == (0,)
    ident.finish()
    assert abs(ident.begins[0] - at) <= TOGGLED
    assert distance(ident, np.array([11.0, 10.0, 10.0, 0.2, 0.2])) < chi2_quantile(0.9999, TRUE.size)
    assert any("the plant changed" in reason for reason in ident.assess().reasons)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, pytest.param(4, marks=pytest.mark.slow)])
def test_fit_finds_a_change_of_a_fifth_without_noise(seed: int) -> None:
    """Loads explain it beside one another, until they are too many; of the whole record nothing seemed wrong then."""
    rng, samples, at = np.random.default_rng(seed), 2500, 1183
    sines = np.sin(np.outer(np.arange(samples), 2.0 * np.pi * np.arange(1, 9) / 400.0) + rng.uniform(0.0, 6.0, 8))
    u = np.column_stack([sines.sum(axis=1), rng.standard_normal(samples)])
    first = rp.TransferFunction([1.0], [1.0, 1.0]).simulate(u[:, 0].copy(), 0.1)
    second = rp.TransferFunction([1.0, 2.0], [1.0, 2.0, 4.0]).simulate(u[:, 1].copy(), 0.1)
    y = np.where(np.arange(samples) < at, 1.0, 1.2) * first + second
    reasons = rp.fit(u, y, 0.1, poles=(1, 2), zeros=(0, 1)).verdict.reasons
    assert any(reason.startswith("the plant seems to have changed 132 s before the end") for reason in reasons)
