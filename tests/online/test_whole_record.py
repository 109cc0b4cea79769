"""The end of a record: the estimate is then what `fit` makes of it, unless the plant has changed."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.numerics.arguments import FloatArray
from support.cases import every
from support.loops import closed_loop, coloured, steps

DT = 0.02
PLANT = rp.TransferFunction([4.0], [1.0, 1.2, 4.0])
STRUCTURE = rp.Structure(poles=2)
TRUE = np.array([1.2, 4.0, 4.0])


def moved(seed: int, samples: int) -> FloatArray:
    return np.where(np.cumsum(np.random.default_rng(seed).random(samples) < 0.03) % 2 == 0, 1.0, -1.0)


def noisy(seed: int, samples: int, plant: rp.TransferFunction = PLANT) -> tuple[FloatArray, FloatArray]:
    u = moved(seed, samples)
    return u, plant.simulate(u, DT) + 0.1 * np.random.default_rng(1000 + seed).standard_normal(samples)


def learned(u: FloatArray, y: FloatArray, **settings: object) -> rp.Identifier:
    ident = rp.Identifier(STRUCTURE, DT, **settings)
    ident.update_many(u, y)
    return ident


@every("samples", [60, 700, 3000, 25_000])
def test_it_is_what_fit_gives(samples: int) -> None:
    u, y = noisy(0, samples)
    ident = learned(u, y)
    ident.finish()
    fitted = rp.fit(u, y, DT, STRUCTURE)
    assert (np.abs(ident.parameters - fitted.parameters) < 0.05 * fitted.uncertainty.std).all()
    np.testing.assert_allclose(ident.uncertainty.std, fitted.uncertainty.std, rtol=0.05)


def test_the_verdict_tests_an_earlier_estimate_on_what_it_had_not_used() -> None:
    u, y = noisy(1, 5000)
    ident = learned(u[:3000], y[:3000])
    ident.finish()
    assert ident.assess().status == "trusted"
    assert "which the estimate had not used" in ident.assess().reasons[0]
    ident.update_many(u[3000:], y[3000:])
    verdict = ident.assess()
    assert verdict.status == "trusted"
    assert "which the estimate had not used" in verdict.reasons[0]
    assert (np.abs(ident.parameters - TRUE) < 5.0 * ident.uncertainty.std).all()


def test_a_short_record_is_judged_in_sample() -> None:
    ident = learned(*noisy(7, 300))
    ident.finish()
    verdict = ident.assess()
    assert verdict.status == "trusted"
    assert "in sample" in verdict.reasons[0]


def test_a_step_is_judged_by_what_it_showed_before_the_rest() -> None:
    u = np.where(np.arange(700) < 60, 0.0, 1.0)
    y = PLANT.simulate(u, DT) + 0.01 * np.random.default_rng(0).standard_normal(700)
    ident = learned(u, y, startup=70)
    ident.finish()
    verdict = ident.assess()
    assert (verdict.status, verdict.excited) == ("trusted", False)


@pytest.mark.slow
def test_a_load_in_start_up_is_found() -> None:
    u = np.random.default_rng(3).choice([-1.0, 1.0], 80).repeat(10)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1) + 3.0 * (np.arange(800) >= 400)
    y += 0.1 * np.random.default_rng(4).standard_normal(800)
    ident = rp.Identifier(poles=1, dt=0.1, startup=1000)
    ident.update_many(u, y)
    ident.finish()
    assert ident.loads == (400,)
    ident.update_many(u, y + 3.0)  # the samples after it are learned from the same state
    assert ident.assess().status == "trusted"
    assert ident.parameters == pytest.approx([0.5, 2.0], rel=0.05)


@every(("at", "burst"), [(3000, 0.0), (5000, 3.0)], quick=1)
def test_a_plant_that_changed_keeps_the_model_since(at: int, burst: float) -> None:
    """Also after a burst of noise, which is no usual noise when it is over, and hides the change from `fit`."""
    u = moved(2, 6000)
    y = PLANT.simulate(u, DT)
    y[at:] = rp.TransferFunction([8.0], [1.0, 1.2, 4.0]).simulate(u, DT)[at:]
    spread, rng = float(y.std()), np.random.default_rng(0)
    y += 0.05 * rng.standard_normal(u.size)
    y[at - 300 : at - 250] += burst * spread * rng.standard_normal(50)
    ident = learned(u, y)
    ident.finish()
    assert ident.parameters == pytest.approx([1.2, 4.0, 8.0], rel=0.05)


def test_outputs_of_a_stuck_sensor_stay_bridged() -> None:
    u, y = noisy(3, 4000)
    y[2000:2150] = y[2000]
    ident = learned(u, y)
    ident.finish()
    assert (np.abs(ident.parameters - TRUE) < 5.0 * ident.uncertainty.std).all()


@pytest.mark.slow
@every("seed", range(4))
def test_nonlinear_plants_do_not_end_behind_fit(seed: int) -> None:
    """Of a plant that saturates, alarms leave an estimate of the newest samples; the whole record tells more."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-1.0, 1.0, 40), 30)
    y = PLANT.simulate(np.tanh(3.0 * u), DT) + 0.01 * random.standard_normal(u.size)
    ident = learned(u, y, startup=200)
    ident.finish()
    fitted = rp.fit(u, y, DT, STRUCTURE)
    fits = [rp.verdict.simulate(model, u, y, DT).fit for model in (ident.transfer_function, fitted.transfer_function)]
    assert fits[0] > fits[1] - 1.0


@pytest.mark.parametrize(
    ("samples", "settings"),
    [(30_500, {}), (3000, {"optimizer": rp.RecursiveLeastSquares(0.999)}), (3000, {"optimizer": "adam"})],
    ids=["long", "forgets", "gradient"],
)
def test_where_not_every_sample_is_kept_and_counts_nothing_changes(samples: int, settings: dict[str, object]) -> None:
    ident = learned(*noisy(4, samples), **settings)
    before = ident.to_bytes()
    ident.finish()
    assert ident.to_bytes() == before


def test_a_frozen_estimate_stays() -> None:
    ident = learned(*noisy(5, 2000))
    ident.freeze()
    before = ident.parameters
    ident.finish()
    np.testing.assert_array_equal(ident.parameters, before)


SLOW, DT_SLOW = rp.TransferFunction([2.0], [1.0, 0.5]), 0.1


def changed(seed: int, after: rp.TransferFunction, at: int, samples: int = 1500) -> tuple[FloatArray, FloatArray]:
    """A plant that is another one from a sample on, under noise of 10 dB; what the old one holds dies out."""
    rng, since = np.random.default_rng(seed), np.arange(samples) >= at
    u = rng.choice([-1.0, 1.0], samples // 8 + 1).repeat(8)[:samples]
    y = SLOW.simulate(np.where(since, 0.0, u), DT_SLOW) + after.simulate(np.where(since, u, 0.0), DT_SLOW)
    return u, y + 0.3 * SLOW.simulate(u, DT_SLOW).std() * rng.standard_normal(samples)


def finished(u: FloatArray, y: FloatArray) -> rp.Identifier:
    ident = rp.Identifier(poles=1, dt=DT_SLOW)
    ident.update_many(u, y)
    ident.finish()
    return ident


@pytest.mark.slow
@every("seed", range(6), quick=2)
def test_what_is_known_since_a_change_is_no_mixture_of_two_plants(seed: int) -> None:
    ident = finished(*changed(seed, rp.TransferFunction([0.8], [1.0, 0.5]), 990))
    assert ident.parameters == pytest.approx([0.5, 0.8], rel=0.15)


@pytest.mark.slow
@every("seed", range(6), quick=1)
def test_a_mixture_of_two_plants_is_trusted_by_neither_fit_nor_finish(seed: int) -> None:
    u, y = changed(seed, rp.TransferFunction([1.0], [1.0, 2.0]), 908)
    ident, fitted = finished(u, y), rp.fit(u, y, DT_SLOW, poles=1)
    assert fitted.verdict.status == "inconsistent"
    if ident.parameters == pytest.approx(fitted.parameters, rel=0.01):
        assert ident.assess().status == "inconsistent"
    else:
        assert ident.assess().status != "trusted" or ident.parameters == pytest.approx([2.0, 1.0], rel=0.3)


def changed_under_control(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """2/(s + 1) under a PI controller, its gain 1.2 in the last two fifths: input, output and reference."""
    r = steps(seed, 4000, 40)
    gain = np.where(np.arange(r.size) < 2400, 1.0, 0.6)
    noise = 0.03 * coloured(seed, r.size, 0.8)
    return *closed_loop([2.0], [1.0, 1.0], (0.4, 0.3), 0.05, r, np.zeros(r.size), noise, gain), r


@pytest.mark.slow
@every("seed", range(4), quick=1)
def test_a_plant_that_changed_under_a_controller_with_a_reference_is_no_mixture(seed: int) -> None:
    u, y, r = changed_under_control(seed)
    ident = rp.Identifier(poles=1, dt=0.05)
    ident.update_many(u, y, r=r)
    ident.finish()
    assert ident.parameters == pytest.approx([1.0, 1.2], rel=0.1)
    verdict = rp.fit(u, y, 0.05, poles=1, reference=r).verdict
    assert verdict.status == "inconsistent"
    assert "the plant seems to have changed" in verdict.reasons[0]
