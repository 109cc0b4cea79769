"""Functions of `numerics` by example: a few numbers each, as one would try them by hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from replant.numerics.arguments import (
    InvalidArgumentError,
    array_of_reals,
    between,
    coefficients,
    finite,
    instance,
    iterable,
    keep,
    not_negative,
    number,
    numbers,
    one_of,
    owned,
    positive,
    record,
    text,
    truth,
    vector,
    whole,
)
from replant.numerics.autoregression import (
    Autoregression,
    ahead,
    one_step,
    one_step_with_lost,
    places_on_grid,
    whiteness,
)
from replant.numerics.batch_means import Scatter, stretch
from replant.numerics.linear_algebra import chi2_quantile, products, roots, solve
from replant.numerics.projections import explained_power, laguerre, weights_of, widening
from replant.numerics.residuals import correlation_lags, correlations
from replant.numerics.robust import never_ties, normal_scores, robust_std, still_runs, usual_step, without_spikes


def test_keep() -> None:
    @dataclass(frozen=True)
    class Clock:
        dt: float

        def __post_init__(self) -> None:
            keep(self, "dt", positive)

    assert repr(Clock(1).dt) == "1.0"


def test_number() -> None:
    assert number("dt", 1) == 1.0


def test_finite() -> None:
    assert finite("gain", -2) == -2.0


def test_positive() -> None:
    with pytest.raises(InvalidArgumentError, match="dt must be greater than 0, got 0"):
        positive("dt", 0.0)


def test_not_negative() -> None:
    assert not_negative("noise", 0) == 0.0


def test_between() -> None:
    assert between("forgetting_factor", 0.99, 0.0, 1.0) == 0.99


def test_whole() -> None:
    assert whole("poles", np.int8(2), 1) == 2


def test_one_of() -> None:
    assert one_of("method", "srivc", ("srivc", "least_squares")) == "srivc"


def test_truth() -> None:
    assert truth("bias", np.True_)


def test_text() -> None:
    assert text("input_name", np.str_("voltage [V]")) == "voltage [V]"


def test_instance() -> None:
    assert instance("replay", "auto", dict, "auto", None) == "auto"


def test_array_of_reals() -> None:
    np.testing.assert_allclose(array_of_reals("A", [[1, 2], [3, 4]]), np.array([[1.0, 2.0], [3.0, 4.0]]), atol=1e-8)


def test_vector() -> None:
    np.testing.assert_allclose(vector("u", [1, 2]), np.array([1.0, 2.0]), atol=1e-8)


def test_coefficients() -> None:
    np.testing.assert_allclose(coefficients("den", [1, 4, 3]), np.array([1.0, 4.0, 3.0]), atol=1e-8)


def test_numbers() -> None:
    assert numbers("sigmas", [1, 2]) == (1.0, 2.0)


def test_owned() -> None:
    assert not owned("covariance", [[1, 0], [0, 1]], (2, 2)).flags.writeable


def test_iterable() -> None:
    assert (iterable([1.0]), iterable("words"), iterable(np.array(1.0))) == (True, False, False)


def test_autoregression_of() -> None:
    noise = np.random.default_rng(0).standard_normal(5000)
    slow = np.convolve(noise, 0.9 ** np.arange(100))
    np.testing.assert_allclose(Autoregression.of(slow).coefficients.round(1), np.array([1.0, -0.9]), atol=1e-8)
    np.testing.assert_allclose(Autoregression.of(noise).coefficients, np.array([1.0]), atol=1e-8)


def test_autoregression_of_sums() -> None:
    assert (
        Autoregression.of_sums(100.0 * 0.5 ** abs(np.subtract.outer(np.arange(5.0), np.arange(5.0))), 100).order
    ) == 1


def test_one_step() -> None:
    slow = np.sin(np.arange(200) / 10)
    assert bool(np.std(one_step(slow)) < 0.1 * np.std(slow))


def test_ahead() -> None:
    np.testing.assert_allclose(
        ahead(np.array([1.0, -0.5]), np.array([8.0, 4.0, 2.0]), horizon=2), np.array([0.0, 0.0, 2.0]), atol=1e-8
    )


def test_whiteness() -> None:
    noise = np.random.default_rng(0).standard_normal(2000)
    assert whiteness(noise) < 1.0 < whiteness(noise[1:] + noise[:-1])


def test_places_on_grid() -> None:
    np.testing.assert_allclose(
        places_on_grid(np.array([1.0, 1.2, 2.9, 0.1, 70.0]), dt=1.0), np.array([0, 1, 4, 5, 10]), atol=1e-8
    )


def test_one_step_with_lost() -> None:
    slow, kept = np.sin(np.arange(400) / 10), np.arange(400) % 50 > 3
    error = one_step_with_lost(slow[kept], np.flatnonzero(kept) * 0.1, 0.1)
    # 46: the first after a gap
    assert (bool(np.median(abs(error)) < 1e-6), bool(abs(error[46]) == abs(slow[54]))) == (True, True)


def test_chi2_quantile() -> None:
    assert round(chi2_quantile(0.99, 25), 2) == 44.31


def test_products() -> None:
    columns = np.arange(6.0).reshape(3, 2)
    np.testing.assert_allclose(products(columns, columns), np.array([[20.0, 26.0], [26.0, 35.0]]), atol=1e-8)


def test_widening() -> None:
    noise = np.random.default_rng(0).standard_normal((3, 5000))
    slow = np.array([np.convolve(each, 0.95 ** np.arange(100))[:5000] for each in noise])
    columns = np.linalg.qr(slow[:2].T)[0]
    assert widening(columns, slow[2], float(slow[2].var())) > 3.0


def test_laguerre() -> None:
    np.testing.assert_allclose(
        laguerre(np.array([1.0, -1.0]), 0.6)[:, :2].round(2), np.array([[0.8, -0.48], [-0.32, 0.7]]), atol=1e-8
    )


def test_weights_of() -> None:
    noise = np.cumsum(np.random.default_rng(0).standard_normal(1000))
    function = np.sin(np.arange(1000.0))[:, None]
    np.testing.assert_allclose(weights_of(function, 2.0 * function[:, 0] + noise).round(1), np.array([2.0]), atol=1e-8)


def test_explained_power() -> None:
    noise = np.cumsum(np.random.default_rng(0).standard_normal(1000))
    functions = np.random.default_rng(1).standard_normal((1000, 5))
    assert explained_power(functions, noise) < 0.2 < explained_power(functions, functions[:, 0] + noise)


def test_correlations() -> None:
    noise = np.random.default_rng(1).standard_normal((2, 4000))
    found = correlations(*noise, lags=100)
    assert (float(found.auto[0]), max(found.outside) < 0.1) == (1.0, True)


def test_correlation_lags() -> None:
    assert correlation_lags([0.1, 2.0], samples=1000, dt=0.1) == 100


def test_without_spikes() -> None:
    np.testing.assert_allclose(
        without_spikes(np.array([0.0, 1.0, 2.0, 3.0, 1e6, 4.0, 5.0, 6.0])),
        np.array([0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 5.0, 6.0]),
        atol=1e-8,
    )

    # both of an end are bad: no neighbour is there twice
    found = without_spikes(np.array([-1e4, 1e3, 50.0, 51.0, 52.0, 53.0, 54.0, 1e5]))
    assert found.tolist() == [51.0, 51.0, 50.0, 51.0, 52.0, 53.0, 54.0, 53.0]


def test_normal_scores() -> None:
    np.testing.assert_allclose(
        normal_scores(np.array([3.0, -1.0, 1e9])).round(2), np.array([0.0, -0.67, 0.67]), atol=1e-8
    )


def test_still_runs() -> None:
    assert still_runs(np.array([0.0, 1.0, 1.0, 2.0])).tolist() == [[0, 1], [1, 3], [3, 4]]


def test_usual_step() -> None:
    assert usual_step(np.array([0.0, 0.33, 0.67, 0.33, 1.0, 4.0])).__round__(2) == 0.34


def test_never_ties() -> None:
    assert (never_ties(np.sin(np.arange(100.0))), never_ties(np.repeat(np.arange(50.0), 2))) == (True, False)


def test_path_variances() -> None:
    x = np.random.default_rng(0).standard_normal(400)
    count = np.arange(20, 401, 20)
    said = np.cumsum(x - x.mean())[count - 1]
    found = Scatter(said[:, None], 1.0 / count[:, None], np.array([[1.0 / 400.0]]))
    variances, blocks = found.variances(), found.blocks()
    assert (bool(abs(variances[0] * 400 - 1) < 0.5), round(blocks[0])) == (True, 20)


def test_stretch() -> None:
    np.testing.assert_allclose(
        stretch(np.array([[1.0, 0.5], [0.5, 1.0]]), np.array([4.0, 0.0])),
        np.array([[4.0, 2.0], [2.0, 1.75]]),
        atol=1e-8,
    )


def test_record() -> None:
    u, y = record([1, 2], [0, 1])
    assert (u.tolist(), y.tolist()) == ([1.0, 2.0], [0.0, 1.0])


def test_solve() -> None:
    found = solve(np.array([[2.0, 0.0], [0.0, 4.0]]), np.array([1.0, 1.0]))
    assert found is not None
    np.testing.assert_allclose(found, [0.5, 0.25])
    assert solve(np.zeros((1, 1)), np.ones(1)) is None


def test_roots() -> None:
    np.testing.assert_allclose(roots(np.array([1.0, 3.0, 2.0])).real, [-2.0, -1.0])
    assert np.isnan(roots(np.array([1e-300, 1e300]))).all()


def test_robust_std() -> None:
    assert abs(robust_std(np.array([-1.0, 1.0, 0.5, -0.6745, 1e9, 0.1, -0.2])) - 1.0) < 1e-4
