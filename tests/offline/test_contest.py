"""What has changed in a record is told by evidence at one price."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import replant as rp
from replant.assessment.score_test import ALPHA
from replant.engine.record import Record
from replant.offline.contest import Claim, Contest, Supposition, decided
from replant.offline.known_before import Known, forget
from replant.offline.refined import Refined
from replant.offline.solve import solve
from replant.offline.srivc import refine
from replant.offline.srivc_steps import Problem
from support.builders import binary, true_parameters
from support.cases import every

DT, NOISE, BEFORE = 0.05, 0.05, 2000
PLANT = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
STRUCTURE = rp.Structure(2)


def changed(what: str, seed: int, since: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Input, and an output of which something changes after `BEFORE` samples."""
    rng = np.random.default_rng([seed, 7])
    u = binary(seed, BEFORE + since, 12)
    y, after = PLANT.simulate(u, DT), np.arange(u.size) >= BEFORE
    noise = NOISE * rng.standard_normal(u.size)
    if what == "gain":
        y = np.where(after, 1.4 * y, y)
    if what == "plant":
        y = np.where(after, rp.TransferFunction([3.0], [1.0, 7.0, 6.0]).simulate(u, DT), y)
    if what == "load":
        y += after * 0.5
    if what == "drift":
        y += np.cumsum(after) * 0.004
    if what == "noise":
        noise = np.where(after, 4.0 * noise, noise)
    return u, y + noise


def contest_of(
    u: np.ndarray, y: np.ndarray, structure: rp.Structure = STRUCTURE, dt: float = DT, begin: int = BEFORE
) -> tuple[Contest, list[Claim]]:
    """The contest since a sample, and its claims."""
    record = Record(u, y, np.array([dt]))
    before, whole = refine(structure, record.first(begin)), solve(structure, record)
    assert before is not None
    assert whole is not None
    told = Known.before(structure, record, begin, before)
    assert told is not None
    trial = Contest(structure, record, begin, told)
    return trial, trial.claims(whole.found.theta)


def estimated(trial: Contest, claims: list[Claim]) -> tuple[Claim, Refined]:
    """The claim that is decided for, and its estimate."""
    found = decided(claims)
    assert found is not None
    refined = trial.estimate(found)
    assert refined is not None
    return found, refined


@every("seed", range(3))
@every(
    ("what", "supposition"),
    [
        ("load", Supposition.LOAD),
        ("drift", Supposition.LOAD),
        ("gain", Supposition.PART),
        ("plant", Supposition.PLANT),
    ],
)
def test_what_has_changed_is_found(what: str, supposition: Supposition, seed: int) -> None:
    found = decided(contest_of(*changed(what, seed))[1])
    assert found is not None
    assert found.supposition is supposition


@every("seed", range(5))
@every("what", ["none", "noise"])
def test_where_the_plant_has_not_changed_no_change_is_found(what: str, seed: int) -> None:
    """A load of nothing explains as much as one model of all samples: neither says anything else of G(s)."""
    found = decided(contest_of(*changed(what, seed))[1])
    assert found is None or not found.supposition.is_of_plant


@every("what", ["load", "drift", "gain", "plant"])
def test_the_estimate_is_that_of_the_plant_since(what: str) -> None:
    """Within four standard deviations, which a gain that is known but for one direction makes small."""
    _, refined = estimated(*contest_of(*changed(what, 1)))
    true = np.array({"gain": [4.0, 3.0, 2.8], "plant": [7.0, 6.0, 3.0]}.get(what, [4.0, 3.0, 2.0]))
    std = np.sqrt(np.diag(refined.covariance)[:3])
    assert (np.abs(refined.theta[:3] - true) < 4.0 * std).all()
    assert (std < (0.3 if what == "plant" else 0.1) * true).all()


@pytest.mark.parametrize("changed_to", [0, 1, 2])
def test_of_a_coefficient_that_changes_the_others_are_kept(changed_to: int) -> None:
    """What was known of them stays: the covariance of the coefficient that changed alone grows."""
    coefficients = np.array([4.0, 3.0, 2.0])
    coefficients[changed_to] *= 1.5
    plant = rp.TransferFunction(coefficients[2:], [1.0, *coefficients[:2]])
    u, y = changed("none", 4)
    after = np.arange(u.size) >= BEFORE
    y += np.where(after, plant.simulate(u, DT) - PLANT.simulate(u, DT), 0.0)
    trial, claims = contest_of(u, y)
    found, refined = estimated(trial, claims)
    assert found.supposition is Supposition.PART
    known = np.sqrt(np.diag(np.linalg.inv(trial.known.information[:3, :3])))
    std = np.sqrt(np.diag(refined.covariance)[:3])
    assert (np.abs(refined.theta[:3] - coefficients) < 4.0 * std).all()
    assert ((std < 1.05 * known) == (np.arange(3) != changed_to)).all()


def test_where_the_samples_since_tell_no_slow_mode_it_is_not_sure_that_it_was_a_load() -> None:
    """A mode of 20 s; a load, and 1 s of samples since, in which the mode's coefficient could have changed as well."""
    plant, structure, dt = rp.TransferFunction([8.0, 2.0], [1.0, 4.05, 0.2]), rp.Structure(2, 1), 0.01
    u = binary(0, 20_100, 40)
    y = plant.simulate(u, dt) + 0.01 * np.random.default_rng(0).standard_normal(u.size)
    y[20_000:] += 0.3
    _, claims = contest_of(u, y, structure, dt, 20_000)
    assert max(claims, key=lambda claim: claim.evidence).supposition is Supposition.LOAD
    assert decided(claims) is None


def test_what_the_samples_since_do_not_tell_stays_as_it_was_known() -> None:
    """A fast mode beside one of 20 s; the gain changes, and 2 s tell nothing of the slow mode."""
    plant, structure, dt = rp.TransferFunction([8.0, 2.0], [1.0, 4.05, 0.2]), rp.Structure(2, 1), 0.01
    u = binary(0, 40_200, 40)
    y = np.where(np.arange(u.size) < 40_000, 1.0, 1.5) * plant.simulate(u, dt)
    y += 0.01 * np.random.default_rng(0).standard_normal(u.size)
    trial, claims = contest_of(u, y, structure, dt, 40_000)
    refined = trial.estimate(next(each for each in claims if each.supposition is Supposition.PART))
    assert refined is not None
    true = true_parameters(plant, 1) * [1.0, 1.0, 1.5, 1.5]
    assert (np.abs(refined.theta[:4] - true) < 4.0 * np.sqrt(np.diag(refined.covariance)[:4])).all()
    np.testing.assert_allclose(refined.theta[:4], true, rtol=0.05)


def test_forgetting_a_direction_leaves_the_information_about_the_others() -> None:
    """It is that of a density from which the direction is integrated out: flat along it, and the rest unchanged."""
    root = np.random.default_rng(0).standard_normal((4, 4))
    information, direction = root @ root.T, np.array([[1.0], [2.0], [0.0], [-1.0]])
    left = forget(information, direction)
    np.testing.assert_allclose(left @ direction, 0.0, atol=1e-9)
    across = np.linalg.svd(direction)[0][:, 1:]
    loose = np.linalg.inv(np.linalg.inv(information) + 1e9 * direction @ direction.T)
    np.testing.assert_allclose(across.T @ left @ across, across.T @ loose @ across, rtol=1e-5, atol=1e-6)
    assert (forget(information, np.zeros((4, 0))) == information).all()


def test_another_plant_has_to_be_sure_and_so_has_that_there_is_none() -> None:
    trial, claims = contest_of(*changed("gain", 0))
    gain = next(each for each in claims if each.supposition is Supposition.PART)
    whole, sure = replace(claims[-1], fair=20.0, model=trial.known.mean), -math.log(ALPHA)
    assert decided([whole, replace(gain, fair=20.0 - 1.1 * sure)]) is whole
    assert decided([whole, replace(gain, fair=20.0 - 0.5 * sure)]) is None
    assert decided([whole, replace(gain, fair=20.0 + 0.5 * sure)]) is None
    better = replace(gain, fair=20.0 + 1.1 * sure)
    assert decided([whole, better]) is better


def test_columns_beside_a_fit_are_estimated_with_it() -> None:
    """A drift beside the plant: the coefficients are those without it."""
    u, y = changed("none", 3)
    time = np.linspace(-1.0, 0.0, u.size)[:, None]
    plain = Problem(STRUCTURE, Record(u, y, np.array([DT])), time)
    drifts = Problem(STRUCTURE, Record(u, y + 3.0 * time[:, 0], np.array([DT])), time)
    start = np.array([3.0, 2.0, 1.5, 0.0, 0.0, 0.0])
    models = [problem.polish(start)[0] for problem in (plain, drifts)]
    np.testing.assert_allclose(models[0][:3], models[1][:3], rtol=1e-5)
    np.testing.assert_allclose(models[0][:3], [4.0, 3.0, 2.0], rtol=0.05)
