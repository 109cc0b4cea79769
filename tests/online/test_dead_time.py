"""A dead time, and a record that begins while the plant runs: what acted before the record is unknown, and not zero."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.simulation.model_run import prediction_error
from replant.numerics.arguments import FloatArray
from replant.verdict import simulate
from support.cases import every

DT = 0.05
PLANT = rp.TransferFunction([2.0], [1.0, 0.5], delay=3.0)
STRUCTURE = rp.Structure(1, delay=3.0)
TRUE = np.array([0.5, 2.0])
NOISE = 0.05


def running(before: float, samples: int = 1200, seed: int = 0, delay: float = 3.0) -> tuple[FloatArray, FloatArray]:
    """A record of a plant at another working point until it begins: u was ``before`` for a long time, then moved."""
    random = np.random.default_rng(seed)
    u = np.where(np.cumsum(random.random(samples + 100) < 0.02) % 2 == 0, 1.0, -1.0)
    plant = rp.TransferFunction(PLANT.num, PLANT.den, delay)
    y = plant.simulate(np.concatenate([np.full(400, before), u]) - before, DT)[400:]
    return u[100:], (y + NOISE * random.standard_normal(y.size))[100:]


@every("before", [0.0, -1.0, 100.0])
@every("level", [0.0, 50.0])
def test_an_estimate_does_not_depend_on_what_acted_before(before: float, level: float) -> None:
    """At the truth within five standard deviations, which the free response of a far state makes small."""
    u, y = running(before)
    y = y + 4.0 * level
    fitted = rp.fit(u + level, y, DT, STRUCTURE)
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u + level, y)
    for parameters, std in (
        (fitted.parameters, fitted.uncertainty.std),
        (ident.parameters, ident.uncertainty.std),
    ):
        assert (np.abs(parameters - TRUE) < 5.0 * std).all()
        assert (std < 0.02 * TRUE).all()
    assert ident.assess().status == "trusted"


@pytest.mark.parametrize("delay", [3.0, 2.98])
def test_the_simulated_fit_does_not_depend_on_the_working_point(delay: float) -> None:
    """Of the plant itself nothing but noise is left, whatever number stands for its working point."""
    u, y = running(-1.0, delay=delay)
    plant = rp.TransferFunction(PLANT.num, PLANT.den, delay)
    fits = [simulate(plant, u + level, y, DT).fit for level in (0.0, 10.0, -500.0)]
    assert np.ptp(fits) < 1e-6
    known = y[60:]
    assert fits[0] == pytest.approx(100.0 * (1.0 - NOISE / known.std()), abs=0.2)
    stamps = simulate(plant, u, y, DT, t=DT * np.arange(u.size))
    assert stamps.fit == pytest.approx(fits[0], abs=1e-6)


def test_the_same_on_a_clock_with_jitter() -> None:
    random = np.random.default_rng(1)
    fine = 0.005
    u = np.where(np.cumsum(random.random(1400) < 0.02) % 2 == 0, 1.0, -1.0)
    steps = np.concatenate([[0], np.cumsum(random.integers(8, 13, 1399))])  # 40 to 60 ms
    held = np.repeat(u, np.diff(steps, append=steps[-1] + 10))
    y = PLANT.simulate(held + 20.0, fine)[steps] + NOISE * random.standard_normal(1400)
    u, y, t = u[200:], y[200:], fine * steps[200:]
    fitted = rp.fit(u, y, DT, STRUCTURE, t=t)
    assert (np.abs(fitted.parameters - TRUE) < 5.0 * fitted.uncertainty.std).all()
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y, t)
    assert (np.abs(ident.parameters - TRUE) < 5.0 * ident.uncertainty.std).all()


def test_after_a_gap_nothing_is_learned_until_the_input_is_known() -> None:
    """Inputs of the gap act for a dead time after it; without noise they would be the only error."""
    random = np.random.default_rng(2)
    u = np.where(np.cumsum(random.random(4000) < 0.02) % 2 == 0, 1.0, -1.0)
    y = PLANT.simulate(u, DT)
    t = DT * np.arange(4000)
    kept = (np.arange(4000) < 2000) | (np.arange(4000) >= 2200)
    ident = rp.Identifier(STRUCTURE, DT)
    trace = ident.update_many(u[kept], y[kept], t[kept])
    assert ident.rejected["not finite"] == 0
    np.testing.assert_allclose(trace.parameters[2000:], np.tile(TRUE, (1800, 1)), rtol=1e-7)
    np.testing.assert_array_equal(trace.parameters[2000:2055], np.tile(trace.parameters[1999], (55, 1)))


def test_after_a_gap_no_alarm_comes_of_outputs_that_nobody_can_know() -> None:
    random = np.random.default_rng(3)
    u = np.where(np.cumsum(random.random(6000) < 0.02) % 2 == 0, 1.0, -1.0)
    y = PLANT.simulate(u, DT) + 0.3 * random.standard_normal(6000)
    t = DT * np.arange(6000)
    kept = (np.arange(6000) < 3000) | (np.arange(6000) >= 3045)
    u, y, t = u[kept], y[kept], t[kept]
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[:3000], y[:3000], t[:3000])
    assert ident.assess().status == "trusted"
    for k in range(3000, 3800, 20):
        ident.update_many(u[k : k + 20], y[k : k + 20], t[k : k + 20])
        verdict = ident.assess()
        assert verdict.status != "inconsistent", verdict.reasons
        rests = verdict.reasons[0].startswith(("the input is", "the input has", "the input hardly"))
        assert verdict.status != "not excited" or rests
    assert verdict.status == "trusted"


def test_missing_outputs_are_bridged_while_the_input_is_not_known() -> None:
    random = np.random.default_rng(4)
    u = np.where(np.cumsum(random.random(4000) < 0.02) % 2 == 0, 1.0, -1.0)
    y = PLANT.simulate(u, DT) + NOISE * random.standard_normal(4000)
    t = DT * np.arange(4000) + np.where(np.arange(4000) < 2000, 0.0, 200 * DT)
    y[2010:2018] = np.nan
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u, y, t)
    assert ident.rejected["no output"] == 8
    assert np.isfinite(ident.recent).all()
    assert ident.bridged.sum() == 8


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_the_verdict_does_not_count_outputs_that_nobody_can_know(share: float) -> None:
    """Noise as large as the output shows: the fit is that of the outputs that answer to known inputs."""
    random = np.random.default_rng(5)
    delay = share * 1500 * DT
    plant, structure = rp.TransferFunction(PLANT.num, PLANT.den, delay), rp.Structure(1, delay=delay)
    u = np.where(np.cumsum(random.random(1500) < 0.02) % 2 == 0, 1.0, -1.0)
    y = plant.simulate(u, DT) + random.standard_normal(1500)
    fitted = rp.fit(u, y, DT, structure)
    ident = rp.Identifier(structure, DT)
    ident.update_many(u, y)
    ident.finish()
    assert rp.verdict.simulate(fitted.transfer_function, u, y, DT).fit == pytest.approx(fitted.simulation.fit)
    if ident.assess().held_out == 0:
        assert ident.assess().fit == pytest.approx(fitted.simulation.fit, abs=1.0)
    assert ident.assess().status != "inconsistent"


@pytest.mark.parametrize("samples", [5, 60, 63])
def test_a_record_no_longer_than_the_dead_time_gives_no_model(samples: int) -> None:
    u, y = running(0.0)
    with pytest.raises(rp.ReplantError, match="the dead time of 3 s" if samples < 62 else "srivc finds no model"):
        rp.fit(u[:samples], y[:samples], DT, STRUCTURE, method="srivc")
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[:samples], y[:samples])
    assert not ident.has_model


@every("hold", ["zoh", "foh"])
@every("delay", [0.05, 0.3, 0.32, 0.38])
def test_the_first_sample_that_answers_to_known_inputs_is_exact(hold: str, delay: float) -> None:
    """As many zeros as poles: the output holds the delayed input of the same instant."""
    random = np.random.default_rng(6)
    plant = rp.TransferFunction([1.0, 2.0, 3.0], [1.0, 1.2, 4.0], delay)
    u = random.uniform(-1.0, 1.0, 320)
    y = plant.simulate(u, 0.1, input_hold=hold)[20:]
    record = Record(u[20:], y, np.array([0.1]), hold)
    structure = rp.Structure(2, 2, delay=delay, feedthrough=True)
    error = prediction_error(structure, np.concatenate([plant.den[1:], plant.num]), record, 0.1)
    np.testing.assert_allclose(error, 0.0, atol=1e-13)


def test_a_first_difference_is_not_taken_for_the_plant() -> None:
    """The estimate of a start-up continues without a jump: filters and first model begin at the same sample."""
    u, y = running(100.0)
    trace = rp.Identifier(STRUCTURE, DT).update_many(u, y)
    moved = np.abs(np.diff(trace.parameters[499:], axis=0)).max(axis=0)
    assert (moved < 0.02 * TRUE).all()
