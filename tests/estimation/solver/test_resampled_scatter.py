"""The scatter of an estimate by resampling: that of its covariance where the likelihood is quadratic."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.resampled_scatter import DRAWS, resampled_scatter
from replant.estimation.solver.srivc import refine
from replant.signals import prbs

DT, SAMPLES = 0.1, 600
STRUCTURE = rp.Structure(1)
U = prbs(SAMPLES, hold=10)
CLEAN = rp.TransferFunction([2.0], [1.0, 1.0]).simulate(U, DT)


def record(noise: np.ndarray) -> Record:
    return Record(U, CLEAN + noise, np.array([DT]))


@pytest.mark.parametrize("lost", [0, 60])
def test_a_quadratic_likelihood_gives_the_scatter_of_the_covariance(lost: int) -> None:
    rng = np.random.default_rng(1)
    given = record(0.2 * rng.standard_normal(SAMPLES))
    if lost:
        measured = rng.permutation(SAMPLES) >= lost
        given = Record(given.u, given.y, given.intervals, measured=measured)
    found = refine(STRUCTURE, given)
    assert found is not None
    theta = found.theta[:2]
    output = STRUCTURE.transfer_function(theta).simulate(U, DT)
    slopes = [(STRUCTURE.transfer_function(theta + step).simulate(U, DT) - output) / 1e-4 for step in 1e-4 * np.eye(2)]
    made = np.cov(np.array(slopes)) @ found.covariance[:2, :2]
    usual = float(np.sqrt(np.trace(made) / output.var()))
    ratio = resampled_scatter(STRUCTURE, given, theta, filtered=False) / usual
    # of the two directions that scatter one may make nearly all of it: DRAWS squares of chance, at 1e-3 either way
    assert chi2.ppf(1e-3, DRAWS) < DRAWS * ratio**2 < chi2.ppf(1.0 - 1e-3, DRAWS)


def test_it_is_the_same_each_time_and_smaller_by_the_filter_of_the_noise() -> None:
    noise = 0.2 * lfilter([1.0], [1.0, -0.95], np.random.default_rng(2).standard_normal(SAMPLES))
    given = record(noise)
    found = refine(STRUCTURE, given)
    assert found is not None
    assert found.noise.filters
    plain, filtered, again = (
        resampled_scatter(STRUCTURE, given, found.theta[:2], filtered=which) for which in (False, True, True)
    )
    assert filtered == again
    assert filtered < plain


def test_an_estimate_of_which_no_other_can_be_made_is_not_known() -> None:
    given = Record(np.zeros(SAMPLES), np.random.default_rng(3).standard_normal(SAMPLES), np.array([DT]))
    assert resampled_scatter(STRUCTURE, given, np.array([1.0, 2.0]), filtered=True) == np.inf
