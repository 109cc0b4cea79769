"""The factored covariance: dense formulas, positive definiteness for ever, caps, and a noise that is tracked."""

from __future__ import annotations

import numpy as np
import pytest

import replant as rp
from replant.kernels.optimizers.covariance import (
    kalman_tracking,
    measurement_update,
    recursive_least_squares,
    time_update,
)
from replant.numerics.linear_algebra import compose
from support.cases import every

ORDERS = [1, 2, 3, 5, 8, 13]


def observe(U, D, zeta, noise, projected, gain):
    return measurement_update(D.size, U, D, zeta, noise, projected, gain)


def walk(U, D, increase, work):
    time_update(D.size, U, D, increase, work)


def random_factors(generator: np.random.Generator, size: int, spread: float = 2.0) -> tuple[np.ndarray, np.ndarray]:
    U = np.eye(size) + np.triu(generator.standard_normal((size, size)), 1)
    return U, 10 ** generator.uniform(-spread, spread, size)


@every("size", ORDERS)
def test_an_observation_changes_the_covariance_as_the_formula_says(size: int) -> None:
    generator = np.random.default_rng(size)
    for _ in range(20):
        U, D = random_factors(generator, size)
        P, zeta, noise = compose(U, D), generator.standard_normal(size), 10 ** generator.uniform(-2, 2)
        flat, diagonal, gain = U.copy(), D.copy(), np.empty(size)
        alpha = observe(flat, diagonal, zeta, noise, np.empty(size), gain)
        expected = noise + zeta @ P @ zeta
        assert alpha == pytest.approx(expected, rel=1e-11)
        scale = np.abs(P).max()
        np.testing.assert_allclose(gain, P @ zeta, atol=1e-11 * scale * np.abs(zeta).sum())
        updated = compose(flat, diagonal)
        np.testing.assert_allclose(updated, P - np.outer(P @ zeta, P @ zeta) / expected, atol=1e-11 * scale)
        assert (diagonal > 0).all()
        assert_unit_upper(flat)


@every("size", ORDERS)
def test_time_adds_its_noise(size: int) -> None:
    generator = np.random.default_rng(size)
    for _ in range(20):
        U, D = random_factors(generator, size)
        increase = 10 ** generator.uniform(-3, 2, size) * (generator.random(size) < 0.7)
        flat, diagonal = U.copy(), D.copy()
        walk(flat, diagonal, increase, np.empty(2 * size * size + 2 * size))
        expected = compose(U, D) + np.diag(increase)
        updated = compose(flat, diagonal)
        np.testing.assert_allclose(updated, expected, atol=1e-11 * np.abs(expected).max())
        assert (diagonal > 0).all()
        assert_unit_upper(flat)


def assert_unit_upper(U: np.ndarray) -> None:
    np.testing.assert_array_equal(np.tril(U), np.eye(U.shape[0]))


def observe_many(U, D, directions, noise, projected, gain, count):
    """Observe along the directions in turn."""
    for k in range(count):
        observe(U, D, directions[k % directions.shape[0]], noise, projected, gain)


def observe_and_walk(U, D, directions, noise, increase, work, projected, gain, count):
    for k in range(count):
        walk(U, D, increase, work)
        observe(U, D, directions[k % directions.shape[0]], noise, projected, gain)


def hardly_different_directions(size: int) -> np.ndarray:
    """Observations that nearly coincide and lie twelve orders of magnitude apart in size: hopeless in dense form."""
    generator = np.random.default_rng(size)
    common = generator.standard_normal(size)
    directions = common + 1e-7 * generator.standard_normal((97, size))
    return directions * 10.0 ** np.linspace(-6, 6, size)


@every("size", [2, 9], quick=1)
def test_after_1e5_ill_conditioned_updates_it_is_positive_definite(size: int) -> None:
    """The largest eigenvalue falls, no entry of D leaves the positive numbers, and the product is symmetric.

    The dense formula P - K zeta' P loses positive definiteness within a few updates of this stream; that it does is
    asserted too, so that the stream is known to be hard.
    """
    directions = hardly_different_directions(size)
    U, D = np.eye(size), np.full(size, 1e6)
    observe_many(U, D, directions, 1e-6, np.empty(size), np.empty(size), 100_000)
    assert np.isfinite(U).all()
    assert (D > 0).all()
    assert_unit_upper(U)
    covariance = compose(U, D)
    assert (np.diag(covariance) > 0).all()
    assert np.linalg.eigvalsh(scaled_to_ones(covariance)).min() > -1e-13
    assert (np.diag(covariance) <= 1e6 * (1 + 1e-9)).all()
    dense, broken = 1e6 * np.eye(size), False
    for zeta in directions:
        dense = dense - np.outer(dense @ zeta, zeta @ dense) / (1e-6 + zeta @ dense @ zeta)
        broken = broken or (np.diag(dense) <= 0).any() or np.linalg.eigvalsh(scaled_to_ones(dense)).min() < -1e-10
    assert broken


def scaled_to_ones(covariance: np.ndarray) -> np.ndarray:
    std = np.sqrt(np.diag(covariance))
    return covariance / np.outer(std, std)


@every("size", [2, 5, 9], quick=1)
def test_walking_and_observing_settles_on_the_riccati_equation(size: int) -> None:
    """After 3,000 steps P is the stationary one: another turn of the directions leaves it as it is."""
    generator = np.random.default_rng(size)
    directions, increase = generator.standard_normal((3 * size, size)), 10 ** generator.uniform(-3, -1, size)
    U, D = np.eye(size), np.full(size, 1e6)
    arguments = (increase, np.empty(2 * size * size + 2 * size), np.empty(size), np.empty(size))
    observe_and_walk(U, D, directions, 0.5, *arguments, 3000 - 3000 % (3 * size))
    before = compose(U, D)
    observe_and_walk(U, D, directions, 0.5, *arguments, 30 * size)
    after = compose(U, D)
    np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-12 * np.abs(before).max())
    assert np.linalg.eigvalsh(after).min() > 0
    dense = np.eye(size)
    for k in range(3000 - 3000 % (3 * size)):
        zeta = directions[k % (3 * size)]
        dense = dense + np.diag(increase)
        rest = np.eye(size) - np.outer(dense @ zeta, zeta) / (0.5 + zeta @ dense @ zeta)
        gain = dense @ zeta / (0.5 + zeta @ dense @ zeta)
        dense = rest @ dense @ rest.T + 0.5 * np.outer(gain, gain)
    np.testing.assert_allclose(after, dense, rtol=1e-6, atol=1e-6 * np.abs(dense).max())


# --- the optimizers


def learn(kernel_of: object, optimizer: object, rows: np.ndarray, P: int, zeta: bool, *more: float) -> tuple:
    theta, memory, settings = np.zeros(P), optimizer.memory(P), optimizer.settings(0.1, np.ones(P))
    for row in rows:
        kernel_of(theta, memory, settings, row[None, :], np.zeros(1, np.int64), 1, P + 2 if zeta else 0, *more)
    return theta, memory


def random_rows(seed: int, P: int, count: int, noise: float) -> np.ndarray:
    """phi, target, 1, zeta: phi is zeta and noise that also enters the target."""
    generator = np.random.default_rng(seed)
    zeta, error = generator.standard_normal((count, P)), noise * generator.standard_normal(count)
    phi = zeta + error[:, None]
    target = phi @ np.arange(1.0, P + 1.0) + error
    return np.column_stack([phi, target, np.ones(count), zeta])


@pytest.mark.parametrize("size", [1, 3, 6])
def test_without_forgetting_it_is_the_least_squares_solution(size: int) -> None:
    """With the initial covariance as a ridge of its inverse; P is (sum phi phi' + ridge)^-1."""
    rows = random_rows(size, size, 500, 0.3)
    phi, target = rows[:, :size], rows[:, size]
    theta, memory = learn(
        recursive_least_squares, rp.RecursiveLeastSquares(initial_covariance=100.0), rows, size, False
    )
    information = phi.T @ phi + np.eye(size) / 100.0
    np.testing.assert_allclose(theta, np.linalg.solve(information, phi.T @ target), rtol=1e-10)
    P = compose(memory[: size * size].reshape(size, size), memory[size * size : size * size + size])
    np.testing.assert_allclose(P, np.linalg.inv(information), rtol=1e-9, atol=1e-14)


def test_with_instruments_it_tends_to_the_instrumental_variable_solution() -> None:
    """Consistency: the plain solution is biased by the noise in phi, this one is not.

    10^5 samples with noise 0.5: the standard error of the IV estimate is 0.5 (1 + ..) / sqrt(1e5) < 0.004; the bias of
    least squares, (sum phi phi')^-1 sum phi e, is far larger.
    """
    rows = random_rows(0, 3, 100_000, 0.5)
    plain, _ = learn(recursive_least_squares, rp.RecursiveLeastSquares(), rows[:20_000], 3, False)
    instrumental, _ = learn(recursive_least_squares, rp.RecursiveLeastSquares(), rows, 3, True)
    assert np.abs(plain - [1, 2, 3]).max() > 0.1
    np.testing.assert_allclose(instrumental, [1, 2, 3], atol=0.02)


@pytest.mark.parametrize("forgetting", [0.9, 0.99])
def test_forgetting_weighs_the_past_down(forgetting: float) -> None:
    """As long as no cap binds: the solution of exponentially weighted least squares, the start forgotten."""
    rows = random_rows(1, 3, 3000, 0.3)
    phi, target = rows[:, :3], rows[:, 3]
    theta, memory = learn(recursive_least_squares, rp.RecursiveLeastSquares(forgetting), rows, 3, False)
    weight = forgetting ** np.arange(len(rows))[::-1]
    information = phi.T @ (weight[:, None] * phi)
    np.testing.assert_allclose(theta, np.linalg.solve(information, phi.T @ (weight * target)), rtol=1e-8)
    P = compose(memory[:9].reshape(3, 3), memory[9:12])
    np.testing.assert_allclose(P, np.linalg.inv(information), rtol=1e-8, atol=1e-14)


def test_a_time_constant_is_a_forgetting_factor() -> None:
    np.testing.assert_allclose(rp.RecursiveLeastSquares(time_constant=3.0).settings(0.06, np.ones(1)), np.exp(-0.02))


@pytest.mark.parametrize("direction", ["nothing", "one"])
def test_forgetting_without_excitation_stops_at_the_cap(direction: str) -> None:
    """100 000 samples that tell nothing, or one direction only: unbounded, P would have grown by 0.99^-1e5 = 1e436."""
    optimizer = rp.RecursiveLeastSquares(0.99, initial_covariance=1e4)
    theta, memory, settings = np.zeros(3), optimizer.memory(3), optimizer.settings(0.1, np.ones(3))
    row = np.zeros((1, 5))
    if direction == "one":
        row[0, :4] = [1.0, -2.0, 0.5, 3.0]
    rows = np.zeros(1, np.int64)
    for _ in range(100_000):
        recursive_least_squares(theta, memory, settings, row, rows, 1, 0)
    U, D = memory[:9].reshape(3, 3), memory[9:12]
    assert (D > 0).all()
    assert (D <= 1e4).all()
    assert np.isfinite(theta).all()
    assert_unit_upper(U)
    assert np.abs(U).max() < 1e3
    if direction == "one":
        assert row[0, :3] @ theta == pytest.approx(3.0, rel=1e-6)


def test_tracking_estimates_the_noise_of_the_residual() -> None:
    """R settles on the variance of the noise, here 0.09, though the parameters' own uncertainty enters the error.

    With a memory of N = 2000 samples R has a relative standard deviation of sqrt(2 / 2N) = 2.2 %; five of these.
    """
    rows = random_rows(3, 2, 40_000, 0.0)
    rows[:, 2] += 0.3 * np.random.default_rng(4).standard_normal(len(rows))
    optimizer = rp.KalmanTracking(1e-5, noise_time_constant=200.0)
    _, memory = learn(kalman_tracking, optimizer, rows, 2, False, 0.1)
    assert memory[6] == pytest.approx(0.09, rel=0.11)


def test_tracking_follows_a_walk_with_the_kalman_filters_error() -> None:
    """The mean squared error of a tracked random walk is what P says: consistent to 15 % over 20 000 samples.

    Scalar, phi of variance one, so that the stationary P obeys the Riccati equation on the mean.
    """
    generator = np.random.default_rng(5)
    q, noise, count = 0.01, 0.5, 20_000
    true = np.cumsum(np.sqrt(0.1 * q) * generator.standard_normal(count))
    phi = generator.choice([-1.0, 1.0], count)
    target = phi * true + noise * generator.standard_normal(count)
    optimizer = rp.KalmanTracking(q, noise_time_constant=100.0)
    theta, memory, settings = np.zeros(1), optimizer.memory(1), optimizer.settings(0.1, np.ones(1))
    estimates = np.empty(count)
    for k in range(count):
        row = np.array([[phi[k], target[k], 1.0]])
        kalman_tracking(theta, memory, settings, row, np.zeros(1, np.int64), 1, 0, 0.1)
        estimates[k] = theta[0]
    squared = float(np.mean((estimates - true)[2000:] ** 2))
    Q, R = 0.1 * q, noise**2
    before = (Q + np.sqrt(Q * Q + 4 * Q * R)) / 2  # P before the observation: p^2 - Q p - Q R = 0
    assert squared == pytest.approx(before * R / (before + R), rel=0.15)
    assert memory[1] == pytest.approx(before * R / (before + R), rel=0.1)
