"""Functions of `numerics` by example: a few numbers each, as one would try them by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

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
from support.cases import every

#: Each is called when its case runs: what one raises is the failure of that case.
VALUES: list[tuple[str, Callable[[], object], object]] = [
    ("number", lambda: number("dt", 1), 1.0),
    ("finite", lambda: finite("gain", -2), -2.0),
    ("not_negative", lambda: not_negative("noise", 0), 0.0),
    ("between", lambda: between("forgetting_factor", 0.99, 0.0, 1.0), 0.99),
    ("whole", lambda: whole("poles", np.int8(2), 1), 2),
    ("one_of", lambda: one_of("method", "srivc", ("srivc", "least_squares")), "srivc"),
    ("truth", lambda: truth("bias", np.True_), True),
    ("text", lambda: text("input_name", np.str_("voltage [V]")), "voltage [V]"),
    ("instance", lambda: instance("replay", "auto", dict, "auto", None), "auto"),
    ("numbers", lambda: numbers("sigmas", [1, 2]), (1.0, 2.0)),
    ("owned", lambda: owned("covariance", [[1, 0], [0, 1]], (2, 2)).flags.writeable, False),
    ("iterable", lambda: (iterable([1.0]), iterable("words"), iterable(np.array(1.0))), (True, False, False)),
    ("record", lambda: [each.tolist() for each in record([1, 2], [0, 1])], [[1.0, 2.0], [0.0, 1.0]]),
    ("autoregression of sums", lambda: Autoregression.of_sums(
        100.0 * 0.5 ** abs(np.subtract.outer(np.arange(5.0), np.arange(5.0))), 100).order, 1),
    ("chi2_quantile", lambda: round(chi2_quantile(0.99, 25), 2), 44.31),
    ("correlation_lags", lambda: correlation_lags([0.1, 2.0], samples=1000, dt=0.1), 100),
    ("still_runs", lambda: still_runs(np.array([0.0, 1.0, 1.0, 2.0])).tolist(), [[0, 1], [1, 3], [3, 4]]),
    ("usual_step", lambda: round(usual_step(np.array([0.0, 0.33, 0.67, 0.33, 1.0, 4.0])), 2), 0.34),
    ("never_ties", lambda: never_ties(np.sin(np.arange(100.0))), True),
    ("never_ties, of pairs", lambda: never_ties(np.repeat(np.arange(50.0), 2)), False),
]  # fmt: skip
ARRAYS: list[tuple[str, Callable[[], NDArray[np.generic]], object]] = [
    ("array_of_reals", lambda: array_of_reals("A", [[1, 2], [3, 4]]), [[1.0, 2.0], [3.0, 4.0]]),
    ("vector", lambda: vector("u", [1, 2]), [1.0, 2.0]),
    ("coefficients", lambda: coefficients("den", [1, 4, 3]), [1.0, 4.0, 3.0]),
    ("ahead", lambda: ahead(np.array([1.0, -0.5]), np.array([8.0, 4.0, 2.0]), horizon=2), [0.0, 0.0, 2.0]),
    ("places_on_grid", lambda: places_on_grid(np.array([1.0, 1.2, 2.9, 0.1, 70.0]), dt=1.0), [0, 1, 4, 5, 10]),
    ("products", lambda: products(*[np.arange(6.0).reshape(3, 2)] * 2), [[20.0, 26.0], [26.0, 35.0]]),
    ("laguerre", lambda: laguerre(np.array([1.0, -1.0]), 0.6)[:, :2].round(2), [[0.8, -0.48], [-0.32, 0.7]]),
    ("normal_scores", lambda: normal_scores(np.array([3.0, -1.0, 1e9])).round(2), [0.0, -0.67, 0.67]),
    ("stretch", lambda: stretch(np.array([[1.0, 0.5], [0.5, 1.0]]), np.array([4.0, 0.0])), [[4.0, 2.0], [2.0, 1.75]]),
    ("without_spikes", lambda: without_spikes(np.array([0.0, 1.0, 2.0, 3.0, 1e6, 4.0, 5.0, 6.0])),
     [0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 5.0, 6.0]),
]  # fmt: skip


@every("call, expected", [row[1:] for row in VALUES], ids=[row[0] for row in VALUES])
def test_values(call: Callable[[], object], expected: object) -> None:
    assert call() == expected


@every("call, expected", [row[1:] for row in ARRAYS], ids=[row[0] for row in ARRAYS])
def test_arrays(call: Callable[[], NDArray[np.generic]], expected: object) -> None:
    np.testing.assert_allclose(call(), expected, atol=1e-8)


def test_keep() -> None:
    @dataclass(frozen=True)
    class Clock:
        dt: float

        def __post_init__(self) -> None:
            keep(self, "dt", positive)

    assert repr(Clock(1).dt) == "1.0"


def test_positive() -> None:
    with pytest.raises(InvalidArgumentError, match="dt must be greater than 0, got 0"):
        positive("dt", 0.0)


def test_autoregression_of() -> None:
    noise = np.random.default_rng(0).standard_normal(5000)
    slow = np.convolve(noise, 0.9 ** np.arange(100))
    np.testing.assert_allclose(Autoregression.of(slow).coefficients.round(1), np.array([1.0, -0.9]), atol=1e-8)
    np.testing.assert_allclose(Autoregression.of(noise).coefficients, np.array([1.0]), atol=1e-8)


def test_one_step() -> None:
    slow = np.sin(np.arange(200) / 10)
    assert bool(np.std(one_step(slow)) < 0.1 * np.std(slow))


def test_whiteness() -> None:
    noise = np.random.default_rng(0).standard_normal(2000)
    assert whiteness(noise) < 1.0 < whiteness(noise[1:] + noise[:-1])


def test_one_step_with_lost() -> None:
    slow, kept = np.sin(np.arange(400) / 10), np.arange(400) % 50 > 3
    error = one_step_with_lost(slow[kept], np.flatnonzero(kept) * 0.1, 0.1)
    # 46: the first after a gap
    assert (bool(np.median(abs(error)) < 1e-6), bool(abs(error[46]) == abs(slow[54]))) == (True, True)


def test_widening() -> None:
    noise = np.random.default_rng(0).standard_normal((3, 5000))
    slow = np.array([np.convolve(each, 0.95 ** np.arange(100))[:5000] for each in noise])
    columns = np.linalg.qr(slow[:2].T)[0]
    assert widening(columns, slow[2], float(slow[2].var())) > 3.0


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


def test_without_spikes_at_an_end() -> None:
    # both of an end are bad: no neighbour is there twice
    found = without_spikes(np.array([-1e4, 1e3, 50.0, 51.0, 52.0, 53.0, 54.0, 1e5]))
    assert found.tolist() == [51.0, 51.0, 50.0, 51.0, 52.0, 53.0, 54.0, 53.0]


def test_path_variances() -> None:
    x = np.random.default_rng(0).standard_normal(400)
    count = np.arange(20, 401, 20)
    said = np.cumsum(x - x.mean())[count - 1]
    found = Scatter(said[:, None], 1.0 / count[:, None], np.array([[1.0 / 400.0]]))
    variances, blocks = found.variances(), found.blocks()
    assert (bool(abs(variances[0] * 400 - 1) < 0.5), round(blocks[0])) == (True, 20)


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
