"""The accuracy benchmark: its records are what they say, its promises are checked right, and a few runs keep them.

Over n runs an estimator with the promised standard deviation s has a mean within 4 s / sqrt(n) of the truth but for one
figure in 16,000, and a sample variance below s^2 chi2 / (n - 1) as rarely.
"""

from __future__ import annotations

import csv
import doctest
import importlib
import math
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2

import replant as rp
from replant.estimation.engine.record import Record
from replant.estimation.solver.srivc import refine
from replant.numerics.batch_means import LEAST_BLOCKS
from support.cases import every
from support.places import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))

from accuracy import command, linear, records, report, results, scenarios, tracking, verdicts
from accuracy.bounds import Bound, statistics
from accuracy.methods import Offline, Online, figures_of
from accuracy.summary import summarise

EXPERIMENTS = scenarios.experiments()
RARE = 1.0 / 16_000
every_experiment = every("key", EXPERIMENTS)


# --- the records


def test_the_clean_output_at_any_instants_is_that_of_a_regular_clock() -> None:
    u = records.random_binary(np.random.default_rng(0), 300, 5)
    for plant in (records.PLANT_A, records.PLANT_B):
        at_instants = records.simulate_at(plant, 0.01 * np.arange(u.size), u)
        np.testing.assert_allclose(at_instants, plant.simulate(u, 0.01), rtol=0, atol=1e-12 * abs(plant.num).max())


def test_halving_an_interval_changes_nothing() -> None:
    t = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.1, 50))
    u = records.random_binary(np.random.default_rng(2), t.size, 1)
    finer_t = np.sort(np.concatenate([t, (t[1:] + t[:-1]) / 2]))
    finer_u = np.repeat(u, 2)[: finer_t.size]
    np.testing.assert_allclose(
        records.simulate_at(records.PLANT_A, finer_t, finer_u)[::2],
        records.simulate_at(records.PLANT_A, t, u),
        rtol=0,
        atol=1e-13,
    )


@pytest.mark.slow
def test_the_changing_plant_is_the_solution_of_its_equation() -> None:
    u = records.random_binary(np.random.default_rng(3), 200, 10)

    def slope(t: float, x: np.ndarray) -> list[float]:
        a1, a0 = 5.0 + 0.04 * t, 160.0 - 90.0 * math.cos(2 * math.pi * t / 1000.0)
        return [x[1], 200.0 * u[min(int(t / tracking.DT + 1e-9), u.size - 1)] - a1 * x[1] - a0 * x[0]]

    times = tracking.DT * np.arange(u.size)
    exact = solve_ivp(slope, (0, times[-1]), [0, 0], t_eval=times, rtol=1e-9, atol=1e-10, max_step=tracking.DT / 2)
    np.testing.assert_allclose(tracking.simulate(u), exact.y[0], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(tracking.parameters()[[0, -1]], [[5.0, 70.0, 200.0], [45.0, 70.0, 200.0]])


@pytest.mark.parametrize("colour", [0.0, 0.5, 0.9])
def test_noise_has_the_promised_power_and_colour(colour: float) -> None:
    clean = np.sin(np.arange(200_000.0))
    drawn = records.noise(np.random.default_rng(4), clean, 10.0, colour)
    effective = clean.size * (1 - colour) / (1 + colour)  # independent samples that tell as much
    assert drawn.var() / clean.var() == pytest.approx(0.1, rel=4 * math.sqrt(2 / effective))
    lag_one = drawn[1:] @ drawn[:-1] / (drawn @ drawn)
    assert lag_one == pytest.approx(colour, abs=4 / math.sqrt(effective))


def test_the_scenarios_inputs_are_as_long_as_they_say() -> None:
    a, b = EXPERIMENTS["A prbs"].record(0), EXPERIMENTS["B 10dB"].record(0)
    assert (a.u.size, b.u.size) == (2001, 7161)
    switches = np.flatnonzero(np.diff(b.u)) + 1
    assert (switches % 7 == 0).all()
    assert len(switches) == 511  # of a maximum-length sequence of 1023, half of the steps switch


def test_a_run_is_the_same_each_time_and_each_run_another() -> None:
    for experiment in (EXPERIMENTS["A random"], EXPERIMENTS["F unseen random-4"]):
        again, other = experiment.record(3), experiment.record(4)
        np.testing.assert_array_equal(experiment.record(3).y, again.y)
        assert not np.array_equal(again.y[:100], other.y[:100])


@pytest.mark.parametrize("unseen", [True, False])
def test_an_irregular_record_drops_and_jitters_as_told(unseen: bool) -> None:
    record = records.Irregular(hold=1, bits=0, switches_when_dropped=unseen)(0)
    assert record.t is not None
    assert record.u.size == pytest.approx(0.9 * 2001, abs=4 * math.sqrt(0.09 * 2001))
    intervals = np.diff(record.t)
    assert intervals.min() > 0.6 * 0.05
    steps = np.rint(np.concatenate([[0], record.t[1:] / 0.05]))
    assert np.abs(record.t - 0.05 * steps).max() <= 0.2 * 0.05
    clean = records.simulate_at(records.PLANT_A, record.t, record.u)
    power = float(np.var(record.y - clean) / np.var(clean))
    assert power > 0.15 if unseen else power == pytest.approx(0.1, rel=0.15)


# --- the experiments


@every_experiment
def test_promises_name_methods_and_figures_that_exist(key: str) -> None:
    experiment = EXPERIMENTS[key]
    assert experiment.scenario in scenarios.LETTERS
    assert experiment.counted <= experiment.runs
    for bound in experiment.bounds:
        assert bound.method in experiment.methods
        assert all(limit > 0 for limit in bound.limits.values())
        assert not experiment.truth or set(bound.limits) <= set(experiment.truth)
    assert set(experiment.covered) <= set(experiment.methods)


def test_the_runs_are_as_many_as_promised() -> None:
    runs = {key: EXPERIMENTS[key].runs for key in ("A prbs", "A random", "B 10dB", "B 0dB", "C hold-10")}
    assert runs == {"A prbs": 200, "A random": 200, "B 10dB": 200, "B 0dB": 100, "C hold-10": 12}
    assert EXPERIMENTS["B 10dB"].counted == 100


def test_the_truth_of_the_poles() -> None:
    a, b = EXPERIMENTS["A prbs"].truth, EXPERIMENTS["B 10dB"].truth
    radians = {name: math.tau * value for name, value in a.items() if name.startswith("f")}
    assert radians == pytest.approx({"f1": 1.0, "f2": 3.0, "f": math.sqrt(3.0)})
    assert a["zeta"] == pytest.approx(2 / math.sqrt(3))
    expected = {"f1": 2 / math.tau, "zeta1": 0.25, "f2": 20 / math.tau, "zeta2": 0.1}
    assert {name: b[name] for name in expected} == pytest.approx(expected)


def test_the_quadratics_standard_deviation_is_the_derivative() -> None:
    structure = rp.Structure(2)
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.0]])
    base, step = np.array([4.0, 3.0, 2.0]), 1e-6
    known = figures_of(rp.Uncertainty(structure, base, covariance))
    for name in ("f", "zeta"):
        slope = [
            (figures_of(rp.Uncertainty(structure, base + step * unit, covariance))[name][0]
             - known[name][0]) / step
            for unit in np.eye(3)
        ]  # fmt: skip
        assert known[name][1] == pytest.approx(math.sqrt(slope @ covariance @ slope), rel=1e-4)


# --- statistics and bounds


def test_a_run_without_an_estimate_breaks_every_promise_and_misses_the_truth() -> None:
    found = statistics([1.0, math.nan], [0.1, math.nan], truth=1.0, quantile=1.96)
    assert (found.failed, found.coverage) == (1, 50.0)
    assert not Bound("default", "bias", {"a0": 2.0}).is_met("a0", found)


def test_bounds_are_compared_with_what_they_name() -> None:
    found = statistics([9.0, 11.0, 13.0], [2.0] * 3, truth=10.0, quantile=1.96)
    assert found.coverage == 100.0
    measured = {"bias": 10.0, "std": 2.0, "near": 2.0, "standard errors": math.sqrt(0.75), "error": 30.0, "at most": 11}
    for kind, value in measured.items():
        assert Bound("m", kind, {"x": 1.0}).measured(found) == pytest.approx(value)
        assert Bound("m", kind, {"x": 1.1 * value}).is_met("x", found)
    assert not Bound("m", "bias", {"x": 9.0}).is_met("x", found)
    assert not Bound("m", "at least", {"x": 12.0}).is_met("x", found)


# --- a few runs


def few(key: str, runs: int) -> None:
    experiment = EXPERIMENTS[key]
    for name, method in {"online": Online(), "offline": Offline()}.items():
        found = [method(experiment.structure, experiment.dt, experiment.record(run)) for run in range(runs)]
        for figure, std in (linear.STD_A if key.startswith("A") else linear.STD_B).items():
            allowed = 1.3 * std
            values = np.array([figures[figure][0] for figures in found])
            assert abs(values.mean() - experiment.truth[figure]) < 4 * allowed / math.sqrt(runs), (name, figure)
            assert values.var(ddof=1) < allowed**2 * chi2.ppf(1 - RARE, runs - 1) / (runs - 1), (name, figure)
            # a standard deviation from the fewest blocks is itself known to a third: each run within four of that
            away = np.log([figures[figure][1] / std for figures in found])
            assert (abs(away) < 4.0 / math.sqrt(2.0 * LEAST_BLOCKS)).all(), (name, figure)
            assert abs(away.mean()) < 0.2, (name, figure)


@pytest.mark.slow
@pytest.mark.parametrize("key", ["A prbs", pytest.param("A random", marks=pytest.mark.slow)])
def test_scenario_a_on_a_few_runs(key: str) -> None:
    few(key, 40)


@pytest.mark.slow
def test_scenario_b_on_a_few_runs() -> None:
    few("B 10dB", 20)


@every("key", [key for key in EXPERIMENTS if key.startswith("E")], quick=3)
def test_scenario_e(key: str) -> None:
    experiment = EXPERIMENTS[key]
    summary = summarise(experiment, [experiment.run(0)])
    assert all(promise.is_met for promise in summary.promises)


@every("key", [key for key in EXPERIMENTS if key.startswith("I")], quick=1)
def test_recorded_logs_keep_what_the_page_says_is_kept(
    key: str, datasets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REPLANT_DATA", str(datasets))
    experiment = EXPERIMENTS[key]
    promises = summarise(experiment, [experiment.run(0)]).promises
    with (ROOT / "docs/accuracy/promises.csv").open(encoding="utf-8") as table:
        told = [row["kept"] for row in csv.DictReader(table) if row["experiment"] == key]
    assert ["yes" if promise.is_met else "no" for promise in promises] == told, promises


def test_of_the_recorded_logs_one_promise_is_broken_and_by_no_more_than_is_known() -> None:
    """The test above holds the table to what is measured; this one, that a renewed table is no way to break another.

    The published tau2 of the motor is that of a fit without a noise model, and less than half a sampling time: such a
    fit tells it to 17 % (standard deviation), so that 7 % are met by chance alone.  With the noise model, which the
    test of both keeps, it is told to 6 %, and the gain and tau1 follow another log by 69 % where those of the fit
    without it follow it by 64 %.
    """
    rows = [row for row in results.read(ROOT / "docs" / "accuracy")["promises"] if row["experiment"].startswith("I")]
    promised = {key for key in EXPERIMENTS if key.startswith("I") and EXPERIMENTS[key].bounds}
    assert {row["experiment"] for row in rows} == promised
    broken = {}
    for row in rows:
        for share, words in report._shares(row["promise"], row["measured"]):
            figure, value, *_ = words.split()
            if share < 1.0 if "at least" in row["promise"] else share > 1.0:
                broken[row["experiment"], figure] = float(value)
    known = {("I motor-second-order", "tau2"): 31.7}  # of 7 %
    assert broken == {figure: pytest.approx(value, rel=0.05) for figure, value in known.items()}
    assert [row["experiment"] for row in rows if row["kept"] == "no"] == [experiment for experiment, _ in known]


# --- verdicts


def test_the_cases_are_thirty_each_of_every_kind() -> None:
    kinds = [verdicts.wrong(number).kind for number in range(verdicts.CASES)]
    assert {kind: kinds.count(kind) for kind in verdicts.KINDS} == {
        kind: 4 if index < 6 else 3 for index, kind in enumerate(verdicts.KINDS)
    }
    for number in range(verdicts.CASES):
        for case in (verdicts.right(number), verdicts.wrong(number)):
            assert case.u.size == case.y.size == verdicts.SAMPLES
            assert np.isfinite(case.u).all()
            assert np.isfinite(case.y).all()


@every("rig", verdicts.RIGS, ids=lambda rig: str(rig.plant))
def test_the_plants_can_be_told_from_their_records(rig: verdicts.Rig) -> None:
    generator = np.random.default_rng(0)
    u = records.random_binary(generator, verdicts.SAMPLES, rig.hold)
    clean = rig.plant.simulate(u, rig.dt)
    y = clean + records.noise(generator, clean, 5.0)
    found = refine(rig.structure, Record(u - u.mean(), y - y.mean(), np.array([rig.dt])))
    assert found is not None
    assert found.converged
    assert found.uncertainty < 0.15


# --- the command


@pytest.mark.slow
def test_the_command_writes_a_page_its_tables_and_a_file(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert command.main(["--scenario", "E", "--runs", "1", "--on", "processes:1", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "accuracy.md").read_text(encoding="utf-8")
    assert "8 of 8 promises are kept" in page
    assert "default: each run within 0.1 %: " in page
    tables = results.read(tmp_path / "accuracy")
    assert {row["kept"] for row in tables["promises"]} == {"yes"}
    assert {row["experiment"] for row in tables["figures"]} == {key for key in EXPERIMENTS if key.startswith("E")}
    assert '"E order-4"' in (tmp_path / "accuracy.json").read_text(encoding="utf-8")
    assert "each run within" in capfd.readouterr().out


def test_a_run_of_some_scenarios_renews_their_rows_alone(tmp_path: Path) -> None:
    kept = results.read(ROOT / "docs" / "accuracy")
    results.write(kept, tmp_path / "accuracy")
    key = "E order-1"
    summary = summarise(EXPERIMENTS[key], [EXPERIMENTS[key].run(0)])
    measured = results.tabulated([summary], {})
    measured["promises"][0]["measured"] = "a0 0.05"
    command.write(measured, tmp_path, results.in_order(list(EXPERIMENTS)))
    renewed = results.read(tmp_path / "accuracy")
    for name, rows in kept.items():
        assert [row for row in renewed[name] if row["experiment"] != key] == [
            row for row in rows if row["experiment"] != key
        ]
        assert list(dict.fromkeys(row["experiment"] for row in renewed[name])) == list(
            dict.fromkeys(row["experiment"] for row in rows)
        )
    assert "default: each run within 0.1 %: a0 0.05 %\n" in (tmp_path / "accuracy.md").read_text(encoding="utf-8")


def test_the_page_is_made_of_the_tables_and_tells_what_is_not_kept() -> None:
    tables = results.read(ROOT / "docs" / "accuracy")
    page = (ROOT / "docs" / "accuracy.md").read_text(encoding="utf-8")
    assert page == report.page(tables)
    said = dict(re.findall(r"^\* (.+?): (.*)$", page, re.MULTILINE))
    broken = [row for row in tables["promises"] if row["kept"] == "no"]
    assert broken
    for row in broken:
        words = said[row["experiment"]]
        assert row["method"].split(",")[0] in words
        assert f": {report.figure_of(row)} " in words
        assert report.measured([(row["promise"], row["measured"])]) in words


def test_a_line_of_the_page_says_how_many_of_its_promises_are_kept() -> None:
    tables = results.read(ROOT / "docs" / "accuracy")
    rows = [row for row in tables["promises"] if row["experiment"].startswith("E")]
    nearest = re.search(r"default: each run within 0.1 %: (\S+) (\S+) %\n", report.page({"promises": rows}))
    assert nearest
    assert any(f"{nearest[1]} {nearest[2]}" in row["measured"] for row in rows)
    rows[0] |= {"kept": "no", "measured": "a0 0.2, b0 0.3"}
    page = report.page({"promises": rows})
    assert f"{len(rows) - 1} of {len(rows)} promises are kept" in page
    assert f"default: each run within 0.1 %: b0 0.3 % ({len(rows) - 1} of {len(rows)})\n" in page
    assert f"* {rows[0]['experiment']}: default: each run b0 0.3 %\n" in page


@pytest.mark.parametrize("name", ["bounds", "experiment", "report", "results"])
def test_examples_in_docstrings(name: str) -> None:
    module: ModuleType = importlib.import_module(f"accuracy.{name}")
    assert doctest.testmod(module).failed == 0
