"""What has changed in a record is told by evidence at one price."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import cont2discrete, dlsim, tf2ss
from scipy.stats import chi2, f

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.change_contest import ALPHA, Claim, Contest, decided, is_sure, odds_of, weighed
from replant.estimation.solver.change_evidence import Known, forget
from replant.estimation.solver.refined_estimate import Refined
from replant.estimation.solver.solve import solve
from replant.estimation.solver.srivc import refine
from replant.estimation.solver.srivc_steps import Problem
from replant.kernels.schema import Supposition
from support.builders import binary, true_parameters
from support.cases import every

DT, NOISE, BEFORE = 0.05, 0.05, 2000
PLANT = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])
STRUCTURE = rp.Structure(2)


def changed(what: str, seed: int, since: int = 300, rests: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Input, and an output of which something changes after `BEFORE` samples; the input rests over the last ones."""
    rng = np.random.default_rng([seed, 7])
    u = binary(seed, BEFORE + since, 12)
    u[u.size - rests :] = u[u.size - rests - 1]
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
    if what == "cut":
        y, noise = np.where(after, 0.3, y), np.where(after, 6.0 * noise, noise)
    return u, y + noise


def known(record: Record, structure: rp.Structure = STRUCTURE, begin: int = BEFORE) -> tuple[Known, Refined]:
    """What the samples before tell."""
    found = refine(structure, record.first(begin))
    assert found is not None
    size = structure.coefficients
    information = np.zeros((found.theta.size, found.theta.size))
    information[:size, :size] = np.linalg.inv(found.covariance[:size, :size])
    told = Known.before(structure, record, begin, found.theta, information, found.variance)
    assert told is not None
    return told, found


def contest(what: str, seed: int, since: int = 300) -> Contest:
    u, y = changed(what, seed, since)
    record = Record(u, y, np.array([DT]))
    return Contest(STRUCTURE, record, BEFORE, known(record)[0])


@every("what", ["gain", "plant", "load", "drift"])
def test_while_the_input_rests_no_other_plant_is_told(what: str) -> None:
    """Any gain explains such samples with a fitting offset: of a tank that filled a gain of -1.5e9 had been taken."""
    u, y = changed(what, 0, rests=301)
    record = Record(u, y, np.array([DT]))
    claims = Contest(STRUCTURE, record, BEFORE, known(record)[0]).claims()
    assert not any(claim.supposition.is_of_plant for claim in claims)
    found = decided(claims)
    assert found is not None
    assert found.supposition is Supposition.LOAD


@pytest.mark.slow
@every("seed", range(3))
@every(
    ("what", "supposition"),
    [
        ("none", Supposition.NOTHING),
        ("noise", Supposition.NOISE),
        ("load", Supposition.LOAD),
        ("drift", Supposition.LOAD),
        ("gain", Supposition.PART),
        ("plant", Supposition.PLANT),
        ("cut", Supposition.CUT),
    ],
)
def test_what_has_changed_is_found(what: str, supposition: Supposition, seed: int) -> None:
    found = decided(contest(what, seed).claims())
    assert found is not None
    assert found.supposition is supposition


@every("unit", [1e-3, 1.0, 1e3])
def test_what_a_claim_leaves_is_told_beside_the_usual_variance_in_any_unit(unit: float) -> None:
    u, y = changed("gain", 0)
    record = Record(u, unit * y, np.array([DT]))
    found = decided(Contest(STRUCTURE, record, BEFORE, known(record)[0]).claims())
    assert found is not None
    assert found.supposition is Supposition.PART
    assert found.left == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / 300))  # of 300 samples of the same noise


@pytest.mark.parametrize("changed_to", [0, 1, 2])
def test_of_a_coefficient_that_changes_the_others_are_kept(changed_to: int) -> None:
    """What was known of them stays: the covariance of the coefficient that changed alone grows."""
    coefficients = np.array([4.0, 3.0, 2.0])
    coefficients[changed_to] *= 1.5
    plant = rp.TransferFunction(coefficients[2:], [1.0, *coefficients[:2]])
    u, y = changed("none", 4)
    after = np.arange(u.size) >= BEFORE
    y += np.where(after, plant.simulate(u, DT) - PLANT.simulate(u, DT), 0.0)
    record = Record(u, y, np.array([DT]))
    told, before = known(record)
    trial = Contest(STRUCTURE, record, BEFORE, told)
    claims = trial.claims()
    found = decided(claims)
    assert found is not None
    assert found.supposition is Supposition.PART
    assert is_sure(claims, found)
    refined = trial.estimate(found)
    assert refined is not None
    std, std_before = (np.sqrt(np.diag(each.covariance)[:3]) for each in (refined, before))
    assert (np.abs(refined.theta[:3] - coefficients) < 4.0 * std).all()
    assert ((std < 1.05 * std_before) == (np.arange(3) != changed_to)).all()


def test_where_the_samples_since_tell_no_slow_mode_it_is_not_sure_that_it_was_a_load() -> None:
    """A mode of 20 s; a load, and 1 s of samples since, in which the mode's coefficient could have changed as well."""
    plant, structure, dt = rp.TransferFunction([8.0, 2.0], [1.0, 4.05, 0.2]), rp.Structure(2, 1), 0.01
    u = binary(0, 20_100, 40)
    y = plant.simulate(u, dt) + 0.01 * np.random.default_rng(0).standard_normal(u.size)
    y[20_000:] += 0.3
    record = Record(u, y, np.array([dt]))
    trial = Contest(structure, record, 20_000, known(record, structure, 20_000)[0])
    claims = trial.claims()
    found = max(claims, key=lambda claim: claim.evidence)
    assert found.supposition is Supposition.LOAD
    assert not is_sure(claims, found)
    u, y = changed("load", 0)
    trial = contest("load", 0)
    claims = trial.claims()
    found = decided(claims)
    assert found is not None
    assert is_sure(claims, found)


def test_a_rest_is_not_taken_for_a_cable_that_is_off() -> None:
    u, y = changed("noise", 5)
    rest = slice(BEFORE, None)
    y[rest] += (
        PLANT.simulate(np.append(u[:BEFORE], np.full(300, u[BEFORE - 1])), DT)[rest] - PLANT.simulate(u, DT)[rest]
    )
    u[rest] = u[BEFORE - 1]
    record = Record(u, y, np.array([DT]))
    claims = Contest(STRUCTURE, record, BEFORE + 100, known(record)[0]).claims()
    assert Supposition.CUT not in {claim.supposition for claim in claims}


@pytest.mark.parametrize("what", ["load", "drift", "gain", "plant"])
def test_the_estimate_is_that_of_the_plant_since(what: str) -> None:
    """Within four standard deviations, which a gain that is known but for one direction makes small."""
    trial = contest(what, 1)
    found = decided(trial.claims())
    assert found is not None
    refined = trial.estimate(found)
    assert refined is not None
    true = np.array({"gain": [4.0, 3.0, 2.8], "plant": [7.0, 6.0, 3.0]}.get(what, [4.0, 3.0, 2.0]))
    std = np.sqrt(np.diag(refined.covariance)[:3])
    assert (np.abs(refined.theta[:3] - true) < 4.0 * std).all()
    assert (std < (0.3 if what == "plant" else 0.1) * true).all()


def test_a_model_that_was_wrong_gives_way_to_one_of_all_samples() -> None:
    """The estimate of the first 60 samples; the plant has not changed."""
    u, y = changed("none", 2)
    record, begin = Record(u, y, np.array([DT])), 60
    told, _ = known(record, begin=begin)
    trial = Contest(STRUCTURE, record, begin, told)
    whole = solve(STRUCTURE, record)
    assert whole is not None
    found = decided([*trial.claims(again=True), trial.whole(whole.found.theta, whole)])
    assert found is not None
    assert found.supposition is Supposition.WHOLE


def test_after_a_change_one_model_of_all_samples_loses() -> None:
    trial = contest("gain", 0)
    whole = solve(STRUCTURE, trial.record)
    assert whole is not None
    found = decided([*trial.claims(again=True), trial.whole(whole.found.theta, whole)])
    assert found is not None
    assert found.supposition is Supposition.PART


def test_what_the_samples_since_do_not_tell_stays_as_it_was_known() -> None:
    """A fast mode beside one of 20 s; the gain changes, and 2 s tell nothing of the slow mode."""
    plant, structure, dt = rp.TransferFunction([8.0, 2.0], [1.0, 4.05, 0.2]), rp.Structure(2, 1), 0.01
    u = binary(0, 40_200, 40)
    y = np.where(np.arange(u.size) < 40_000, 1.0, 1.5) * plant.simulate(u, dt)
    y += 0.01 * np.random.default_rng(0).standard_normal(u.size)
    told, found = known(Record(u[:40_000], y[:40_000], np.array([dt])), structure, 40_000)
    since = Record(u[39_000:], y[39_000:], np.array([dt]))
    told = Known.before(structure, since, 1000, found.theta, told.information, found.variance)
    assert told is not None
    trial = Contest(structure, since, 1000, told)
    claim = next(each for each in trial.claims() if each.supposition is Supposition.PART)
    refined = trial.estimate(claim)
    assert refined is not None
    true = true_parameters(plant, 1) * [1.0, 1.0, 1.5, 1.5]
    assert (np.abs(refined.theta[:4] - true) < 4.0 * np.sqrt(np.diag(refined.covariance)[:4])).all()
    np.testing.assert_allclose(refined.theta[:4], true, rtol=0.05)


@every("seed", range(3))
@every(("since", "is_told"), [(200, False), (800, True)])
def test_what_may_have_moved_is_said_to_be_uncertain_until_it_is_told(since: int, is_told: bool, seed: int) -> None:
    """The coefficient of a mode of 20 s jumps by half, its state goes on: 2 s do not tell it from a load, 8 s do."""
    structure, dt, begin = rp.Structure(2, 1), 0.01, 20_000
    u, after = binary(seed, begin + since, 40), [1.0, 4.05, 0.3]
    old, new = ((*cont2discrete(tf2ss([8.0, 2.0], den), dt)[:4], dt) for den in ([1.0, 4.05, 0.2], after))
    _, y, state = dlsim(old, u[: begin + 1])
    y = np.append(y[:begin, 0], dlsim(new, u[begin:], x0=state[begin])[1][:, 0])
    y += 0.01 * np.random.default_rng(seed).standard_normal(u.size)
    record = Record(u, y, np.array([dt]))
    trial = Contest(structure, record, begin, known(record, structure, begin)[0])
    claims = trial.claims()  # in the last record the fit to the samples since does not settle, and is a rival
    found = decided(claims)
    assert (found is not None and is_sure(claims, found)) == is_told
    if is_told:
        refined = trial.estimate(found)
        assert refined is not None
        assert abs(refined.theta[1] - after[2]) < 4.0 * np.sqrt(refined.covariance[1, 1])


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


def dispersed(*dispersion: float) -> Contest:
    """Return a contest without samples, whose stretches before the change are so dispersed."""
    contest = Contest.__new__(Contest)
    contest.dispersion = dispersion[0], dispersion[1]
    return contest


def test_another_plant_has_to_be_sure_and_so_has_that_there_is_none() -> None:
    linear = dispersed(1.0, math.inf)

    def claim(supposition: Supposition, fair: float) -> Claim:
        return Claim(supposition, linear, fair, odds_of(supposition))

    load, sure = claim(Supposition.LOAD, 20.0), -math.log(ALPHA)
    assert decided([load, claim(Supposition.PART, 19.0)]) is load
    assert decided([load, claim(Supposition.PART, 20.0 + 0.5 * sure)]) is None
    gain = claim(Supposition.PART, 20.0 + 1.1 * sure)
    found = decided([load, gain])
    assert found is not None
    assert (found.supposition, found.fair) == (gain.supposition, gain.fair)
    assert decided([load, claim(Supposition.CUT, 15.0)]) is None
    for same in (Supposition.NOTHING, Supposition.NOISE):  # believed, a load forgets most of the samples before
        assert decided([load, claim(same, 20.0 - 0.9 * sure)]) is None
        assert decided([load, claim(same, 20.0 - 1.1 * sure)]) is load
    assert decided([load, claim(Supposition.CUT, 20.0 - 1.1 * sure)]) is load


def test_an_output_that_answers_otherwise_is_told_from_one_that_does_not_answer() -> None:
    """Beside the noise both explain much, and what one explains beyond the other is as much again."""
    contest = dispersed(1.0, 16.0)
    suppositions = {Supposition.NOISE: 2940.0, Supposition.CUT: 3260.0, Supposition.PART: 3600.0}
    found = decided([Claim(each, contest, fair, odds_of(each)) for each, fair in suppositions.items()])
    assert found is not None
    assert found.supposition is Supposition.PART


def test_a_change_counts_beside_how_differently_any_stretch_is_fitted() -> None:
    """Its evidence is the logarithm of the chance that an F distribution of 2 and n gives what it explains."""
    contest = dispersed(4.0, 16.0)
    load, change = (Claim(each, contest, fair) for each, fair in ((Supposition.LOAD, 10.0), (Supposition.PART, 90.0)))
    assert weighed([load, change])[0] is load
    evidence = weighed([load, change])[1].fair - 10.0
    assert evidence == pytest.approx(-f.logsf((90.0 - 10.0) / 4.0, 2, 16.0))
    worse = replace(change, likelihood=6.0)
    assert weighed([load, worse])[1].fair == pytest.approx(9.0)  # what is open stays open


def test_one_model_of_all_samples_is_as_likely_as_its_most_likely_model() -> None:
    """A slow mode beside one pole: the output error's model is served, the filtered one is likelier by 100 nats."""
    u, structure = binary(0, 4000, 12), rp.Structure(1)
    y = sum(rp.TransferFunction([num], [1.0, pole]).simulate(u, DT) for num, pole in ((3.0, 3.0), (0.1, 0.05)))
    record = Record(u, y + NOISE * np.random.default_rng(0).standard_normal(u.size), np.array([DT]))
    whole, trial = solve(structure, record), Contest(structure, record, 800, known(record, structure, 800)[0])
    assert whole is not None
    one = trial.whole(whole.found.theta, whole)
    load = next(claim for claim in trial.claims(again=True) if claim.supposition is Supposition.LOAD)
    assert one.fair < load.fair - 50.0
    assert one.fair + one.unserved > load.fair - 50.0
    change = Claim(Supposition.PART, dispersed(1.0, math.inf), one.fair + 0.9 * one.unserved, odds_of(Supposition.PART))
    assert decided([one, change]) is one
    found = decided([replace(one, unserved=0.0), change])
    assert found is not None
    assert found.supposition is Supposition.PART


@every("seed", range(3))
def test_a_change_that_is_noticed_late_is_no_scatter_before_it(seed: int) -> None:
    """The gain changes 150 samples before the begin: what the stretches before scatter by is chance alone."""
    late, length = 150, 200
    u, y = changed("gain", seed, late + length)
    record = Record(u, y, np.array([DT]))
    _, found = known(record)  # the estimate rests as the alarm is raised
    information = np.zeros((found.theta.size, found.theta.size))
    size = STRUCTURE.coefficients
    information[:size, :size] = np.linalg.inv(found.covariance[:size, :size])
    told = Known.before(STRUCTURE, record, BEFORE + late, found.theta, information, found.variance)
    assert told is not None
    dispersion, numbers = told.dispersion(record, length)
    assert dispersion < chi2.ppf(0.999, numbers) / numbers


@every("dispersion", [1.0, 4.0])
def test_another_change_is_less_likely_by_what_it_leaves(dispersion: float) -> None:
    """Two changes that are far from none are told from each other by their own distance."""
    contest = dispersed(dispersion, math.inf)
    contest.differ = lambda model, other: bool((model != other).any())  # type: ignore[method-assign]
    far, limit = 1e4, -dispersion * math.log(ALPHA)
    best = Claim(Supposition.PLANT, contest, far, model=np.ones(2))
    for left, sure in ((0.9 * limit, False), (1.1 * limit, True)):
        other = Claim(Supposition.PART, contest, far - left, model=np.zeros(2))
        assert is_sure([best, other], best) == sure
        assert is_sure([best, replace(other, model=np.ones(2))], best)  # that says the same of G(s)


def test_a_load_is_sure_only_where_another_plant_is_not_as_likely_with_its_numbers_free() -> None:
    contest = dispersed(1.0, math.inf)
    contest.known = SimpleNamespace(mean=np.ones(2))  # type: ignore[assignment]
    contest.differ = lambda model, other: bool((model != other).any())  # type: ignore[method-assign]
    load = Claim(Supposition.LOAD, contest, 50.0)
    for price, sure in ((5.0, True), (30.0, False)):
        plant = Claim(Supposition.PLANT, contest, 30.0 + price, price=price, model=np.zeros(2))
        assert is_sure([load, plant], load) == sure


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
