"""The provisional model: there during start-up, uncertain as it says, and without effect on what comes later."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.solve import Solution, solve
from replant.numerics.arguments import FloatArray
from replant.online import startup
from replant.online.startup import next_provisional
from support.cases import every

DT = 0.02
PLANT = rp.TransferFunction([4.0], [1.0, 1.2, 4.0])
TRUE = np.array([1.2, 4.0, 4.0])


def noisy(seed: int, samples: int = 700, noise: float = 0.05) -> tuple[FloatArray, FloatArray]:
    random = np.random.default_rng(seed)
    u = np.where(np.cumsum(random.random(samples) < 0.05) % 2 == 0, 1.0, -1.0)
    y = PLANT.simulate(u, DT)
    return u, y + noise * random.standard_normal(samples)


def started() -> rp.Identifier:
    return rp.Identifier(rp.Structure(poles=2), DT)


def test_there_is_a_model_from_the_first_tens_of_samples_on() -> None:
    u, y = noisy(0, noise=0.0)
    ident = started()
    for k in range(499):
        ident.update(u[k], y[k])
        assert ident.has_model == (k >= 30)
    assert ident.status == "starting"
    np.testing.assert_allclose(ident.parameters, TRUE, rtol=1e-8)


@pytest.mark.parametrize("stamped", [False, True])
def test_a_chunk_shows_what_single_samples_show(stamped: bool) -> None:
    u, y = noisy(1, 520)
    t = DT * np.arange(u.size) if stamped else None
    ident = started()
    rows = []
    for k in range(u.size):
        ident.update(u[k], y[k], None if t is None else t[k])
        rows.append(ident.parameters)
    trace = started().update_many(u, y, t)
    np.testing.assert_array_equal(trace.parameters, rows)
    sizes = [next_provisional(ident.request, 0)]
    while sizes[-1] < 499:
        sizes.append(next_provisional(ident.request, sizes[-1]))
    renewed = 1 + np.flatnonzero(np.diff(trace.parameters[:499], axis=0).any(axis=1))
    assert renewed.size > len(sizes) / 2
    assert set(renewed) <= {size - 1 for size in sizes}


def test_nothing_later_depends_on_it() -> None:
    u, y = noisy(2)
    watched, left_alone = started(), started()
    for k in range(u.size):
        watched.update(u[k], y[k])
        left_alone.update(u[k], y[k])
        if k % 7 == 0:
            assert np.isfinite(watched.covariance).all() == watched.has_model
        if k in (100, 400, 600):
            assert watched.to_bytes() == left_alone.to_bytes()


def test_none_is_solved_for_that_nobody_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []

    def counted(structure: rp.Structure, record: Record, *given: Any) -> Solution | None:
        sizes.append(record.count)
        return solve(structure, record, *given)

    monkeypatch.setattr(startup, "solve", counted)
    u, y = noisy(7)
    ident = started()
    trace = ident.update_many(u, y)
    assert sizes == [500]
    assert ident.settings is not None
    assert trace.parameters.any()
    assert len(sizes) > 5


@pytest.mark.slow
@every("seed, noise, startup", [(8, 0.05, 300), (9, 0.5, 60)])
def test_a_trace_that_is_read_late_is_what_one_read_at_once_is(seed: int, noise: float, startup: int) -> None:
    """With outputs that are missing, and an input that was misread, so that samples go again when the start-up ends."""
    u, y = noisy(seed, 900, noise)
    y[np.random.default_rng(seed).random(y.size) < 0.1] = np.nan
    u[0] = 1e5
    ends = [0, 70, 71, 200, 520, 900]
    late, at_once = (rp.Identifier(rp.Structure(poles=2), DT, startup=startup) for _ in range(2))
    traces = [late.update_many(u[a:b], y[a:b]) for a, b in itertools.pairwise(ends)]
    for trace, (a, b) in zip(traces, itertools.pairwise(ends), strict=True):
        one = at_once.update_many(u[a:b], y[a:b])
        for name in ("start", "parameters", "errors"):
            np.testing.assert_array_equal(getattr(trace, name), getattr(one, name))
    assert late.rejected["input leap"] == 1
    assert late.to_bytes() == at_once.to_bytes()


def test_a_continued_start_up_has_the_same_model() -> None:
    u, y = noisy(3)
    ident = started()
    ident.update_many(u[:300], y[:300])
    again = rp.Identifier.from_bytes(ident.to_bytes())
    np.testing.assert_array_equal(again.parameters, ident.parameters)
    np.testing.assert_array_equal(again.covariance, ident.covariance)


def test_the_verdict_says_what_it_is() -> None:
    u, y = noisy(4)
    ident = started()
    ident.update_many(u[:130], y[:130])
    verdict = ident.assess()
    assert verdict.status == "converging"
    assert verdict.reasons[1] == "the present model is provisional: it is made from 125 samples and tested on none"
    assert verdict.uncertainty > 0.0


def test_a_start_up_that_does_not_suffice_is_not_silent() -> None:
    """With noise as large as the output 60 samples tell nothing: the start-up doubles, and the model with it."""
    u, y = noisy(5, 4000, noise=1.0)
    ident = rp.Identifier(rp.Structure(poles=2), DT, startup=60)
    trace = ident.update_many(u, y)
    assert ident.settings is not None
    assert ident.settings.startup > 60
    assert trace.parameters[60:].any(axis=1).all()


@pytest.mark.slow
def test_it_is_as_uncertain_as_it_says() -> None:
    """Over 60 records, 3 coefficients each: of 180 normalised errors 0.5 exceed 3 by chance, more than 5 never."""
    far = 0
    for seed in range(100, 160):
        u, y = noisy(seed, 300)
        ident = started()
        ident.update_many(u, y)
        far += int((np.abs(ident.parameters - TRUE) > 3.0 * ident.uncertainty.std).sum())
    assert far <= 5


@pytest.mark.parametrize("settings", [{"optimizer": "adam"}, {"instruments": False}])
def test_a_method_that_noise_biases_has_none(settings: dict[str, object]) -> None:
    u, y = noisy(6)
    ident = rp.Identifier(rp.Structure(poles=2), DT, **settings)
    ident.update_many(u[:400], y[:400])
    assert not ident.has_model
    assert not ident.parameters.any()


def test_an_input_at_rest_gives_none() -> None:
    ident = started()
    ident.update_many(np.ones(400), np.random.default_rng(0).standard_normal(400))
    assert not ident.has_model
    assert np.isnan(ident.covariance).all()


@every("startup", [1, 24, 60, 500, 20_000])
def test_each_is_solved_for_with_twice_the_samples_at_most_and_late_ones_with_a_quarter_more(startup: int) -> None:
    request = rp.Identifier(rp.Structure(poles=2), DT, startup=startup).request
    sizes = [next_provisional(request, 0)]
    while sizes[-1] < 20_000:
        sizes.append(next_provisional(request, sizes[-1]))
    assert request.least_startup <= sizes[0] < 2 * request.least_startup
    assert all(1.1 < later / earlier < 2.1 for earlier, later in itertools.pairwise(sizes))
    late = [size for size in sizes if 2 * size >= request.first_hold]
    assert all(later / earlier < 1.3 for earlier, later in itertools.pairwise(late))
    assert request.first_hold in sizes
