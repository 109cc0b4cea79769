"""A run over a record on an irregular clock: that of the identifier with the same stamps, and judged over real time."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import replant as rp
from replant.estimation.settings import Request
from replant.fitting.fit import fit
from replant.logs import open_recording, read_columns, read_log
from replant.model.state_space import Response
from replant.online.runs import run
from replant.online.runs.full_trace import FullTrace
from replant.online.runs.result import Result, result_of_fit
from replant.online.runs.run import run_online, run_source
from support.builders import DT, irregular_record, record, two_modes
from support.cases import every

STRUCTURE, PLANT = rp.Structure(2, 1), rp.TransferFunction([1.0, 4.0], two_modes(2.0, 0.5))
REQUEST = Request(STRUCTURE, DT, preprocess=rp.Preprocess("identity", "mean", "mean"))


def noisy(seed: int = 1, samples: int = 3000, dropped: float = 0.0) -> tuple[np.ndarray, ...]:
    """Input, output and stamps of a clock that jitters and may lose samples, noise on the output."""
    u, y, t = irregular_record(PLANT, seed, samples, DT, jitter=0.3, dropped=dropped, hold=8)
    return u, y + 0.05 * np.random.default_rng(seed).standard_normal(y.size), t


def with_gaps(seed: int = 2, samples: int = 3600) -> tuple[np.ndarray, ...]:
    """A record with a gap of fifty samples in 600, the input moving meanwhile."""
    u, y = record(PLANT, seed, samples, DT, noise=0.05)
    kept = np.arange(samples) % 600 >= 50
    return u[kept], y[kept], DT * np.arange(samples)[kept]


def as_csv(path: Path, u: np.ndarray, y: np.ndarray, t: np.ndarray, begin: float = 0.0) -> Path:
    rows = np.column_stack([t + begin, u, y])
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header="t,u,y", comments="")
    return path


@pytest.mark.slow
@every("startup", [None, 300], quick=1)
def test_a_run_over_a_file_is_the_identifier_with_the_same_stamps(tmp_path: Path, startup: int | None) -> None:
    """To the bit."""
    u, y, t = noisy(samples=1500, dropped=0.05)
    y[700] = np.nan
    path = as_csv(tmp_path / "log.csv", u, y, t)
    recording, log = (reader(path, input="u", output="y") for reader in (open_recording, read_log))
    request = dataclasses.replace(REQUEST, structure=STRUCTURE, dt=log.dt)
    result = run_source(request, recording, startup=startup, irregular=recording.irregular)
    held = startup or u.size // 10
    ident = rp.Identifier(**vars(dataclasses.replace(request, startup=held)))
    np.testing.assert_array_equal(log.stamps, t)
    ident.update_many(u, y, t)
    if startup is None:
        ident.finish()
    np.testing.assert_array_equal(result.parameters, ident.parameters)
    np.testing.assert_array_equal(result.covariance, ident.covariance)
    assert result.samples == ident.samples
    assert result.rejected == ident.rejected
    assert result.verdict.reasons == ident.assess().reasons


@pytest.mark.parametrize("make", [noisy, with_gaps])
def test_the_fits_of_a_run_are_those_of_the_model(make) -> None:
    """The score of a pass and the simulation of the whole record are made in two ways."""
    u, y, t = make()
    result = run_online(REQUEST, u, y, t=t)
    model = result.transfer_function
    assert result.settings is not None
    alone = rp.verdict.simulate(model, u - float(result.settings.preprocess.input_offset), y, DT, t=t)
    np.testing.assert_allclose(result.simulation.output, alone.output, atol=1e-9)
    noise_share = 100.0 * 0.05 / np.std(y)
    assert result.simulation.fit == pytest.approx(100.0 - noise_share, abs=2.0)
    assert result.one_step == pytest.approx(100.0 - noise_share, abs=2.0)
    assert result.verdict.status == "trusted"


@pytest.mark.slow
@every(("make", "size"), [(with_gaps, 100), (noisy, 777)])
def test_of_a_record_too_long_to_be_held_the_result_is_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, make, size: int
) -> None:
    u, y, t = make()
    path = as_csv(tmp_path / "log.csv", u, y, t, begin=30.0)
    whole, streamed = (open_recording(path, input="u", output="y", most_held=most_held) for most_held in (u.size, 0))
    assert streamed.held is None
    held = run_source(REQUEST, whole, irregular=True)
    passed = run_source(REQUEST, streamed, irregular=True, newest=size)
    np.testing.assert_array_equal(held.parameters, passed.parameters)
    assert held.simulation.fit == passed.simulation.fit
    assert passed.overview is not None
    assert passed.overview.newest_times is not None
    np.testing.assert_allclose(passed.overview.newest_times, (t - t[0])[-size:], atol=1e-9)
    newest = streamed.newest(*(getattr(passed.overview, f"newest_{name}") for name in ("input", "output", "times")))
    assert newest.duration == pytest.approx(t[-1] - t[0] + DT)
    assert passed.clock is not None
    assert passed.clock.duration(u.size) == pytest.approx(newest.duration)
    monkeypatch.setattr(run, "FITTED", size)  # batches end anywhere, also beside a gap
    monkeypatch.setattr(run, "PIECE", size)
    parts = run_source(REQUEST, streamed, irregular=True)
    assert parts.simulation.fit == pytest.approx(held.simulation.fit, abs=1.0)


def test_the_full_trace_has_the_stamps_of_the_log(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install 'replant[parquet]'")
    u, y, t = noisy(samples=1000)
    with FullTrace(tmp_path / "trace.parquet", DT) as trace:
        run_source(REQUEST, run.Arrays(u, y, None, t), sink=trace.take, irregular=True)
    np.testing.assert_array_equal(read_columns(tmp_path / "trace.parquet").column("time [s]"), t)


def test_methods_with_a_fixed_filter_choose_it_with_the_stamps() -> None:
    """Of a clock that loses a third of its samples, taken for regular, the cutoff and the model are nonsense."""
    u, y, t = irregular_record(PLANT, 3, 6000, DT, jitter=0.2, dropped=0.3, hold=20)
    adam = dataclasses.replace(REQUEST, optimizer="adam")
    stamped, plain = run_online(adam, u, y, t=t), run_online(adam, u, y)
    assert stamped.simulation.fit > 90.0
    assert stamped.simulation.fit > plain.simulation.fit + 10.0


def test_a_filter_of_the_article_needs_a_regular_clock() -> None:
    u, y, t = noisy(samples=600)
    request = dataclasses.replace(REQUEST, filter=rp.StateVariableFilter(4.0, method="gbt"), optimizer="adam")
    with pytest.raises(rp.InvalidArgumentError, match="gbt filter knows a regular clock only"):
        run_online(request, u, y, t=t)


@pytest.mark.parametrize("make", [noisy, with_gaps])
def test_the_result_of_a_fit_is_judged_and_drawn_over_real_time(make) -> None:
    u, y, t = make()
    fitted = fit(u, y, DT, STRUCTURE, preprocess=REQUEST.preprocess, t=t)
    result = result_of_fit(fitted, u, y, 0.0, t)
    assert result.verdict.status == "trusted"
    assert result.clock is not None
    assert result.clock.irregular
    np.testing.assert_allclose(result.clock.at(np.arange(u.size)), t - t[0], atol=1e-12)
    _check_shading(result, t)


def _check_shading(result: Result, t: np.ndarray) -> None:
    """Every gap of the record is shaded."""
    shaded = result.left_out_over_time(DT)
    for end in np.flatnonzero(np.diff(t) > 20 * DT) + 1:
        begin = t[end - 1] - t[0]
        assert (np.isclose(shaded[:, 0], begin) & np.isclose(shaded[:, 1], t[end] - t[0])).any()


def test_two_rates_contradict_no_sampling_time() -> None:
    """The record ends at the slower rate, which is not the usual one."""
    fast, slow = 2000, 1000
    t = np.cumsum(np.concatenate([np.full(fast, DT), np.full(slow, 5 * DT)]))
    u = np.repeat(np.random.default_rng(0).choice([-1.0, 1.0], 600), 5)
    y = Response(PLANT, 5 * DT).take(u, np.diff(t, prepend=0.0)).output
    y += 0.05 * np.random.default_rng(1).standard_normal(u.size)
    fitted = fit(u, y, DT, STRUCTURE, t=t)
    assert result_of_fit(fitted, u, y, 0.0, t).verdict.status == "trusted"
    assert run_online(REQUEST, u, y, t=t).verdict.status == "trusted"
