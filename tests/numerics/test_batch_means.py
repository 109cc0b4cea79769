"""The variance of an estimate from its path: right on the mean for noise of every colour."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import lfilter

import replant as rp
from replant.kernels.schema import ROOM
from replant.numerics.batch_means import Scatter, no_less_than_scattered, path_of_record, scatter_of, stretch
from replant.numerics.linear_algebra import larger
from replant.paper.actuator import CREEP, NOISE
from replant.paper.actuator import STRUCTURE as ACTUATOR
from replant.rigs import deap_rig, deap_voltage
from replant.signals import prbs
from support.builders import DT
from support.cases import every
from support.inside import path_of, slowness_of, state_of


def bridge(scores: np.ndarray, information: np.ndarray) -> Scatter:
    """A path of one coordinate, from what each block (B,) says and the information it brings, and the last P."""
    known, away = 1.0 / np.cumsum(information), scores.sum() / information.sum()
    return Scatter(np.cumsum(scores - away * information)[:, None], known[:, None], known[-1:, None])


@every("blocks", [16, 32])
@every("uneven", [False, True])
def test_it_is_unbiased_where_blocks_are_independent(blocks: int, uneven: bool) -> None:
    """The variance told is a quadratic form in the scores; its mean, the trace, is p for scores as large as w."""
    generator = np.random.default_rng(blocks)
    information = generator.uniform(0.2, 3.0, blocks) if uneven else np.full(blocks, 2.0)
    mean = 0.0
    for block in range(blocks):
        scores = np.zeros(blocks)
        scores[block] = math.sqrt(information[block])
        mean += float(bridge(scores, information).variances()[0])
    assert mean == pytest.approx(1.0 / information.sum(), rel=1e-12)


def test_the_true_value_does_not_matter() -> None:
    generator = np.random.default_rng(3)
    scores, information = generator.standard_normal(20), generator.uniform(0.5, 1.5, 20)
    moved = bridge(scores + 7.0 * information, information).variances()
    np.testing.assert_allclose(moved, bridge(scores, information).variances(), rtol=1e-9)


@every("half", [0, 1])
def test_it_is_unbiased_where_parts_of_a_record_tell_different_directions(half: int) -> None:
    """Two regressors that are nearly one in a half of the record: the diagonal of P alone does not tell its inverse."""
    generator = np.random.default_rng(7)
    zeta = generator.standard_normal((1600, 2))
    zeta[800 * half : 800 * half + 800, 1] = zeta[800 * half : 800 * half + 800, 0] * 1.02
    inverse, ratios = np.linalg.inv(zeta.T @ zeta), []
    for _ in range(100):
        noise = generator.standard_normal(1600)
        theta = inverse @ (zeta.T @ noise)
        path = path_of_record(zeta, noise - zeta @ theta, theta, np.zeros((2, 2)), np.zeros(2), 2)
        ratios.append(scatter_of(path, theta, inverse, 2).variances() / np.diag(inverse))
    # each of some 20 blocks and more: a mean of 100 is known to sqrt(2 / 2000), of which these are five
    np.testing.assert_allclose(np.mean(ratios, axis=0), 1.0, atol=0.16)


def test_where_the_path_cannot_tell_the_covariance_stays() -> None:
    """Too few rows, or nearly all the information in one of them."""
    covariance = np.array([[1e-9]])
    generator = np.random.default_rng(4)
    short = bridge(generator.standard_normal(15), np.ones(15))
    lopsided = bridge(generator.standard_normal(32), np.append(np.full(31, 1e-3), 1.0))
    for path in (short, lopsided):
        np.testing.assert_array_equal(no_less_than_scattered(covariance, path), covariance)
    even = bridge(generator.standard_normal(16), np.ones(16))
    assert no_less_than_scattered(covariance, even) > covariance


def test_a_drift_is_told_by_longer_blocks() -> None:
    """Scores that keep their sign for a quarter of the record: blocks four times as long add them up."""
    scores = np.repeat([1.0, -1.0, 1.0, -1.0], 8)
    path = bridge(scores, np.ones(32))
    told = no_less_than_scattered(np.array([[1e-3]]), path)
    short = path.variances()[0]
    assert short == pytest.approx(1.0 / 31.0, rel=1e-12)  # as if independent
    assert told[0, 0] > 3.5 * short


def test_to_stretch_is_the_nearest_covariance_of_such_variances() -> None:
    """What is taken off the precision is diagonal, and zero where a variance is larger than asked."""
    root = np.random.default_rng(5).standard_normal((4, 4))
    covariance = root @ root.T
    wanted = np.diag(covariance) * [0.5, 1.0, 4.0, 9.0]
    stretched = stretch(covariance, wanted)
    taken = np.linalg.inv(covariance) - np.linalg.inv(stretched)
    scale = np.sqrt(np.outer(np.diag(np.linalg.inv(covariance)), np.diag(np.linalg.inv(covariance))))
    np.testing.assert_allclose((taken - np.diag(np.diag(taken))) / scale, 0.0, atol=1e-9)
    assert (np.diag(taken) > -1e-9).all()
    more = np.diag(stretched) / wanted - 1.0
    assert (more > -1e-6).all()
    np.testing.assert_allclose(more * np.diag(taken) / np.diag(scale), 0.0, atol=1e-6)
    assert (more > 0.1).any()
    np.testing.assert_array_equal(stretch(covariance, 0.5 * np.diag(covariance)), covariance)
    np.testing.assert_allclose(larger(covariance, 4.0 * covariance), 4.0 * covariance)


def test_errors_that_cancel_in_the_output_still_do() -> None:
    """Two regressors that are nearly one, and noise that is slow along their difference: what both make is known."""
    generator = np.random.default_rng(8)
    common, difference = generator.standard_normal((2, 3200))
    zeta = np.column_stack([common, common + 0.05 * difference])
    inverse, told, true = np.linalg.inv(zeta.T @ zeta), [], []
    for _ in range(50):
        slow = lfilter([0.3], [1.0, -0.98], generator.standard_normal(3200))
        noise = generator.standard_normal(3200) + slow * np.sign(difference)
        theta = inverse @ (zeta.T @ noise)
        path = path_of_record(zeta, noise - zeta @ theta, theta, np.zeros((2, 2)), np.zeros(2), 2)
        white = float(noise.var()) * inverse
        covariance = no_less_than_scattered(white, scatter_of(path, theta, inverse, 2))
        told.append(np.trace(covariance @ zeta.T @ zeta))
        true.append(np.sum((zeta @ theta) ** 2))
    # 50 squares of one direction are known to a fifth; a variance by some 20 slow blocks is a little larger
    assert 0.6 < np.mean(told) / np.mean(true) < 1.6


@every("entries", [2, 3])
@pytest.mark.parametrize("samples", [40, 1000, 1007])
def test_the_path_of_a_record_is_least_squares_of_its_beginnings(samples: int, entries: int) -> None:
    generator = np.random.default_rng(samples)
    zeta = generator.standard_normal((samples, 3)) * [1.0, 100.0, 0.01]
    target = zeta @ [1.0, 2.0, 3.0] + generator.standard_normal(samples)
    theta = np.linalg.lstsq(zeta, target, rcond=None)[0]
    path = path_of_record(zeta, target - zeta @ theta, theta, np.zeros((3, 3)), np.zeros(3), entries)
    step, rows = int(path.step), int(path.kept)
    assert (ROOM - 1) // 2 <= rows < ROOM
    assert rows == samples // step
    assert path.due == (rows + 1) * step
    found = scatter_of(path, theta, np.linalg.inv(zeta.T @ zeta), entries)
    said, known = found.scores, found.diagonals
    beginning = theta
    for row in range(rows):
        if (row + 1) * step < 6:  # hardly more equations than unknowns
            continue
        first = zeta[: (row + 1) * step]
        beginning = np.linalg.lstsq(first, target[: (row + 1) * step], rcond=None)[0]
        covariance = np.linalg.inv(first.T @ first)
        alone = np.linalg.inv(covariance[:entries, :entries]) @ (beginning - theta)[:entries]
        np.testing.assert_allclose(said[row], alone, rtol=1e-6, atol=1e-6 * np.abs(said).max())
        np.testing.assert_allclose(known[row], np.diag(covariance)[:entries], rtol=1e-6)
    np.testing.assert_allclose(path.rows[rows, 0], beginning, rtol=1e-6)


# --- of a running estimate

PLANT = rp.TransferFunction([2.0], [1.0, 1.0])
TRUE = np.array([1.0, 2.0])


def slow_noise(seed: int, samples: int) -> np.ndarray:
    """White noise, and slow noise of half its size that remembers 100 samples: an autoregression of order 4 misses it.

    Together they are of variance 1.5.
    """
    white, drive = np.random.default_rng(seed).standard_normal((2, samples + 2000))
    return (white + lfilter([0.1], [1.0, -0.99], drive))[2000:]


def test_the_block_in_the_making_begins_where_the_estimate_was() -> None:
    """The rows are evenly spaced, those since the record was last solved as a whole as those before."""
    u = prbs(1600, bits=9, hold=20)
    y = PLANT.simulate(u, DT) + 0.1 * slow_noise(0, u.size)
    ident, was = rp.Identifier(rp.Structure(1), DT), {}
    for k in range(u.size):
        ident.update(u[k], y[k])
        was[k + 1] = ident.parameters
    path, solved = state_of(ident).path, state_of(ident).solved_at
    counts = int(path.step) * np.arange(1, len(path_of(ident)) + 1)
    assert counts[-1] + path.step > u.size
    began = path.rows[len(counts), 0] * state_of(ident).unit
    np.testing.assert_array_equal(began[:2], was[counts[-1]])
    assert 1000 <= solved < 1500
    assert (counts > solved).sum() > 5


def test_nothing_is_kept_while_nothing_is_learned() -> None:
    u = prbs(4000, bits=9, hold=20)
    y = PLANT.simulate(u, DT) + 0.1 * slow_noise(1, u.size)
    ident = rp.Identifier(rp.Structure(1), DT)
    ident.update_many(u[:2500], y[:2500])
    before = path_of(ident)
    ident.freeze()
    ident.update_many(u[2500:3900], y[2500:3900])
    np.testing.assert_array_equal(path_of(ident), before)


@pytest.mark.slow
def test_intervals_cover_under_slow_noise() -> None:
    """16 runs, online and offline: the squares of error over standard deviation have a mean near one.

    Were they chi-square of one degree of freedom, that mean would have a standard deviation of sqrt(2 / 16) = 0.35;
    told by some 20 blocks they are a little larger, by 20 / 18.  Three of these: 1.1 + 3 * 0.39.  By the residual's
    colour alone it is 3.
    """
    u = prbs(6000, bits=9, hold=20)
    clean = PLANT.simulate(u, DT)
    squares: dict[str, list[np.ndarray]] = {"online": [], "offline": []}
    for seed in range(16):
        y = clean + 0.3 * clean.std() * slow_noise(seed, u.size)
        ident = rp.Identifier(rp.Structure(1), DT)
        ident.update_many(u, y)
        squares["online"].append(((ident.parameters - TRUE) / ident.uncertainty.std) ** 2)
        found = rp.fit(u, y, DT, rp.Structure(1))
        squares["offline"].append(((found.parameters - TRUE) / found.uncertainty.std) ** 2)
    for name, runs in squares.items():
        bound = 1.1 + 3 * 1.1 * math.sqrt(2 / len(runs))
        assert (np.mean(runs, axis=0) < bound).all(), name
        assert (np.mean(np.array(runs) < 1.96**2, axis=0) > 0.95 - 3 * math.sqrt(0.95 * 0.05 / len(runs))).all(), name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_creep_does_not_look_like_certainty(seed: int) -> None:
    """The actuator's displacement creeps off: its coefficients are no better known than they are."""
    rig = deap_rig(noise=NOISE, creep=CREEP)
    u = deap_voltage(120_000, seed)
    ident = rp.Identifier(ACTUATOR, rig.dt, preprocess=rig.preprocess)
    ident.update_many(u, rig.measure(u, seed))
    true = np.append(rig.plant.den[1:], rig.plant.num)
    away = np.abs(ident.parameters[:5] - true) / ident.uncertainty.std[:5]
    assert (away < 4.0).all()
    assert (ident.uncertainty.std[:5] < 0.2 * np.abs(true)).all()
    assert slowness_of(ident) > 10.0


def test_white_noise_is_not_slow() -> None:
    """The path tells a variance to a quarter, so that three times the standard deviation is out of reach."""
    u = prbs(4000, bits=9, hold=20)
    y = PLANT.simulate(u, DT) + 0.3 * np.random.default_rng(0).standard_normal(u.size)
    for arguments in ({}, {"optimizer": rp.RecursiveLeastSquares(time_constant=50.0)}, {"optimizer": "adam"}):
        ident = rp.Identifier(rp.Structure(1), DT, **arguments)
        ident.update_many(u, y)
        assert 1.0 <= slowness_of(ident) < 2.0
