"""Poles that a record does not tell: the coefficients that hold them are said to be unknown, the others are not."""

import numpy as np
import pytest

import replant as rp
from replant.signals import prbs


def record(plant: rp.TransferFunction, seed: int, noise: float) -> tuple[np.ndarray, np.ndarray]:
    u = prbs(1500, bits=9, hold=25, seed=seed + 1)
    clean = plant.simulate(u, 0.1)
    return u, clean + noise * clean.std() * np.random.default_rng(seed).standard_normal(u.size)


def plant_of(*poles: float) -> rp.TransferFunction:
    a = np.poly(poles).real
    return rp.TransferFunction([a[-1]], a)


@pytest.mark.slow
def test_coefficients_that_hold_poles_which_noise_hides_are_within_their_intervals() -> None:
    plant = plant_of(-0.4, -7.0, -8.0, -9.0)
    truth, off = np.append(plant.den[1:], plant.num), []
    for seed in range(6):
        found = rp.fit(*record(plant, seed, 0.5), 0.1, poles=4)
        assert found.uncertainty is not None
        off.append(np.abs((found.parameters - truth) / found.uncertainty.std).max())
    assert max(off) < 3.0


def test_what_the_model_does_is_known_though_its_coefficients_are_not() -> None:
    found = rp.fit(*record(plant_of(-0.4, -7.0, -8.0, -9.0), 0, 0.5), 0.1, poles=4)
    assert found.uncertainty is not None
    assert np.isinf(found.uncertainty.std).all()
    assert found.uncertainty.response([0.4])[0][0] < 0.1
    assert found.uncertainty.dc_gain_std < 0.1


@pytest.mark.parametrize("poles", [(-0.4, -2.0), (-0.3, -1.0, -3.0)])
def test_poles_that_are_told_keep_their_deviations(poles: tuple[float, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = record(plant_of(*poles), 3, 0.01)
    found = rp.fit(u, y, 0.1, poles=len(poles))
    monkeypatch.setattr("replant.estimation.solver.solve.with_untold", lambda structure, record, found: found)
    before = rp.fit(u, y, 0.1, poles=len(poles))
    np.testing.assert_array_equal(found.covariance, before.covariance)
    assert found.uncertainty is not None
    assert (found.uncertainty.std < 0.2 * np.abs(found.parameters)).all()
