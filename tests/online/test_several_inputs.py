"""`Identifier` of several inputs: each transfer function has poles and a dead time of its own."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.simulation.miso import evaluate
from replant.estimation.solver.miso_steps import start
from replant.numerics.arguments import FloatArray
from replant.numerics.linear_algebra import chi2_quantile, compose
from replant.online.checkpoint.bank_and_row import row_parts
from replant.online.checkpoint.encoding import ROW, encode_other
from replant.online.miso_step import RowStep
from support.cases import every
from support.rows import ASKED, DT, FAST, SLOW, TRUE, noisy, row_of, toggling

SAMPLES = 1500
LENGTH = 760  # of a record with all that can be wrong: it is solved a second time, behind the gap


def begun(**more: Any) -> Any:
    return rp.Identifier(**ASKED, dt=DT, **more)


def record(
    seed: int, samples: int = SAMPLES, pole: float = 0.0, decibels: float = 10.0
) -> tuple[FloatArray, FloatArray]:
    u = toggling(seed, samples=samples)
    return u, noisy(seed, row_of(u, FAST, SLOW), pole, decibels)


def distance(found: Any, true: FloatArray = TRUE) -> float:
    error = found.parameters - true
    return float(error @ np.linalg.solve(found.covariance, error))


def test_a_row_without_noise_is_found_exactly() -> None:
    u = toggling(0, samples=SAMPLES)
    ident = begun()
    trace = ident.update_many(u, row_of(u, FAST, SLOW))
    assert ident.parameters == pytest.approx(TRUE, rel=1e-6)
    assert ident.names == trace.names == ("a1.u1", "a0.u1", "b0.u1", "a0.u2", "b0.u2")
    assert np.abs(trace.errors[600:]).max() < 1e-5
    assert np.isnan(trace.errors[:500]).all()
    assert not trace.parameters[:499].any()


@every("pole", [0.0, 0.9])
def test_the_first_estimate_is_what_fit_finds(pole: float) -> None:
    u, y = record(1, samples=500, pole=pole)
    ident = begun()
    ident.update_many(u, y)
    fitted = rp.fit(u, y, DT, **ASKED)
    assert (ident.parameters == fitted.parameters).all()
    assert ident.covariance == pytest.approx(fitted.covariance, rel=1e-4)
    assert ident.noise.variance == pytest.approx(fitted.noise.variance, rel=1e-12)


@pytest.mark.slow
@every("pole", [0.0, 0.9])
def test_between_two_solutions_the_recursion_is_what_a_solution_would_be(pole: float) -> None:
    """They differ by the colour that the newest samples add, and by the curvature: by little beside the deviation."""
    u, y = record(1, pole=pole)
    ident = begun()
    ident.update_many(u, y)
    fitted = rp.fit(u, y, DT, **ASKED)
    std = np.sqrt(np.diag(fitted.covariance))
    assert np.abs((ident.parameters - fitted.parameters) / std).max() < 0.5
    assert np.sqrt(np.diag(ident.covariance)) == pytest.approx(std, rel=0.2)
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)
    assert ident.noise.order == fitted.noise.order == (pole > 0.0)
    ident.finish()
    assert np.abs((ident.parameters - fitted.parameters) / std).max() < 0.02


@pytest.mark.slow
def test_of_a_long_record_the_newest_samples_are_learned_though_it_is_not_solved(monkeypatch: Any) -> None:
    monkeypatch.setattr("replant.online.miso_state.RECENT", 2000)
    u, y = record(2, 5000)
    ident = begun()
    ident.update_many(u, y)
    fitted = rp.fit(u, y, DT, **ASKED)
    assert np.sqrt(np.diag(ident.covariance)) == pytest.approx(np.sqrt(np.diag(fitted.covariance)), rel=0.3)
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)


@pytest.fixture(scope="module")
def awkward() -> tuple[FloatArray, FloatArray, FloatArray]:
    """Outputs and inputs that are missing, a gap, stamps that jitter and one that does not advance."""
    u, y = record(3, LENGTH)
    t = DT * np.arange(LENGTH) + 0.2 * DT * np.random.default_rng(3).uniform(size=LENGTH)
    y[[0, 3, 560, 561, 600]], u[[40, 580], [0, 1]], t[610] = np.nan, np.inf, t[609]
    t[680:] += 30.0
    return u, y, t


@every("stamped", [False, True])
def test_chunks_of_any_size_give_the_same_bits(awkward: Any, stamped: bool) -> None:
    u, y, t = awkward
    whole, chunks, single = begun(), begun(), begun()
    trace = whole.update_many(u, y, t if stamped else None)
    parts = [slice(begin, begin + 97) for begin in range(0, LENGTH, 97)]
    joined = [chunks.update_many(u[rows], y[rows], t[rows] if stamped else None) for rows in parts]
    errors, estimates = np.empty(LENGTH), np.empty_like(trace.parameters)
    for k in range(LENGTH):
        given = tuple(u[k].tolist()), float(y[k]), float(t[k]) if stamped else None
        errors[k] = single.update(*given)
        estimates[k] = single.parameters
        if k % 97 == 0:  # a copy goes on by itself
            single.clone().update(*given)
    assert whole.to_bytes() == chunks.to_bytes() == single.to_bytes()
    assert np.array_equal(np.concatenate([each.errors for each in joined]), trace.errors, equal_nan=True)
    assert np.array_equal(errors, trace.errors, equal_nan=True)
    assert np.array_equal(estimates, trace.parameters)
    assert np.array_equal(np.concatenate([each.parameters for each in joined]), trace.parameters)


def test_a_sample_that_is_interrupted_was_not_taken(monkeypatch: Any, awkward: Any) -> None:
    u, y, _ = awkward
    ident, other = (begun(startup=300) for _ in range(2))
    for each in (ident, other):
        each.update_many(u[:400], y[:400])
        for k in range(400, 410):
            each.update(tuple(u[k].tolist()), 0.5)
    taken = RowStep.take

    def interrupted(step: Any, *given: Any) -> float:
        taken(step, *given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(RowStep, "take", interrupted)
        with pytest.raises(KeyboardInterrupt):
            ident.update(tuple(u[410].tolist()), 0.5)
    assert ident.samples == other.samples
    for k in range(410, 420):
        assert ident.update(tuple(u[k].tolist()), 0.5) == other.update(tuple(u[k].tolist()), 0.5)
    assert ident.to_bytes() == other.to_bytes()


def test_an_argument_that_is_the_default_is_none_to_refuse() -> None:
    with_defaults = rp.Identifier(
        poles=(1, 1), dt=DT, background=False, normalize=True, optimizer="auto", preprocess=rp.Preprocess(), zeros=0
    )
    assert with_defaults.request == rp.Identifier(poles=(1, 1), dt=DT).request
    with pytest.raises(rp.ReplantError, match="several inputs take no background yet"):
        rp.Identifier(poles=(1, 1), dt=DT, background=True)


def test_what_cannot_be_used_is_counted_and_changes_nothing(awkward: Any) -> None:
    u, y, t = awkward
    ident = begun()
    ident.update_many(u, y, t)
    assert {reason: count for reason, count in ident.rejected.items() if count} == {
        "not finite": 2, "not later": 1, "no output": 5,
    }  # fmt: skip
    assert (ident.samples, ident.taken) == (LENGTH - 3, LENGTH)
    before = ident.to_bytes()
    for sample in (((1.0, np.nan), 2.0, 1e3), ((1.0, 2.0), np.inf, 1e3), ((1.0, 2.0), 2.0, np.nan), ((1, 1), 2, 0.0)):
        assert np.isnan(ident.update(*sample))
    ident.update((1e200, 0.0), 1.0, 1e3)
    assert {reason: count for reason, count in ident.rejected.items() if count} == {
        "not finite": 5, "too large": 1, "not later": 2, "no output": 5,
    }  # fmt: skip
    restored = rp.Identifier.from_bytes(before)
    assert (restored.parameters == ident.parameters).all()
    assert (restored.covariance == ident.covariance).all()


@pytest.mark.slow
def test_behind_a_gap_the_state_is_estimated_anew() -> None:
    u, y = record(4, 2000)
    t = DT * np.arange(2000)
    kept = np.r_[0:800, 1200:2000]
    ident = begun(startup=700)  # solved again with 910 samples
    ident.update_many(u[kept][:900], y[kept][:900], t[kept][:900])
    fitted = rp.fit(u[kept][:900], y[kept][:900], DT, t=t[kept][:900], **ASKED)
    std = np.sqrt(np.diag(fitted.covariance))
    assert np.abs((ident.parameters - fitted.parameters) / std).max() < 0.5
    trace = ident.update_many(u[kept][900:], y[kept][900:], t[kept][900:])
    assert np.nanstd(trace.errors[-300:]) < 1.2 * np.sqrt(ident.noise.residual_variance)
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)


def test_what_stretches_before_the_last_tell_of_the_plant_counts() -> None:
    u, y = record(2)
    t = np.arange(SAMPLES) * DT + np.where(np.arange(SAMPLES) < 1000, 0.0, 100.0 * DT)
    ident = begun()
    ident.update_many(u, y, t)
    ident.finish()
    known, (_, row, _) = ident._now.recursion, ident._now.record()
    point = evaluate(row, known.theta, known.noise)
    before, _ = evaluate(row, known.theta, known.noise, point).phi  # with the initial states of the first
    told = np.linalg.inv(compose(known.factor, known.diagonal)[: TRUE.size, : TRUE.size])
    beyond = np.linalg.eigvalsh(told - before.T @ before)
    assert beyond.min() > -1e-6 * np.linalg.norm(told, 2)


def test_a_checkpoint_goes_on_to_the_bit(tmp_path: Path) -> None:
    u, y = record(5)
    whole, ident = begun(), begun()
    whole.update_many(u, y)
    for cut in ((0, 300), (300, 620), (620, 1400)):
        ident.update_many(u[slice(*cut)], y[slice(*cut)])
        ident.save(tmp_path / "row", {"sequence": cut[1]})
        ident = rp.load(tmp_path / "row")
    twins = copy.deepcopy(ident), ident.clone(), pickle.loads(pickle.dumps(ident))
    for each in (ident, *twins):
        each.update_many(u[1400:], y[1400:])
        assert each.to_bytes() == whole.to_bytes()
    damaged = bytearray(whole.to_bytes())
    damaged[len(damaged) // 2] ^= 1
    with pytest.raises(rp.DamagedCheckpointError, match="checksum"):
        rp.Identifier.from_bytes(bytes(damaged))


@pytest.mark.parametrize(("name", "wrong"), [("counts", -1), ("squares", np.nan), ("squares", -1.0)])
def test_an_alarm_that_cannot_be_is_damage(name: str, wrong: float) -> None:
    ident = begun()
    ident.update_many(*record(5, 600))
    plain, arrays = row_parts(ident._now)
    changed = arrays[name].copy()
    changed[-1] = wrong
    with pytest.raises(rp.DamagedCheckpointError, match="not valid"):
        rp.Identifier.from_bytes(encode_other(ROW, plain, arrays | {name: changed}, None))


@pytest.mark.slow
def test_the_model_is_that_of_the_samples_so_far() -> None:
    u, y = record(6)
    ident = begun()
    assert (ident.status, ident.has_model, ident.assess().status) == ("starting", False, "converging")
    with pytest.raises(rp.InvalidArgumentError, match="no sample yet"):
        _ = ident.model
    ident.update_many(u[:100], y[:100])
    assert "100 of the 500 outputs" in ident.assess().reasons[0]
    ident.update_many(u[100:], y[100:])
    model = ident.model
    assert (model.parameters == ident.parameters).all()
    assert model.verdict.status == ident.assess().status == "trusted"
    assert (model.covariance == ident.covariance).all()
    assert model.simulated_fit == pytest.approx(rp.fit(u, y, DT, **ASKED).fit, abs=0.1)
    assert rp.RowModel.from_json(model.to_json()) == model
    assert [str(g) for g in ident.transfer_functions] == [str(g) for g in model.transfer_functions]
    assert ident.uncertainty[1].std == pytest.approx(np.sqrt(np.diag(ident.covariance))[3:])
    assert "u2: " in repr(ident)
    assert model.provenance.samples == SAMPLES


def test_a_frozen_estimate_rests_and_reset_forgets() -> None:
    u, y = record(7)
    ident = begun()
    with pytest.raises(rp.InvalidArgumentError, match="freezing needs a model"):
        ident.freeze()
    ident.update_many(u[:600], y[:600])
    ident.freeze()
    before = ident.parameters
    ident.update_many(u[600:1000], y[600:1000])
    assert (ident.parameters == before).all()
    assert not ident.adapting
    ident.resume()
    ident.update_many(u[1000:], y[1000:])
    assert (ident.parameters != before).all()
    ident.reset()
    assert ident.to_bytes() == begun().to_bytes()


def test_an_input_that_rests_is_named() -> None:
    u = toggling(8, samples=SAMPLES)
    u[:, 1] = 3.0
    ident = begun()
    ident.update_many(u, noisy(8, row_of(u[:, :1], FAST)))
    verdict = ident.assess()
    assert (verdict.status, verdict.excited) == ("not excited", False)


@pytest.mark.slow
def test_a_model_stays_trusted_while_all_inputs_rest_and_it_is_said() -> None:
    """They rest over a third of the samples: where one of them moves on, something can be learned."""
    for moves_on in (True, False):
        u = toggling(8, samples=SAMPLES)
        u[1000:, 1] = u[999, 1]
        if not moves_on:
            u[1000:, 0] = u[999, 0]
        ident = begun()
        ident.update_many(u, noisy(8, row_of(u, FAST, SLOW)))
        verdict = ident.assess()
        assert (verdict.status, verdict.excited) == ("trusted", moves_on), verdict
        assert ("no input has moved for the last" in verdict.reasons[-1]) is not moves_on


@every(
    "call, words",
    [
        (lambda: rp.Identifier(poles=(1, 1)), "give the sampling time"),
        (lambda: rp.Identifier(poles=1, zeros=(0, 0), dt=DT), "poles has 1 entry|give the number of poles of each"),
        (lambda: rp.Identifier(poles=(), dt=DT), "poles must have one entry for each input"),
        (lambda: rp.Identifier(None, DT, 500, poles=(1, 1)), "takes structure and dt without their names, got 3"),
        (lambda: begun(input_names="ab"), "input_names must be a list or tuple of names"),
        (lambda: begun(input_names=None), "input_names must be a list or tuple of names"),
        (lambda: rp.Ensemble(begun(), 2), "an Identifier of one input and one structure"),
        (lambda: rp.Identifier(poles=(1, 1), delay=(0.1,), dt=DT), "delay has 1 entry and u 2 inputs"),
        (lambda: rp.Identifier(poles=(1, 1), delay=(0.0, 1e18), dt=DT), "at most 1,000,000 sampling times"),
        (lambda: rp.Identifier(poles=(6, 6), dt=DT), "at most 10 in all, got 12"),
        (lambda: rp.Identifier(poles=(1, 1), dt=DT, optimizer="adam"), "several inputs take no optimizer yet"),
        (lambda: rp.Identifier(poles=(1, 1), dt=DT, history=100), "history must be at least 10000"),
        (lambda: begun(input_names=("Q1", "Q1")), "input_names must be 2 different names"),
        (lambda: begun(input_hold="spline"), "input_hold must be one of"),
        (lambda: begun().update(1.0, 2.0), r"u must be a number for each of 2 inputs"),
        (lambda: begun().update((1.0, 2.0, 3.0), 2.0), r"a number for each of 2 inputs, got \(1.0, 2.0, 3.0\)"),
        (lambda: begun().update((1.0, "x"), 2.0), "u must hold real numbers"),
        (lambda: begun().update((1.0, 1.0), 2.0, r="x"), "reference must hold real numbers"),
        (lambda: begun().update_many(np.zeros((3, 2)), np.zeros(2)), "of 2 samples|for 2 outputs"),
    ],
)
def test_what_does_not_match_is_named_in_a_line(call: Any, words: str) -> None:
    with pytest.raises(rp.ReplantError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_an_update_to_an_unstable_pole_is_named_and_solved_anew() -> None:
    u, y = record(0, 3500)
    ident = begun()
    ident.update_many(u, y)
    now = ident._now
    off = now.recursion.delta.copy()
    off[1] = -100.0  # a0 of the first input
    ident._now = dataclasses.replace(now, recursion=dataclasses.replace(now.recursion, delta=off))
    assert ident.assess().status == "diverged"
    assert "made a pole unstable" in ident.assess().reasons[0]
    ident.finish()
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)
    assert ident.assess().status == "trusted"


def test_finish_in_start_up_leaves_when_the_first_model_is_made() -> None:
    u, y = record(0, 600)
    ident, usual = begun(), begun()
    for part in (slice(0, 5), slice(5, 600)):
        ident.update_many(u[part], y[part])
        if part.start == 0:
            ident.finish()
    usual.update_many(u, y)
    assert (ident.parameters == usual.parameters).all()


def test_finish_does_not_learn_what_came_while_the_estimate_was_frozen() -> None:
    u, y = record(0, 1500)
    y[1000:1300] *= 3.0
    ident = begun()
    for end in (1000, 1300, 1500):
        ident.update_many(u[ident.samples : end], y[ident.samples : end])
        if end == 1000:
            ident.freeze()
        elif end == 1300:
            ident.resume()
    before = ident.parameters
    ident.finish()
    assert (ident.parameters == before).all()


@pytest.mark.slow
@every("poles, seed, again", [((2, 1), 0, False), ((2, 1), 1, True), ((1, 1), 0, True)])
def test_a_record_begins_afresh_where_its_model_may_not_be_the_likeliest(
    monkeypatch: Any, poles: Any, seed: int, again: bool
) -> None:
    """Another model is as likely at first; or of an input with a pole too few more of the output can be explained."""
    begins = []

    def counted(structures: Any, record: Any, *others: Any) -> Any:
        begins.append(record.u.size)
        return start(structures, record, *others)

    monkeypatch.setattr("replant.fitting.miso_solve.start", counted)
    ident = rp.Identifier(poles=poles, delay=(0.0, 0.3), dt=DT)
    ident.update_many(*record(seed))
    first, *others = dict.fromkeys(begins)
    assert first == 500
    assert bool(others) is again


@pytest.mark.slow
@every("seed", [0, 6, 9, 10], quick=1)
def test_a_start_at_another_minimum_is_mended(seed: int) -> None:
    """The first 500 samples are explained as well by a fast branch in the place of the slow one."""
    u = toggling(seed, samples=2600, correlation=0.9)
    ident = begun()
    ident.update_many(u, noisy(seed, row_of(u, FAST, SLOW), 0.9))
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
def test_an_input_that_moves_late_is_learned() -> None:
    """It is solved for at the next look, not when the record has grown by half."""
    u = toggling(1, samples=3500)
    u[:2000, 1] = 0.0
    y, ident = noisy(1, row_of(u, FAST, SLOW), 0.9, 20.0), begun()
    for part in (slice(0, 2600), slice(2600, 3500)):
        ident.update_many(u[part], y[part])
        assert ident.assess().status == "trusted"
        assert distance(ident) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
def test_inputs_that_move_very_late_are_learned() -> None:
    u = toggling(5, samples=20_000)
    u[:11_000] = 0.0
    ident = begun()
    ident.update_many(u, noisy(5, row_of(u, FAST, SLOW)))
    assert ident.assess().status == "trusted"
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)


def test_stamps_come_with_every_sample_or_with_none() -> None:
    ident = begun()
    ident.update((1.0, 2.0), 3.0)
    before = ident.to_bytes()
    with pytest.raises(rp.InvalidArgumentError, match="give t with every sample"):
        ident.update((1.0, 2.0), 3.0, 0.1)
    assert ident.to_bytes() == before


def test_bad_outputs_are_left_out_where_the_record_is_solved() -> None:
    u = np.random.default_rng(0).choice([-1.0, 1.0], (60, 2)).repeat(10, axis=0)
    first, second = rp.TransferFunction([2.0], [1.0, 0.5]), rp.TransferFunction([1.0], [1.0, 3.0], delay=0.3)
    y = first.simulate(u[:, 0].copy(), 0.1) + second.simulate(u[:, 1].copy(), 0.1) + 7.0
    y += 0.02 * np.random.default_rng(1).standard_normal(600)
    y[[150, 333]] += 9.0
    ident = rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1, startup=100)
    ident.update_many(u, y)
    ident.finish()
    whole = rp.fit(u, y, 0.1, poles=(1, 1), delay=(0.0, 0.3))
    assert isinstance(whole, rp.RowFit)
    assert whole.outliers.tolist() == [150, 333]
    assert ident.parameters == pytest.approx(whole.parameters, rel=1e-3)
    assert ident.model.simulated_fit == pytest.approx(whole.fit, abs=0.1)
    assert dict(ident.model.rejected)["outlier"] == 2
    assert ident.assess().status == "trusted"


def test_an_input_that_a_controller_makes_is_named_before_the_record_is_solved_again() -> None:
    r, noise = toggling(4, samples=1000), np.random.default_rng(4).standard_normal(1000)
    u, y, state, error, a = r.copy(), np.zeros(1000), 0.0, 0.0, np.exp(-DT)
    for k in range(1, 1000):
        state = a * state + (1.0 - a) * u[k - 1, 0]
        error = 0.95 * error + 0.1 * noise[k]
        y[k] = state + error
        u[k, 0] = r[k, 0] - 3.0 * y[k]
    y += rp.TransferFunction([1.0], [1.0, 3.0]).simulate(u[:, 1].copy(), DT)
    ident = rp.Identifier(poles=(1, 1), dt=DT)
    ident.update_many(u, y)
    ident._now = dataclasses.replace(ident._now, findings=())
    assert any("input u1 answers to disturbances" in reason for reason in ident.assess().reasons)


def doubled_at(samples: int, seed: int, load: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Return twice as many samples of a plant whose gain from the second input doubles, or of one under a load."""
    plant = rp.TransferFunction([2.0], [1.0, 1.0]), rp.TransferFunction([0.2], [1.0, 0.4], delay=0.3)
    rng, u, since = np.random.default_rng(seed), toggling(seed, samples=2 * samples), np.arange(2 * samples) >= samples
    first, second = (g.simulate(column.copy(), 0.1) for g, column in zip(plant, u.T, strict=True))
    clean = first + second * np.where(since & (load == 0.0), 2.0, 1.0)
    clean += plant[0].simulate(np.where(since, load, 0.0), 0.1)
    return u, clean + 0.1 * rng.standard_normal(2 * samples)


@pytest.mark.slow
@every("seed", range(3), quick=1)
def test_a_plant_that_has_changed_is_learned_anew(seed: int) -> None:
    u, y = doubled_at(2000, seed)
    ident = rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1)
    ident.update_many(u, y)
    assert abs(ident._now.record_began - 2000) <= 50
    assert ident.assess().status == "trusted"
    assert ident.model.transfer_functions[1].den[-1] == pytest.approx(0.4, rel=0.2)
    (inputs, output), fitted = ident.recent, ident.fit_of_newest()
    assert len(inputs) == output.size == ident.recent_intervals.size == fitted.output.size == ident._now.length
    assert np.nanstd(output - fitted.output) < 1.1 * np.sqrt(ident.noise.residual_variance)
    assert distance(ident, np.array([1.0, 2.0, 0.4, 0.4])) < chi2_quantile(0.9999, 4)
    ident.finish()
    assert distance(ident, np.array([1.0, 2.0, 0.4, 0.4])) < chi2_quantile(0.9999, 4)


@pytest.mark.slow
@every("seed", range(3), quick=1)
def test_behind_a_load_the_record_goes_on(seed: int) -> None:
    """The offset is another one; what the samples before told of the plant stays."""
    u, y = doubled_at(2000, seed, load=0.5)
    ident = rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1)
    ident.update_many(u, y)
    assert ident._now.record_began == 0
    (load,) = ident._now.loads
    assert abs(load - 2000) <= 50
    assert ident.assess().status == "trusted"
    assert distance(ident, np.array([1.0, 2.0, 0.4, 0.2])) < chi2_quantile(0.9999, 4)


@pytest.mark.slow
def test_a_load_behind_more_samples_than_are_kept_is_learned() -> None:
    u = toggling(3, samples=18_000)
    y = noisy(3, row_of(u, FAST, SLOW))
    y[12_000:] += 1.0
    ident = begun(history=10_000)
    ident.update_many(u, y)
    assert ident._now.record_began > 0
    (load,) = ident._now.loads
    assert abs(load - 12_000) <= 50
    assert ident.assess().status == "trusted"
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
def test_a_sensor_that_is_dead_for_long_costs_no_sample() -> None:
    u = toggling(4, samples=16_000)
    y = noisy(4, row_of(u, FAST, SLOW))
    y[3_000:14_500] = np.nan
    ident = begun()
    for begin in range(0, 16_000, 500):
        ident.update_many(u[begin : begin + 500], y[begin : begin + 500])
    assert ident.samples == 16_000
    assert ident.assess().status == "trusted"
    assert distance(ident) < chi2_quantile(0.9999, TRUE.size)


@pytest.mark.slow
def test_a_change_is_followed_by_any_chunks_and_from_a_checkpoint_to_the_bit() -> None:
    u, y = doubled_at(1500, 0)
    whole = rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1)
    whole.update_many(u, y)
    assert whole._now.record_began > 0
    parts = rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1)
    parts.update_many(u[:1450], y[:1450])
    for row, output in zip(u[1450:2300], y[1450:2300], strict=True):
        parts.update(tuple(row.tolist()), float(output))
    parts = rp.Identifier.from_bytes(parts.to_bytes())
    parts.update_many(u[2300:], y[2300:])
    assert parts.to_bytes() == whole.to_bytes()


def test_a_change_since_an_estimate_was_frozen_is_named() -> None:
    """The mean of the estimate's errors before and after is nought at last."""
    u, y = doubled_at(3000, 1)
    ident = rp.Identifier(poles=(1, 1), delay=(0.0, 0.3), dt=0.1)
    ident.update_many(u[:3000], y[:3000])
    ident.freeze()
    ident.update_many(u[3000:], y[3000:])
    assert re.match(r"input u2: over the newest [\d,]+ samples its response differs", ident.assess().reasons[0])


@pytest.mark.slow
@every("seed", range(4), quick=1)
def test_a_plant_that_does_not_change_has_not_changed(seed: int) -> None:
    u, y = record(seed, 4000, pole=[0.0, 0.9][seed % 2], decibels=[10.0, 20.0][seed % 2])
    ident = begun()
    for rows in np.array_split(np.arange(4000), 8)[2:]:
        ident.update_many(u[: rows[-1] + 1][ident.samples :], y[: rows[-1] + 1][ident.samples :])
        assert ident.assess().status == "trusted"
