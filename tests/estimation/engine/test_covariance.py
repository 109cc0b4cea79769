"""The covariance of a running estimate: that of its equations, whatever the optimizer; none where none is honest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

import replant as rp
from replant.signals import prbs
from support.builders import DT, true_parameters, two_modes
from support.cases import every

STRUCTURE, PLANT = rp.Structure(2, 1), rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))
TRUE = true_parameters(PLANT, 1)
U = prbs(3000, bits=9, hold=6)
CLEAN = PLANT.simulate(U, DT)

METHODS: dict[str, dict[str, Any]] = {
    "default": {},
    "default with bias": {"structure": rp.Structure(2, 1, bias=True)},
    "fixed filter": {
        "filter": rp.StateVariableFilter(4.0),
        "optimizer": rp.RecursiveLeastSquares(),
        "instruments": True,
    },
    "forgetting": {"optimizer": rp.RecursiveLeastSquares(time_constant=30.0)},
    "buffered AMSGrad": {
        "filter": rp.StateVariableFilter(4.0),
        "optimizer": rp.AMSGrad(step_size=3e-4),
        "replay": rp.Replay(capacity=3000, batch_size=20),
        "instruments": True,
    },
}


def estimate(seed: int, noise: float = 0.1, colour: float = 0.0, **arguments: Any) -> rp.Identifier:
    white = np.random.default_rng(seed).standard_normal(U.size + 200)
    e = lfilter([1.0], [1.0, -colour], white)[200:]
    ident = rp.Identifier(**{"structure": STRUCTURE, "dt": DT, **arguments})
    ident.update_many(U, CLEAN + noise * CLEAN.std() * e)
    return ident


@pytest.mark.slow
@every("method", METHODS, quick=1)
@every("colour", [0.9, 0.0], quick=1)
@every("runs", [6, 12], quick=1)
def test_estimates_scatter_as_the_covariance_says(method: str, colour: float, runs: int) -> None:
    """The sum of P squares of each run is a chi-square of P runs degrees of freedom: one in a million is beyond.

    Optimizers of the first order also wander about their solution and add that to what they say: below alone.
    """
    total, size = 0.0, 0
    for seed in range(runs):
        ident = estimate(seed, 0.05 if colour else 0.1, colour, **METHODS[method])
        away, covariance = (
            (ident.parameters - np.resize(np.append(TRUE, 0.0), ident.parameters.size))[:4],
            ident.covariance,
        )
        size = away.size
        total += float(away @ np.linalg.solve(covariance[:4, :4], away))
    assert total < chi2.isf(1e-6, runs * size)
    if method != "buffered AMSGrad":
        assert total > chi2.ppf(1e-6, runs * size)


@every("method", [method for method in METHODS if method != "buffered AMSGrad"])
def test_more_noise_makes_it_larger_in_proportion(method: str) -> None:
    """Ten times the noise, ten times the standard deviations: within a third, for the models differ a little.

    How far AMSGrad is from its buffer's solution does not go with the noise.
    """
    small, large = (estimate(1, noise, **METHODS[method]).uncertainty.std[:4] for noise in (0.01, 0.1))
    np.testing.assert_allclose(large / small, 10.0, rtol=0.35)


def test_without_noise_it_vanishes() -> None:
    assert (estimate(0, 0.0).uncertainty.std < 1e-6).all()


@every("method", METHODS)
def test_it_is_symmetric_and_positive_definite(method: str) -> None:
    ident = estimate(2, **METHODS[method])
    covariance = ident.covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    std = np.sqrt(np.diag(covariance))
    assert np.linalg.eigvalsh(covariance / np.outer(std, std)).min() > 0
    assert covariance.shape == (len(ident.names), len(ident.names))


def test_where_no_honest_one_is_known_there_is_none() -> None:
    for ident in (
        rp.Identifier(STRUCTURE, DT),
        estimate(0, instruments=False, optimizer=rp.RecursiveLeastSquares()),
        estimate(0, optimizer="amsgrad"),
    ):
        assert np.isnan(ident.covariance).all()
        assert ident.covariance.shape == (4, 4)
    few = rp.Identifier(
        STRUCTURE, DT, filter=rp.StateVariableFilter(4.0), optimizer=rp.AMSGrad(1e-3), instruments=True,
        replay=rp.Replay(capacity=5),
    )  # fmt: skip
    few.update_many(U, CLEAN)
    assert np.isnan(few.covariance).all()  # fewer rows than twice the parameters
