"""A dead time, and a record that begins while the plant runs: what acted before the record is unknown, and not zero."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.arguments import FloatArray
from replant.assessment import simulate

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


@pytest.mark.parametrize("before", [0.0, -1.0, 100.0])
@pytest.mark.parametrize("level", [0.0, 50.0])
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


@pytest.mark.parametrize("samples", [5, 60, 63])
def test_a_record_no_longer_than_the_dead_time_gives_no_model(samples: int) -> None:
    u, y = running(0.0)
    with pytest.raises(rp.ReplantError):
        rp.fit(u[:samples], y[:samples], DT, STRUCTURE, method="srivc")
    ident = rp.Identifier(STRUCTURE, DT)
    ident.update_many(u[:samples], y[:samples])
    assert not ident.has_model


def test_a_first_difference_is_not_taken_for_the_plant() -> None:
    """The estimate of a start-up continues without a jump: filters and first model begin at the same sample."""
    u, y = running(100.0)
    trace = rp.Identifier(STRUCTURE, DT).update_many(u, y)
    moved = np.abs(np.diff(trace.parameters[499:], axis=0)).max(axis=0)
    assert (moved < 0.02 * TRUE).all()
