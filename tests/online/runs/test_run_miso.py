"""`rp.run` of several inputs: what `Identifier` makes of the record, finished."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import replant as rp
from support.cases import every
from support.rows import ASKED, DT, FAST, SLOW, noisy, row_of, toggling

U = toggling(5, samples=800)
Y = noisy(5, row_of(U, FAST, SLOW))
CLEAR = noisy(5, row_of(U, FAST, SLOW), decibels=20.0)  # the slow input is told within the record
PLANT = (2.0, 1.0), (0.2, 0.4)  # gain and pole of each input


@pytest.mark.slow
def test_a_run_is_the_identifier_finished() -> None:
    found = rp.run(U, CLEAR, DT, **ASKED)
    ident = rp.Identifier(**ASKED, dt=DT, startup=120)
    ident.update_many(U, CLEAR)
    ident.finish()
    assert isinstance(found, rp.RowFit)
    np.testing.assert_array_equal(found.parameters, ident.parameters)
    assert found.verdict.status == "trusted"
    assert found.output.shape == Y.shape
    assert found.fit == pytest.approx(rp.fit(U, CLEAR, DT, **ASKED).fit, abs=0.1)


@pytest.mark.slow
def test_the_output_behind_a_load_is_that_of_the_load() -> None:
    u = toggling(6, samples=1000)
    y = noisy(6, row_of(u, FAST, SLOW), decibels=14.0) + np.where(np.arange(1000) < 500, 0.0, 3.0)
    u[100:150:2], y[300:350:2] = np.nan, np.inf  # samples that are turned away
    found = rp.run(u, y, DT, **ASKED)
    assert found.verdict.status == "trusted"
    left = (found.output - y)[np.isfinite(y)]
    assert found.noise is not None
    assert np.sqrt(np.nanmean(left**2)) < 1.2 * np.sqrt(found.noise.residual_variance)


@pytest.mark.slow
def test_the_output_of_the_plant_before_a_change_is_not_known() -> None:
    u, since = toggling(7, samples=4000), np.arange(4000) >= 2000
    first, second = (rp.TransferFunction([b], [1.0, a]).simulate(u[:, i].copy(), 0.1) for i, (b, a) in enumerate(PLANT))
    y = first + np.where(since, 2.0, 1.0) * second + 0.1 * np.random.default_rng(7).standard_normal(4000)
    found = rp.run(u, y, 0.1, poles=(1, 1))
    assert np.isnan(found.output[:1900]).all()
    assert np.isfinite(found.output[2100:]).all()
    assert "the plant changed 200 s ago: the estimate is that of the samples since" in " ".join(found.verdict.reasons)


@pytest.mark.slow
@every("seed", range(4), quick=1)
def test_a_sample_that_is_left_out_takes_its_time(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = U.copy()
    for column in u.T:
        column[rng.random(column.size) < 0.05] = np.nan
    found, fitted = rp.run(u, Y, DT, **ASKED), rp.fit(u, Y, DT, **ASKED)
    assert found.parameters == pytest.approx(fitted.parameters, rel=1e-3)
    assert found.verdict.status == fitted.verdict.status


@pytest.mark.slow
def test_another_column_is_named_as_by_fit() -> None:
    third = toggling(8, samples=800)[:, 0]
    y = Y + rp.TransferFunction([1.0], [1.0, 1.0]).simulate(third.copy(), DT) * np.std(Y)
    log = rp.Log(U[:, 0].copy(), y, DT, others={"u2": U[:, 1].copy(), "u3": third}, more_inputs=("u2",))
    found, fitted = rp.run(log, **ASKED), rp.fit(log, **ASKED)
    assert "column u3 could explain a further" in " ".join(found.verdict.reasons)
    assert found.verdict.status == fitted.verdict.status == "inconsistent"
    alone = rp.Log(U[:, 0].copy(), CLEAR, DT, others={"u2": U[:, 1].copy(), "u3": third}, more_inputs=("u2",))
    assert rp.run(alone, **ASKED).verdict.status == "trusted"


@pytest.mark.slow
def test_stamps_and_references_come_with_the_samples() -> None:
    t = DT * np.arange(Y.size) + np.where(np.arange(Y.size) < 500, 0.0, 100.0)
    found = rp.run(U, Y, DT, **ASKED, t=t, reference=U)
    assert found.parameters == pytest.approx(rp.fit(U, Y, DT, **ASKED, t=t, reference=U).parameters, rel=1e-3)


@every(
    "more, words",
    [
        ({"structure": rp.Structure(1)}, "several inputs take no structure yet: leave it out"),
        ({"optimizer": "amsgrad"}, "several inputs take no optimizer yet: leave it out"),
        ({"preprocess": rp.Preprocess()}, "several inputs take no preprocess yet: leave it out"),
        ({"t": DT * np.arange(7)}, "t has 7 rows and y 800 samples: give one row for each"),
        ({"reference": U[:9]}, "reference has 9 rows and y 800 samples: give one row for each"),
        ({"t": DT * np.r_[0:600, 599:799]}, r"t must be finite and strictly increasing; t\[600\]"),
        ({"poles": (1, 1, 1)}, "poles has 3 entries"),
    ],
)
def test_what_does_not_match_is_named(more: dict[str, Any], words: str) -> None:
    with pytest.raises(rp.InvalidArgumentError, match=words):
        rp.run(U, Y, DT, **(ASKED | more))
