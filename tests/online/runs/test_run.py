"""A run over a record of any length: however it comes, the result is the same."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

import replant as rp
from replant.estimation.settings import Request
from replant.numerics.robust import flags_of
from replant.online.runs import run
from replant.online.runs.result import Result
from replant.online.runs.run import run_online, run_source
from replant.online.runs.run_log import compare
from replant.signals import prbs
from replant.verdict import fit_percent
from support.cases import every
from support.loops import closed_loop

DT = 0.05
PLANT = rp.TransferFunction([3.0, 6.0], [1.0, 1.6, 4.0])
STRUCTURE = rp.Structure(poles=2, zeros=1)


@dataclass
class Parts:
    """A source that gives its samples a few at a time."""

    u: np.ndarray
    y: np.ndarray
    size: int
    passes: int = 0

    @property
    def samples(self) -> int:
        return self.u.size

    @property
    def complete(self) -> bool:
        return bool(np.isfinite(self.u).all() and np.isfinite(self.y).all())

    def batches(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        self.passes += 1
        for begin in range(0, self.u.size, self.size):
            yield self.u[begin : begin + self.size], self.y[begin : begin + self.size]


def record(samples: int = 6000) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.choice([-1.0, 1.0], samples // 20), 20)
    y = PLANT.simulate(u, DT) + 5.0 + 0.02 * rng.standard_normal(samples)
    y[2000:2010] = np.nan
    return u, y


def assert_same(one: Result, other: Result) -> None:
    np.testing.assert_array_equal(one.parameters, other.parameters)
    np.testing.assert_array_equal(one.covariance, other.covariance)
    assert (one.one_step, one.simulation.fit) == (other.one_step, other.simulation.fit)
    assert (one.simulation.offset, one.samples) == (other.simulation.offset, other.samples)
    assert (one.rejected, one.verdict.status) == (other.rejected, other.verdict.status)
    assert one.verdict.reasons == other.verdict.reasons
    assert one.settings == other.settings
    assert one.history is not None
    assert other.history is not None
    np.testing.assert_array_equal(one.history.samples, other.history.samples)
    np.testing.assert_array_equal(one.history.parameters, other.history.parameters)
    np.testing.assert_array_equal(one.history.std, other.history.std)


@pytest.mark.slow
@every("optimizer", ["auto", "amsgrad"])
@every("size", [333, 1, 3000], quick=1)
@every("fitted", [1000, 1 << 18], quick=1)
def test_the_size_of_the_batches_does_not_matter(
    monkeypatch: pytest.MonkeyPatch, size: int, fitted: int, optimizer: str
) -> None:
    """To the bit."""
    monkeypatch.setattr(run, "FITTED", fitted)
    monkeypatch.setattr(run, "CHUNK", 100)
    u, y = record(3000)
    request = Request(STRUCTURE, DT, preprocess=rp.Preprocess("identity", "mean", "mean"), optimizer=optimizer)
    whole = run_online(request, u, y)
    source = Parts(u, y, size)
    parts = run_source(request, source)
    assert_same(whole, parts)
    np.testing.assert_array_equal(whole.simulation.output, parts.simulation.output)
    assert source.passes == (2 if optimizer == "auto" else 3)


@pytest.mark.slow
def test_of_a_record_too_long_to_be_held_the_newest_samples_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "FITTED", 1000)
    u, y = record(3000)
    request = Request(STRUCTURE, DT)
    whole, part = run_online(request, u, y), run_source(request, Parts(u, y, 700), newest=1500)
    assert_same(whole, part)
    np.testing.assert_array_equal(part.simulation.output, whole.simulation.output[-1500:])
    assert whole.overview is None
    assert part.overview is not None
    np.testing.assert_array_equal(part.overview.newest_output, y[-1500:])
    assert part.overview.samples == 3000


def test_every_sample_goes_to_the_sink_and_to_the_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "FITTED", 1000)
    u, y = record(3000)
    traces: list[rp.Trace] = []
    seen: dict[str, list[int]] = {"identifying": [], "testing": []}
    request = Request(STRUCTURE, DT)
    run_source(request, Parts(u, y, 700), lambda stage, done: seen[stage].append(done), traces.append)
    expected = rp.Identifier(STRUCTURE, DT, startup=300).update_many(u, y, DT * np.arange(3000))
    np.testing.assert_array_equal(np.concatenate([trace.parameters for trace in traces]), expected.parameters)
    np.testing.assert_array_equal(np.concatenate([trace.errors for trace in traces]), expected.errors)
    for counts in seen.values():
        assert counts[-1] == 3000
        assert (np.diff(counts) > 0).all()


@pytest.mark.slow
def test_the_start_up_of_a_long_record_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "LONGEST_STARTUP", 400)
    u, y = record()
    settings = run_online(Request(STRUCTURE, DT), u, y).settings
    assert settings is not None
    assert settings.startup == 400


def test_choices_of_a_long_record_are_made_from_its_beginning(monkeypatch: pytest.MonkeyPatch) -> None:
    u, y = record()
    request = Request(STRUCTURE, DT, optimizer="gradient")
    monkeypatch.setattr(run, "SETTLED", 3000)
    part = run_online(request, u, y).settings
    y[3000:] *= 100.0
    assert run_online(request, u, y).settings == part


def test_with_a_start_up_of_ones_own_it_is_what_would_have_been_live() -> None:
    u, y = record()
    request = Request(STRUCTURE, DT)
    live = rp.Identifier(STRUCTURE, DT, startup=700)
    live.update_many(u, y, DT * np.arange(6000))
    result = run_online(request, u, y, startup=700)
    np.testing.assert_array_equal(result.parameters, live.parameters)
    assert result.settings == live.settings


def test_samples_that_are_missing_take_their_time() -> None:
    plant, structure = rp.TransferFunction([2.0], [1.0, 0.5]), rp.Structure(poles=1)
    u, generator = prbs(5000, hold=10), np.random.default_rng(0)
    y = plant.simulate(u, dt=0.1) + 0.02 * generator.standard_normal(5000)
    y[generator.random(5000) < 0.1] = np.nan
    result = run_online(Request(structure, 0.1), u, y)
    np.testing.assert_allclose(result.parameters, [0.5, 2.0], rtol=0.02)  # 7 % were a gap closed up
    lost = result.rejected["not finite"] + result.rejected["no output"]  # in the start-up, and later
    assert lost == int(np.isnan(y).sum())


@pytest.mark.slow
@pytest.mark.parametrize("startup", [None, pytest.param(500, marks=pytest.mark.slow)])
def test_bridged_and_missing_samples_take_no_part_in_the_fits(startup: int | None) -> None:
    u, y = record()
    whole = run_online(Request(STRUCTURE, DT), u, y, startup=startup)
    stuck = y.copy()
    stuck[4000:4600] = stuck[4000]
    stuck[3000] += 100.0
    found = run_online(Request(STRUCTURE, DT), u, stuck, startup=startup)
    left_out = flags_of(found.left_out, 0, u.size)
    assert left_out[2000:2010].all()  # no output
    assert left_out[3000]
    assert left_out[4000:4600].mean() > 0.9
    assert left_out.sum() < 630
    assert found.simulation.fit == pytest.approx(whole.simulation.fit, abs=0.5)
    assert found.simulation.offset == pytest.approx(whole.simulation.offset, abs=0.01)
    assert found.one_step == pytest.approx(whole.one_step, abs=0.5)
    np.testing.assert_array_equal(np.isnan(found.residual(stuck)), left_out)
    known = np.where(left_out, np.nan, stuck)
    assert found.simulation.fit == pytest.approx(fit_percent(known, found.simulation.output), abs=1e-6)


@pytest.mark.slow
def test_what_is_left_out_does_not_depend_on_how_the_record_comes() -> None:
    u, y = record()
    y[4000:4600] = y[4000]
    one, other = (
        run_online(Request(STRUCTURE, DT), u, y),
        run_source(Request(STRUCTURE, DT), Parts(u, y, 77), newest=500),
    )
    np.testing.assert_array_equal(flags_of(one.left_out, 0, u.size), flags_of(other.left_out, 0, u.size))
    assert one.left_out_over_time(DT)[-1, 1] == pytest.approx(4600 * DT)


@pytest.mark.slow
def test_the_output_of_a_model_that_would_run_away_is_predicted_as_by_a_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also over a record of many pieces, of which the last is a single sample, and with outputs missing."""
    rng = np.random.default_rng(0)
    r, noise = np.repeat(rng.uniform(-1.0, 1.0, 15), 40), 0.002 * rng.standard_normal(600)
    u, y = closed_loop([1.0], [1.0, -0.1], (1.0, 0.0), 0.1, r, np.zeros(600), noise)
    fitted, result = rp.fit(u, y, 0.1, rp.Structure(1)), run_online(Request(rp.Structure(1), 0.1), u, y)
    assert result.simulation.how == fitted.simulation.how == "predicted from input and past output"
    assert result.simulation.fit == pytest.approx(fitted.simulation.fit, abs=0.01)
    monkeypatch.setattr(run, "FITTED", 200)
    monkeypatch.setattr(run, "PIECE", 199)
    y[300:305] = np.nan
    pieces = run_online(Request(rp.Structure(1), 0.1), u, y)
    assert pieces.simulation.is_prediction
    assert pieces.simulation.fit == pytest.approx(fitted.simulation.fit, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("at", [[100, 700], pytest.param([1400], marks=pytest.mark.slow)])
def test_inputs_that_were_misread_do_not_drive_the_second_pass(at: list[int]) -> None:
    u, y = record(1500)
    seen = u.copy()
    seen[at] = 9999.0
    found, right = (rp.run(each, y, DT, poles=PLANT.den.size - 1) for each in (seen, u))
    assert found.rejected["input leap"] == len(at)
    assert found.simulation.fit == pytest.approx(right.simulation.fit, abs=0.2)
    assert found.model.output_level == pytest.approx(right.model.output_level, abs=0.2)


def test_methods_on_the_same_record() -> None:
    u = np.where(np.arange(2000) // 50 % 2 == 0, 1.0, -1.0)
    y = rp.TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    found = compare(Request(rp.Structure(poles=1), 0.1), u, y, ["default", "srivc"])
    assert [each.name for each in found] == ["default", "srivc"]
    for each in found:
        assert each.result is not None
        assert each.result.parameters == pytest.approx([0.5, 2.0])
