"""The small pieces of a fleet: names, words, digests, tasks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from replant.fleet.catalogue import find_rigs, is_log
from replant.fleet.executors import carried_out, parsed, workers
from replant.fleet.job import Job, Piece, Rig, Shape, digest, planned, printable, report_path, work_of
from replant.fleet.odd_rigs import _least_fit
from replant.fleet.statistics import Deviation, Quantity, _nearest, _ratio, located, quantities_of
from replant.fleet.store import schema
from replant.model.structure import Structure
from support.cases import every

PIECE = Piece("/logs/a.csv", "a.csv", size=2_400_000, modified=5)
WORDS: dict[Any, Any] = {
    report_path("hall 2/rig 7.csv"): "reports/hall-2-rig-7-csv-5b25fc.html",
    printable("rig \udcff.csv"): "rig \\udcff.csv",
    _ratio(2.143): "2.1",
    _ratio(1.052): "1.05",
    _ratio(1234.0): "1,234",
    (_ratio(99.0), _ratio(143.0)): ("99", "143"),
    Deviation(Quantity("time constant", ()), math.log(2.1), math.log(2.1) / 14, 0, 0.0).words(): (
        "time constant 2.1 times the fleet's median, 14 standard deviations"
    ),
    _nearest(math.log(0.001003), 0.01, False): "the gain is 1/1000 of the fleet's, nearly: a power of ten",
    _nearest(math.log(57.4), 0.01, False): ("the gain is 57.3 times the fleet's, nearly: degrees beside radians"),
    _nearest(math.log(0.53), 0.1, False): "",
    parsed("processes:4"): ("processes", "4"),
    parsed("dask://localhost:8786"): ("dask", "localhost:8786"),
    (is_log(Path("a.csv.gz")), is_log(Path("_a.csv")), is_log(Path("a.md"))): (True, False, False),
}


@every("got, expected", WORDS.items())
def test_texts_are_as_expected(got: Any, expected: Any) -> None:
    assert got == expected


def test_a_digest_tells_options_files_and_rigs_apart() -> None:
    assert Job("u", "y", Structure(2)).key != Job("u", "y", Structure(3)).key
    assert Rig("a.csv", (PIECE,)).fingerprint == Rig("a.csv", (PIECE,)).fingerprint
    assert digest(1) != digest(2)


def test_the_tasks_with_the_most_work_are_first() -> None:
    """Otherwise the largest task could be the last, and one worker would finish alone."""
    sizes = [100, 3, 40, 500, 7]
    rigs = [Rig(str(k), (Piece("a.csv", "a.csv", size=1_000_000 * size, modified=0),)) for k, size in enumerate(sizes)]
    works = [sum(map(work_of, task)) for task in planned(rigs)]
    assert works == sorted(map(work_of, rigs), reverse=True)
    assert work_of(Rig("of two", rigs[0].pieces + rigs[1].pieces)) == work_of(rigs[0]) + work_of(rigs[1]) - work_of(
        Rig("empty", ())
    )


def test_a_rig_is_printed_without_its_files() -> None:
    assert repr(Rig("a", (PIECE,))) == "Rig(name='a')"


def test_the_logs_of_a_folder_are_its_rigs(tmp_path: Path) -> None:
    for name in ("b.csv", "a.csv", "notes.md"):
        (tmp_path / name).write_text("t,u,y")
    assert [rig.name for rig in find_rigs(tmp_path, by="file")] == ["a.csv", "b.csv"]


def test_tasks_are_of_equal_work() -> None:
    assert work_of(Rig("a", (PIECE,))) == 200_000
    tasks = planned([Rig(f"{k:03}", ()) for k in range(128)])
    assert len(tasks) == 64
    assert [rig.name for rig in tasks[0]] == ["000", "001"]


def test_tasks_give_the_same_results_in_this_thread_and_in_others() -> None:
    for where in (None, "threads:2"):
        with workers(where) as found:
            assert sorted(carried_out(found, abs, [-1, -2])) == [(0, 1), (1, 2)]


def test_location_and_spread_are_robust_to_outliers() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(5.0, 2.0, (500, 1)) + rng.normal(0.0, 1.0, (500, 1))
    x[:20] = 100.0
    found = located(x, np.ones((500, 1, 1)))
    assert found.centre[0] == pytest.approx(5.0, abs=0.5)
    assert math.sqrt(found.spread[0, 0]) == pytest.approx(2.0, abs=0.5)


def test_the_fit_below_which_a_rig_is_poor() -> None:
    assert _least_fit(np.full(20, 95.0)) == pytest.approx(80.0)
    assert _least_fit(np.array([])) == -math.inf


def test_columns_and_quantities_follow_from_the_structure() -> None:
    assert [each.name for each in quantities_of(Shape((Structure(2, 1),)))] == [
        "gain", "natural frequency", "damping", "zero"
    ]  # fmt: skip
    names = [name for name in schema(Shape((Structure(1),))).names if "b0" in name or "pole" in name]
    assert names == ["b0", "b0_std", "pole1_real", "pole1_imag"]
