"""Sweeps: a function or a grid of settings on many records, with the same results on every executor."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

import replant as rp
from replant.errors import ArgumentTypeError, InvalidArgumentError
from replant.paper.tables import TABLES, reproduce
from support.cases import every
from support.dying import refuse
from support.fleets import DT, recorded


@pytest.mark.parametrize("executor", [None, "threads:3", "processes:2"])
def test_results_come_in_the_order_of_the_records(executor: str | None) -> None:
    seen: list[tuple[int, int]] = []
    found = rp.fleet.sweep(math.sqrt, range(9), executor, lambda done, of: seen.append((done, of)))
    assert found == [math.sqrt(k) for k in range(9)]
    assert seen == [(k, 9) for k in range(1, 10)]


@every(
    ("function", "records", "executor", "error", "says"),
    [
        (math.sqrt, [1.0, -1.0], "threads:2", ValueError, "math domain error|nonnegative"),
        (refuse, [1], "processes:1", RuntimeError, "UnsendableError: bad record 1"),
        (lambda record: record, [1], "processes:1", InvalidArgumentError,
         "define it at the top of a module, or use threads:N"),
    ],
    ids=["what it raises", "an error that cannot be sent", "a function that cannot be sent"],
)  # fmt: skip
def test_what_the_function_raises_is_raised(
    function: Callable[[Any], object], records: list[Any], executor: str, error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        rp.fleet.sweep(function, records, executor)


def test_ctrl_c_does_not_wait_for_what_is_being_done() -> None:
    def interrupt(done: int, of: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rp.fleet.sweep(time.sleep, [0.0, 3600.0], "processes:1", interrupt)


def test_an_error_ends_the_processes_without_another_word(capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(RuntimeError, match=r"bad record [01]"):
        rp.fleet.sweep(refuse, range(50), "processes:2")
    threads = [thread for thread in threading.enumerate() if "ExecutorManager" in type(thread).__name__]
    for thread in threads:
        thread.join()
    assert capfd.readouterr().err == ""


def test_every_setting_is_run_on_every_record() -> None:
    records = [(each.u, each.y, DT) for each in (recorded(0, 300), recorded(1, 300))]
    found = rp.fleet.sweep({"poles": [1, 2], "zeros": [0]}, records, "threads:2")
    assert [(dict(each.settings)["poles"], each.record) for each in found] == [(1, 0), (1, 1), (2, 0), (2, 1)]
    alone = rp.run(*records[1], poles=2)
    assert found[3].model.parameters.tolist() == alone.parameters.tolist()


def test_a_setting_that_cannot_be_run_is_a_trial_with_its_problem() -> None:
    record = recorded(0)
    (found,) = rp.fleet.sweep({"poles": [1], "zeros": [3]}, [(record.u, record.y, DT)])
    assert found.model is None
    assert "zeros must be fewer than poles" in found.problem


@every(
    ("grid", "error", "says"),
    [
        ({}, InvalidArgumentError, "the grid is empty"),
        ({"poles": 2}, InvalidArgumentError, "the grid's poles must be a sequence"),
        ({"optimizer": "adam"}, InvalidArgumentError, "the grid's optimizer must be a sequence"),
        (3, ArgumentTypeError, "a function or a grid of settings, got int"),
    ],
)
def test_invalid_grids_are_refused(grid: object, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        rp.fleet.sweep(grid, [])


def test_the_article_s_seeds_give_the_same_digits_on_every_executor() -> None:
    table, counts = TABLES["table2"], {None: 0, "threads:2": 0}
    found = []
    for executor in counts:

        def count(of: object = executor) -> None:
            counts[of] += 1

        found.append(reproduce(table, seeds=3, on_row=count, executor=executor))
    assert found[0] == found[1]
    assert set(counts.values()) == {len(table.rows)}
