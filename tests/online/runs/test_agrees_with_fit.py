"""A pass over a whole record and `fit` answer alike: what is stated of a model, and why it is trusted or not."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.estimation.simulation.fitted_run import FittedRun, simulate
from replant.verdict import Assessment, Verdict
from support.cases import every

PLANT, DT = rp.TransferFunction([0.1], [1.0, 0.1], delay=0.3), 0.05
LOADS = (1500, 2600, 3700)


def loaded(seed: int, samples: int = 4500) -> tuple[np.ndarray, np.ndarray]:
    """An input that moves each 5 s, and the output with three loads of alternate sign in noise."""
    rng = np.random.default_rng([seed, 41])
    u = rng.choice([-1.0, 1.0], samples // 100).repeat(100)
    clean = PLANT.simulate(u, DT)
    acts = sum((-1.0) ** k * (np.arange(samples) >= begin) for k, begin in enumerate(LOADS))
    return u, clean + clean.std() * (0.7 * acts + 0.32 * rng.standard_normal(samples))


def finished(u: np.ndarray, y: np.ndarray, dt: float, **structure: Any) -> rp.Identifier:
    ident = rp.Identifier(dt=dt, **structure)
    ident.update_many(u, y)
    ident.finish()
    return ident


@pytest.mark.slow
def test_behind_loads_one_fit_is_stated_by_all() -> None:
    u, y = loaded(0)
    fitted, passed = rp.fit(u, y, DT, poles=1, delay=0.3), rp.run(u, y, DT, poles=1, delay=0.3)
    ident = finished(u, y, DT, poles=1, delay=0.3)
    assert fitted.loads.size == len(LOADS)
    np.testing.assert_array_equal(passed.loads, fitted.loads)
    np.testing.assert_array_equal(ident.loads, fitted.loads)
    stated = passed.simulation.fit, passed.model.simulated_fit, ident.model.simulated_fit
    assert stated == pytest.approx([fitted.simulation.fit] * 3, abs=0.01)
    assert passed.one_step == pytest.approx(fitted.one_step, abs=0.5)
    # the model goes on from the load that acts at the end
    levels = [float(each.simulate([0.0])[0]) for each in (fitted.model, passed.model, ident.model)]
    assert levels[1:] == pytest.approx([levels[0]] * 2, abs=0.02)
    reason = next(each for each in fitted.verdict.reasons if each.startswith("another load acts since"))
    for verdict in (passed.verdict, ident.assess()):
        assert verdict.status == fitted.verdict.status == "trusted"
        assert reason in verdict.reasons


@pytest.mark.slow
def test_loads_are_forgotten_where_samples_follow_and_kept_by_a_checkpoint() -> None:
    u, y = loaded(0)
    ident = finished(u, y, DT, poles=1, delay=0.3)
    restored = rp.Identifier.from_bytes(ident.to_bytes())
    assert restored.loads == ident.loads
    assert restored.assess().reasons == ident.assess().reasons
    ident.update(1.0, float(y[-1]))
    assert ident.loads == ()


@pytest.mark.slow
def test_a_load_in_the_place_of_a_bad_output_lies_at_the_next_one() -> None:
    u, y = loaded(0)
    at = rp.fit(u, y, DT, poles=1, delay=0.3).loads.tolist()
    y[at[1]] = np.nan
    assert np.abs(np.array(finished(u, y, DT, poles=1, delay=0.3).loads) - at).max() <= 20


def test_a_run_begins_anew_where_it_is_told_to() -> None:
    rng = np.random.default_rng(5)
    u, y = rng.choice([-1.0, 1.0], 40).repeat(10), rng.standard_normal(400)
    whole = FittedRun(PLANT, DT, begins=(130, 250)).take(u, y)[0]
    parts = [FittedRun(PLANT, DT).take(u[rows], y[rows])[0] for rows in (slice(130), slice(130, 250), slice(250, None))]
    np.testing.assert_array_equal(whole, np.concatenate(parts))
    run = simulate(PLANT, u, y, DT, begins=(130, 250))
    assert run.fit > simulate(PLANT, u, y, DT).fit
    assert run.offset == simulate(PLANT, u[250:], y[250:], DT).offset


def amounts(verdict: Verdict | Assessment) -> list[str]:
    """What the verdict says the uncertainty amounts to."""
    return re.findall(r"amounts to ([\w. ]+) %", " ".join(verdict.reasons))


@every("seed", [13, 4, 8], quick=1)
def test_an_uncertainty_is_told_by_one_figure(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], 50).repeat(50)
    y = rp.TransferFunction([2.0], [1.0, 2.2, 1.0]).simulate(u, 0.1)
    y = y + y.std() * rng.choice([0.1, 0.2, 0.3]) * lfilter([1.0], [1.0, -0.8], rng.standard_normal(u.size))
    fitted, verdict = rp.fit(u, y, 0.1, poles=2, zeros=1), finished(u, y, 0.1, poles=2, zeros=1).assess()
    assert "which the estimate had not used" in verdict.reasons[0]
    assert amounts(verdict) == amounts(fitted.verdict) != []
    assert verdict.status == fitted.verdict.status


def test_a_residual_that_varies_slowly_is_named_by_both() -> None:
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], 20).repeat(100)
    clean = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, 0.1)
    y = 6.0 * np.tanh(clean / 6.0) + 0.002 * rng.standard_normal(u.size)  # slightly nonlinear
    fitted, verdict = rp.fit(u, y, 0.1, poles=1), finished(u, y, 0.1, poles=1).assess()
    said = ["because the residual varies slowly" in " ".join(each.reasons) for each in (fitted.verdict, verdict)]
    assert said == [True, True]
