"""The noise model of the recursion: what it finds, that it follows the record, and what breaks its past."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import replant as rp
from support.loops import loaded_loop

DT, SAMPLES = 0.05, 3000
PLANT = rp.TransferFunction([2.0], [1.0, 4.0, 3.0])


def record_of(colour: list[float], seed: int, samples: int = SAMPLES, size: float = 0.1) -> tuple[np.ndarray, ...]:
    """A random binary input held for eight samples, and an output with an innovation of this standard deviation."""
    generator = np.random.default_rng(seed)
    u = np.repeat(generator.choice([-1.0, 1.0], samples // 8 + 1), 8)[:samples]
    noise = lfilter([1.0], colour, size * generator.standard_normal(samples + 500))[500:]
    return u, PLANT.simulate(u, DT) + noise


def identified(u: np.ndarray, y: np.ndarray, **more: np.ndarray) -> rp.Identifier:
    ident = rp.Identifier(rp.Structure(poles=2), DT)
    ident.update_many(u, y, **more)
    return ident


@pytest.mark.parametrize("colour", [[1.0], [1.0, -0.9], [1.0, -1.6, 0.9]], ids=repr)
def test_it_is_the_noise_of_the_record(colour: list[float]) -> None:
    """Deviations: of a coefficient below 1/sqrt(K), of the variance sqrt(2/K)."""
    noise = identified(*record_of(colour, 1)).noise
    assert noise is not None
    assert noise.order >= len(colour) - 1
    found = np.zeros(5)
    found[: noise.coefficients.size] = noise.coefficients
    np.testing.assert_allclose(found[: len(colour)], colour, atol=5.0 / np.sqrt(SAMPLES))
    assert noise.variance == pytest.approx(0.01, rel=5.0 * np.sqrt(2.0 / SAMPLES))


def test_it_has_the_spectrum_of_a_load_seen_through_the_plant_and_of_the_sensor() -> None:
    """Within a factor of two up to twice the bandwidth, over which its power falls by more than two decades.

    An autoregression of order four is not that noise: one of its exact covariance is off by factors of 0.63 to 1.35.
    """
    dt, load, sensor = 0.1, 0.15, 0.01
    u, y, r = loaded_loop(4000, load=load, sensor=sensor)
    ident = rp.Identifier(rp.Structure(poles=2), dt)
    ident.update_many(u, y, r=r)
    assert ident.noise is not None
    omega = np.geomspace(0.1, 2.0, 30)
    z = np.exp(1j * omega * dt)
    numerator, denominator, _ = cont2discrete(([1.0], [1.0, 1.4, 1.0]), dt, "zoh")
    disturbance = load / (1.0 - 0.95 / z) * np.polyval(numerator[0], z) / np.polyval(denominator, z)
    true = dt * (np.abs(disturbance) ** 2 + sensor**2)
    assert true[0] > 100.0 * true[-1]
    assert (np.abs(np.log(ident.noise.spectrum(omega) / true)) < np.log(2.0)).all()


def test_between_two_solutions_the_recursion_is_where_the_next_solution_will_be() -> None:
    """Of a loop under a smooth load, whose residual is a thousand times its innovation: within two deviations."""
    u, y, r = loaded_loop(3990)
    ident = rp.Identifier(rp.Structure(poles=2), 0.1)
    ident.update_many(u, y, r=r)
    std = np.sqrt(np.diag(ident.covariance))
    fitted = rp.fit(u, y, 0.1, rp.Structure(poles=2), reference=r)
    assert (np.abs(ident.parameters - fitted.parameters) < 2.0 * std).all()


def test_rejected_samples_and_gaps_break_the_past_and_nothing_else() -> None:
    """Ten outliers and a gap of thirty samples: the noise is the same within its deviations, and so is the estimate."""
    u, y = record_of([1.0, -0.9], 3, 4000)
    t = DT * np.arange(4000)
    y[900:3900:300] += 20.0
    t[2500:] += 30 * DT
    ident = identified(u, y, t=t)
    noise = ident.noise
    assert noise is not None
    assert ident.rejected["outlier"] == 10
    assert noise.coefficients[1] == pytest.approx(-0.9, abs=0.1)
    truth = np.array([4.0, 3.0, 2.0])
    assert (np.abs(ident.parameters - truth) < 4.0 * np.sqrt(np.diag(ident.covariance))).all()


def test_a_clock_that_always_jitters_keeps_the_colour_of_the_noise() -> None:
    """Intervals off by up to .4 of a sampling time: the residuals beside each other are the same ones."""
    generator = np.random.default_rng(5)
    steps = np.cumsum(generator.choice([6, 7, 8, 12, 13, 14], SAMPLES))  # in tenths of a sampling time
    t, u = 0.1 * DT * steps, np.repeat(generator.choice([-1.0, 1.0], SAMPLES // 8 + 1), 8)[:SAMPLES]
    held = u[np.clip(np.searchsorted(steps, np.arange(steps[-1] + 1), side="right") - 1, 0, None)]
    y = PLANT.simulate(held, 0.1 * DT)[steps] + lfilter([1.0], [1.0, -0.9], 0.05 * generator.standard_normal(SAMPLES))
    ident = identified(u, y, t=t)
    assert ident.noise is not None
    assert ident.noise.coefficients[1] == pytest.approx(-0.9, abs=0.1)
    assert (np.abs(ident.parameters - [4.0, 3.0, 2.0]) < 5.0 * np.sqrt(np.diag(ident.covariance))).all()


def test_a_checkpoint_keeps_it_to_the_bit() -> None:
    u, y = record_of([1.0, -1.6, 0.9], 6)
    whole = identified(u, y)
    half = identified(u[:1700], y[:1700])
    restored = rp.Identifier.from_bytes(half.to_bytes())
    restored.update_many(u[1700:], y[1700:])
    assert restored.to_bytes() == whole.to_bytes()
    assert whole.noise is not None
    assert whole.noise.order >= 2


def test_what_has_no_noise_model_says_so() -> None:
    u, y = record_of([1.0], 7, 1000)
    starting = rp.Identifier(rp.Structure(poles=2), DT)
    assert starting.noise is None
    fixed = rp.Identifier(rp.Structure(poles=2), DT, filter=rp.StateVariableFilter(3.0), optimizer="adam")
    fixed.update_many(u, y)
    assert fixed.noise is None
