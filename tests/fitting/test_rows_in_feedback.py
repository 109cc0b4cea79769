"""Several inputs, of which a controller makes one: a reference gives instruments."""

from __future__ import annotations

import re
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter, tf2ss

import replant as rp
from replant.estimation.simulation.miso import Row, RowRecord, evaluate, noise_of
from replant.estimation.simulation.miso_exogenous import Law, Outside, windows
from replant.estimation.solver.miso_steps import instrumental
from replant.fitting.miso_solve import solve_with
from replant.model.structure import Structure
from replant.numerics.autoregression import Autoregression
from replant.numerics.linear_algebra import chi2_quantile
from replant.verdict.miso_inputs import controlled
from replant.verdict.miso_tests import _beyond_nought
from support.cases import every
from support.rows_in_feedback import ASKED, DT, PLANT, SAMPLES, TRUE, distance, looped


@pytest.mark.slow
@every("load, pole", [(False, 0.0), (False, 0.9), (True, 0.95)])
def test_with_a_reference_the_estimate_is_right_under_any_noise(load: bool, pole: float) -> None:
    u, y, r = looped(0, load=load, pole=pole)
    found = rp.fit(u, y, DT, **ASKED, reference=r)
    assert distance(found) < chi2_quantile(0.9999, TRUE.size)
    assert found.verdict.status == "trusted" or "uncertainty" in found.verdict.reasons[0]
    assert "input u1 is moved by the reference" in " ".join(found.verdict.reasons)


@pytest.mark.slow
@every("seed", range(3))
def test_the_estimate_is_the_root_of_the_noise_model_of_what_it_leaves(seed: int) -> None:
    u, y, r = looped(seed, load=True, pole=0.95)
    structures = tuple(Structure(n, delay=delay) for n, delay in zip(ASKED["poles"], ASKED["delay"], strict=True))
    _, solution, _ = solve_with(structures, RowRecord.of(u, y, DT), r[:, None], ("u1", "u2"))
    assert solution is not None
    row, found, _ = solution
    noise = noise_of(row, found.point)
    root = instrumental(row, found.point.theta, noise, found.point)
    moved = root.theta - found.point.theta
    assert moved @ np.linalg.solve(found.covariance, moved) < 0.01**2


@every("size, is_answered", [(1e-2, True), (1e-7, False), (1e-12, False)])
def test_of_a_residual_that_is_rounding_no_answer_is_sought(size: float, is_answered: bool) -> None:
    rng = np.random.default_rng(0)
    u, noise = rng.choice([-1.0, 1.0], (100, 2)).repeat(10, axis=0), rng.standard_normal(1000)
    u[1:, 0] -= noise[:-1]
    y = sum(g.simulate(each.copy(), DT) for g, each in zip(PLANT, u.T, strict=True)) + size * noise
    structures = tuple(Structure(n, delay=delay) for n, delay in zip(ASKED["poles"], ASKED["delay"], strict=True))
    ready = RowRecord.of(u, y, DT)
    row = Row(structures, ready.record, ready.inputs)
    white = Autoregression.white(1.0, row.count)
    found = list(controlled(row, evaluate(row, TRUE, white), white))
    assert [each.reason.split()[1] for each in found] == ["u1"] * is_answered


FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "none": ({}, ""),
    "limit": ({"act": lambda u, _: min(max(u, -1.0), 1.0)}, "the actuator seems to saturate"),
    "dead zone": ({"act": lambda u, _: u - min(max(u, -0.3), 0.3)}, "the actuator seems to have a dead zone"),
    "weaker": ({"act": lambda u, k: u if k < 1800 else 0.6 * u}, "the plant changes as the record goes on"),
    "one-sided": ({"act": lambda u, _: u if u > 0.0 else 0.5 * u}, "another gain in the other direction"),
    "one-sided sensor": ({"sense": lambda y: y if y > 0.0 else 0.5 * y}, "the sensor seems to have another gain"),
}


@pytest.mark.slow
@every("fault", FAULTS, quick=2)
def test_with_a_reference_faults_are_named_as_in_open_loop(fault: str) -> None:
    """Each is found; another one may explain it better in one record of three."""
    how, words = FAULTS[fault]
    reasons = []
    for seed in range(3):
        u, y, r = looped(seed, snr=20.0, pole=0.8, **how)
        verdict = rp.fit(u, y, DT, **ASKED, reference=r).verdict
        assert verdict.status == ("inconsistent" if words else "trusted"), verdict.reasons
        reasons.append(verdict.reasons[0])
    assert sum(words in reason for reason in reasons) >= 2, reasons


@pytest.mark.slow
@every("seed", [7, 9], quick=1)
def test_of_a_short_record_the_known_inputs_give_starts_too(seed: int) -> None:
    """From what the reference explains of the inputs alone the steps ended at poles of 1e12 rad/s, or a wrong gain."""
    u, y, r = looped(seed, samples=400, snr=20.0, pole=0.8)
    found = rp.fit(u, y, DT, **ASKED, reference=r)
    assert found.parameters == pytest.approx(TRUE, rel=0.5)


@pytest.mark.slow
def test_an_input_whose_plant_changes_is_named_alone() -> None:
    u, y, r = looped(2, snr=46.0, act=lambda u, k: (1.0 + k / SAMPLES) * u)
    said = " ".join(rp.fit(u, y, DT, **ASKED, reference=r).verdict.reasons)
    assert "input u1, beside the others: the plant changes as the record goes on" in said
    assert "input u2, beside the others: the plant" not in said


@pytest.mark.slow
def test_of_an_input_at_rest_no_figure_is_given() -> None:
    u, y, r = looped(0, snr=20.0)
    u[:, 1] = 0.0
    verdict = rp.fit(u, y, DT, **ASKED, reference=r).verdict
    assert verdict.reasons[0] == "input u2 does not move: move it, or leave it out"
    assert not any("nan" in reason for reason in verdict.reasons)


@pytest.mark.slow
def test_with_a_reference_a_missing_dead_time_is_named() -> None:
    u, y, r = looped(0, snr=20.0)
    u[:-3, 0] = u[3:, 0].copy()
    verdict = rp.fit(u[:-3], y[:-3], DT, **ASKED, reference=r[:-3]).verdict
    assert verdict.status == "inconsistent"
    assert re.search(r"input u1, beside the others: the input seems to act 0\.\d+ s later", verdict.reasons[0])


@cache
def under_a_load(seed: int) -> Any:
    u, y, _ = looped(seed, load=True, pole=0.95)
    return rp.fit(u, y, DT, **ASKED)


@pytest.mark.slow
@every("seed", [0, 1, 2, 3, 5, 4], quick=1)
def test_under_a_load_the_estimate_without_a_reference_is_not_trusted(seed: int) -> None:
    assert under_a_load(seed).verdict.status == "inconsistent"


def test_under_a_load_the_estimate_without_a_reference_may_be_off() -> None:
    found = under_a_load(4)
    assert distance(found) > chi2_quantile(0.9999, TRUE.size)
    assert "input u1 answers to disturbances of the output: a controller makes it" in found.verdict.reasons[0]


@pytest.mark.slow
@every("poles, seed", product([(1, 2), (1, 1)], range(6)), quick=2)
def test_a_structure_that_is_wrong_is_no_controller(poles: tuple[int, int], seed: int) -> None:
    """The dead time is forgotten, or a pole is: the error answers to single past inputs, and these to none of it."""
    rng = np.random.default_rng([77, seed])
    u = rng.choice([-1.0, 1.0], (200, 2)).repeat(10, axis=0)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u[:, 0].copy(), 0.1)
    delayed = rp.TransferFunction([9.0], [1.0, 1.2, 9.0], delay=0.3 * (sum(poles) == 3))
    y += delayed.simulate(u[:, 1].copy(), 0.1) + 0.01 * rng.standard_normal(2000)
    found = rp.fit(u, y, 0.1, poles=poles)
    assert found.verdict.status == "inconsistent"
    assert not any("a controller makes it" in reason for reason in found.verdict.reasons)


def test_a_numerator_whose_variance_is_rounding_is_not_told_from_nought() -> None:
    """As that of a branch that ran away: the variance that comes of its squares may be negative."""
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], (100, 2)).repeat(10, axis=0)
    ready = RowRecord.of(u, u.sum(axis=1), DT)
    row = Row((Structure(1), Structure(1)), ready.record, ready.inputs)
    theta = np.array([1.0, 1.0, 1e12, 2e11])
    point = evaluate(row, theta, Autoregression.white(1.0, row.count))
    with np.errstate(over="ignore"):  # as a fit does
        known, unknown = _beyond_nought(row, point, np.diag([0.01, 0.01, -5e37, -1e36]))
    assert known == pytest.approx(100.0 / (2.0 * np.log(row.count)))
    assert unknown == 0.0


@pytest.mark.slow
def test_each_of_two_loops_has_a_reference() -> None:
    """The second input follows a set-point of its own; the unit of a reference does not matter."""
    u, y, r = looped(1, load=True, pole=0.95)
    found = rp.fit(u, y, DT, **ASKED, reference=np.column_stack([1e3 * r + 7.0, u[:, 1]]))
    assert found.parameters == pytest.approx(rp.fit(u, y, DT, **ASKED, reference=r).parameters, rel=1e-3)


@pytest.mark.slow
def test_a_reference_that_is_not_known_leaves_its_output_out() -> None:
    u, y, r = looped(2)
    r[100:150] = np.nan
    found = rp.fit(u, y, DT, **ASKED, reference=r)
    assert set(range(100, 150)) <= set(found.missing.tolist())
    assert distance(found) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
def test_an_input_that_moves_with_the_reference_by_chance_is_from_outside() -> None:
    """It follows half of the set-point, and no disturbance: what else it does counts, too."""
    u, y, r = looped(8)
    other = PLANT[1].simulate(u[:, 1] + 0.5 * r, DT) - PLANT[1].simulate(u[:, 1].copy(), DT)
    a, b, c, _, _ = cont2discrete(tf2ss(PLANT[0].num, PLANT[0].den), DT)
    x, total, more, extra = np.zeros(2), 0.0, np.zeros(SAMPLES), np.zeros(SAMPLES)
    for k in range(SAMPLES):  # the loop is linear: what the further movement adds
        extra[k] = c[0] @ x + other[k]
        total -= DT * extra[k]
        more[k] = -2.0 * extra[k] + total
        x = a @ x + b[:, 0] * more[k]
    found = rp.fit(np.column_stack([u[:, 0] + more, u[:, 1] + 0.5 * r]), y + extra, DT, **ASKED, reference=r)
    reasons = " ".join(found.verdict.reasons)
    assert "input u1 is moved by the reference" in reasons
    assert "input u2 is moved" not in reasons
    assert np.diag(found.covariance)[-1] < 2.0 * np.diag(rp.fit(u, y, DT, **ASKED, reference=r).covariance)[-1]
    assert distance(found) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
@every(
    "reference, words",
    [
        (np.ones(SAMPLES), "the reference stands still"),
        (np.random.default_rng(9).standard_normal(SAMPLES), "the reference explains nothing of any input"),
        ("copy", "the reference is a copy of the input"),
    ],
)
def test_a_reference_of_no_use_changes_no_estimate(reference: Any, words: str) -> None:
    u, y, _ = looped(3)
    u[:, 0] = np.random.default_rng(4).choice([-1.0, 1.0], SAMPLES // 10).repeat(10)
    y = PLANT[0].simulate(u[:, 0].copy(), DT) + PLANT[1].simulate(u[:, 1].copy(), DT) + 1e-3 * y
    found = rp.fit(u, y, DT, **ASKED, reference=u[:, 0] if isinstance(reference, str) else reference)
    assert found.parameters.tobytes() == rp.fit(u, y, DT, **ASKED).parameters.tobytes()
    assert words in " ".join(found.verdict.reasons)


def test_a_law_follows_in_pieces_as_it_does_whole() -> None:
    rng = np.random.default_rng(5)
    signals, inputs = rng.standard_normal((400, 2)), rng.standard_normal((400, 1))
    law = Law.of(signals, inputs)
    after, explained = law.follow(signals)
    parts, done = law, []
    for rows in (slice(0, 1), slice(1, 130), slice(130, 400)):
        parts, part = parts.follow(signals[rows])
        done.append(part)
    assert np.concatenate(done).tobytes() == explained.tobytes()
    assert parts.states.tobytes() == after.states.tobytes()


def test_what_is_explained_of_a_part_knows_nothing_of_the_noise_in_it() -> None:
    """Of an input that follows nothing, what 25 weights explain of the noise that they were fitted to is left out."""
    rng, along = np.random.default_rng(8), []
    for _ in range(30):
        signals, noise = rng.standard_normal((400, 2)), rng.standard_normal((400, 1))
        whole = Law.of(signals, noise).follow(signals)[1]
        parts = Outside.of(noise, signals, np.array([True])).inputs
        along.append([float(np.vdot(each, noise)) for each in (whole, parts)])
    mean, spread = np.mean(along, axis=0), np.std(along, axis=0) / np.sqrt(30.0)
    assert mean[0] > 10.0 * spread[0]
    assert mean[1] < 4.0 * spread[1]


def test_the_parts_of_a_record_make_a_whole() -> None:
    for samples in (9, 100, 4001):
        assert windows(samples).sum(axis=0) == pytest.approx(np.ones(samples))


def test_a_law_is_that_by_which_an_input_follows() -> None:
    signals = np.random.default_rng(6).standard_normal((600, 1))
    followed = lfilter([0.3], [1.0, -0.7], signals[:, 0]) + 2.0
    _, explained = Law.of(signals, followed[:, None]).follow(signals)
    assert explained[:, 0] == pytest.approx(followed, abs=0.02)


@pytest.mark.slow
def test_a_search_finds_the_structure_in_feedback() -> None:
    u, y, r = looped(7, samples=1500)
    found = rp.search(u, y, DT, poles=((1, 2), (1,)), delays=((0.0,), (0.3,)), reference=r)
    assert isinstance(found.best, rp.RowFit)
    assert [each.poles for each in found.best.model.structures] == [2, 1]
