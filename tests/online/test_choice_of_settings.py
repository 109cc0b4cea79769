"""Settings left to "auto": what is given stays, what is chosen suits the record and can be typed again."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.optimizers import OPTIMIZERS
from replant.estimation.settings import Request
from replant.estimation.solver.least_squares import choose_filter, regressors
from replant.online.startup import settle
from support.builders import G1, G2, random_plant, record
from support.cases import every

U, Y = record(G2, seed=1, samples=3000, dt=0.01, hold=20, noise=0.01)


def test_what_is_given_stays_as_it_is() -> None:
    request = Request(
        rp.Structure(2, 1),
        0.01,
        rp.StateVariableFilter(10.0),
        rp.Scaling(1.0, [1.0] * 4),
        rp.Adam(0.1),
        rp.Replay(7),
        instruments=False,
        normalize=False,
        preprocess=rp.Preprocess("square", 1.0, 2.0),
    )
    settled = settle(request, U, Y)
    for name in {field.name for field in dataclasses.fields(request)} - {"dt", "startup", "history"}:
        assert getattr(settled, name) is getattr(request, name)
    assert settled.dt == 0.01
    assert settled.startup == U.size  # what the choices were made from


def test_none_means_no_scaling_and_no_replay() -> None:
    settled = settle(Request(rp.Structure(2, 1), 0.01, rp.StateVariableFilter(10.0), scaling=None, replay=None), U, Y)
    assert settled.scaling == rp.Scaling.none(rp.Structure(2, 1))
    assert settled.replay is None


def test_auto_scaling_makes_every_signal_of_size_one() -> None:
    structure, state_filter = rp.Structure(2, 1, bias=True), rp.StateVariableFilter(10.0)
    preprocess = rp.Preprocess(output_offset="mean")
    settled = settle(Request(structure, 0.01, state_filter, optimizer="amsgrad", preprocess=preprocess), U, Y)
    assert settled.preprocess.output_offset == pytest.approx(Y.mean())
    phi, _ = regressors(structure, 0.01, state_filter, settled.preprocess, U, Y)
    scaled = phi / settled.scaling.sigmas(structure)
    np.testing.assert_allclose(np.sqrt(np.mean(scaled**2, axis=0)), 1.0, rtol=1e-12)
    assert np.sqrt(np.mean(((Y - Y.mean()) / settled.scaling.output) ** 2)) == pytest.approx(1.0)


@every("name", OPTIMIZERS)
def test_an_optimizer_by_name_comes_with_settings_that_can_be_typed_again(name: str) -> None:
    request = Request(rp.Structure(2, 1), 0.01, rp.StateVariableFilter(10.0), scaling=None, optimizer=name)
    for length in (None, 100, 10**7):
        optimizer = settle(request, U, Y, length).optimizer
        assert type(optimizer) is OPTIMIZERS[name]
        for field in dataclasses.fields(optimizer):
            value = getattr(optimizer, field.name)
            assert value is None or value == float(f"{value:.3g}")


@every(
    ("optimizer", "instruments", "refined"),
    [
        ("auto", "auto", True),
        ("recursive-least-squares", "auto", True),
        (rp.KalmanTracking(0.1), "auto", True),
        (rp.KalmanTracking(0.1), True, True),
        (rp.RecursiveLeastSquares(), False, False),
        ("amsgrad", "auto", False),
        (rp.AMSGrad(0.01), True, False),
    ],
    ids=str,
)
def test_the_refined_filter_goes_with_instruments_and_a_covariance(
    optimizer: Any, instruments: Any, refined: bool
) -> None:
    """And no scaling with what does not depend on it: least squares does not, a walk at random does."""
    settled = settle(Request(rp.Structure(2, 1), 0.01, optimizer=optimizer, instruments=instruments), U, Y)
    assert isinstance(settled.filter, rp.RefinedFilter) == refined
    assert settled.instruments == (instruments if isinstance(instruments, bool) else refined)
    least_squares = isinstance(settled.optimizer, rp.RecursiveLeastSquares)
    assert (settled.scaling == rp.Scaling.none(rp.Structure(2, 1))) == least_squares
    assert (settled.replay is None) == settled.optimizer.keeps_covariance
    if refined:  # beside the constant that is estimated, the mean is the working point
        assert settled.preprocess.output_offset == pytest.approx(Y.mean())
        assert settled.preprocess.input_offset == pytest.approx(U.mean())


@pytest.mark.parametrize("plant", [G1, G2, random_plant(3, 3, 1)], ids=["G1", "G2", "random"])
def test_the_chosen_cutoff_suits_the_plant(plant: rp.TransferFunction) -> None:
    """It lies among the plant's speeds: between a tenth of the slowest pole and thirty times the fastest."""
    n = plant.den.size - 1
    dt = 0.02 / abs(plant.poles).max()
    u, y = record(plant, seed=2, samples=20_000, dt=dt, hold=100, noise=1e-3)
    chosen = choose_filter(rp.Structure(n, n - 1), dt, rp.Preprocess(), u, y)
    assert chosen.method == "exact"
    assert 0.1 * abs(plant.poles).min() < chosen.cutoff < 30 * abs(plant.poles).max()
    assert chosen.cutoff == float(f"{chosen.cutoff:.3g}")


def test_time_in_another_unit_chooses_the_same_filter_in_that_unit() -> None:
    fine = choose_filter(rp.Structure(2, 1), 0.01, rp.Preprocess(), U, Y)
    coarse = choose_filter(rp.Structure(2, 1), 10.0, rp.Preprocess(), U, Y)
    assert coarse.cutoff == pytest.approx(fine.cutoff / 1000, rel=0.01)


@pytest.mark.parametrize("bad", [np.nan, 1e308])
def test_a_sample_that_is_rejected_has_no_say(bad: float) -> None:
    """At the end, where it does not interrupt the record."""
    means = rp.Preprocess("identity", "mean", "mean")
    request = Request(rp.Structure(2, 1), 0.01, optimizer="amsgrad", preprocess=means)
    clean = settle(request, U, Y)
    settled = settle(request, np.append(U, [1.0, bad]), np.append(Y, [bad, 1.0]))
    assert settled.preprocess == clean.preprocess
    assert settled.filter.cutoff == pytest.approx(clean.filter.cutoff, rel=0.5)
    given = dataclasses.replace(request, filter=rp.StateVariableFilter(10.0))
    assert settle(given, np.append(U, [1.0, bad]), np.append(Y, [bad, 1.0])).scaling == settle(given, U, Y).scaling
