"""sweep: a function, or every setting of a grid, on every record of a study, on any executor."""

from __future__ import annotations

import itertools
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from multiprocessing import parent_process
from typing import Any, TypeVar, overload

from replant.arguments import iterable
from replant.errors import ArgumentTypeError, InvalidArgumentError, ReplantError, shown
from replant.fleet.executors import carried_out, workers
from replant.fleet.work import one_thread
from replant.identified.model import Model
from replant.runs.run_log import run

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class Trial:
    """What one setting of a grid gives on one record.

    Attributes
    ----------
    settings : tuple of (str, object)
        Arguments of `replant.run`, by name.
    record : int
        Number of the record, from 0.
    model : Model or None
        None where the record could not be identified.
    problem : str
        Why not; empty where it could.
    """

    settings: tuple[tuple[str, Any], ...]
    record: int
    model: Model | None
    problem: str = ""


@overload
def sweep(
    function: Callable[[T], R],
    records: Iterable[T],
    executor: Executor | str | None = None,
    progress: Callable[[int, int], None] | None = ...,
) -> list[R]: ...


@overload
def sweep(
    function: Mapping[str, Sequence[Any]],
    records: Iterable[Any],
    executor: Executor | str | None = None,
    progress: Callable[[int, int], None] | None = ...,
) -> list[Trial]: ...


def sweep(
    function: Any,
    records: Iterable[Any],
    executor: Executor | str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Any]:
    """Call a function with every record, or run every setting of a grid on every record.

    The results do not depend on the executor, nor on the order in which the work ends.

    >>> sweep(abs, [-1, 2, -3], executor="threads:2")
    [1, 2, 3]
    >>> import numpy as np
    >>> from replant import TransferFunction
    >>> u = np.where(np.arange(1000) // 50 % 2 == 0, 1.0, -1.0)
    >>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    >>> for trial in sweep({"poles": [1, 2]}, [(u, y, 0.1)]):
    ...     print(trial.settings, trial.model.structure.poles)
    (('poles', 1),) 1
    (('poles', 2),) 2
    """
    if isinstance(function, Mapping):
        tasks: list[Any] = _trials(function, records)
        call: Callable[[Any], Any] = _tried
    elif callable(function):
        _check_sendable(function, executor)
        tasks, call = _listed(records), partial(_called, function)
    else:
        raise ArgumentTypeError(f"sweep needs a function or a grid of settings, got {type(function).__name__}")
    results: list[Any] = [None] * len(tasks)
    with workers(executor) as found, one_thread():
        for done, (number, result) in enumerate(carried_out(found, call, tasks), 1):
            results[number] = result
            if progress is not None:
                progress(done, len(tasks))
    return results


def _called(function: Callable[[T], R], record: T) -> R:
    with one_thread():
        try:
            return function(record)
        except Exception as error:
            if parent_process() is None or _travels(error):
                raise
            raise RuntimeError(f"{type(error).__name__}: {error}") from None  # as itself it would break the pool


def _travels(error: Exception) -> bool:
    """Return whether an error can be sent to another process: one whose arguments differ from its text often cannot."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return False
    return True


def _check_sendable(function: Any, executor: Executor | str | None) -> None:
    """Check that a function can be called by other processes."""
    if not (isinstance(executor, str) and executor.startswith("processes:")):
        return
    try:
        pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidArgumentError(
            f"the function cannot be sent to other processes ({error}): define it at the top of a module, or use "
            "threads:N"
        ) from error


def _listed(records: Iterable[T]) -> list[T]:
    if not iterable(records):
        raise ArgumentTypeError(f"records must be a sequence of records, got {type(records).__name__}")
    return list(records)


def _trials(grid: Mapping[str, Sequence[Any]], records: Iterable[Any]) -> list[tuple[dict[str, Any], int, Any]]:
    if not grid:
        raise InvalidArgumentError("the grid is empty: give the values to try by name, such as {'poles': [1, 2]}")
    for name, values in grid.items():
        if isinstance(values, str) or not isinstance(values, Sequence):
            raise InvalidArgumentError(
                f"the grid's {name} must be a sequence of the values to try, got {shown(values)}"
            )
    held = _listed(records)
    combined = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    return [(settings, number, record) for settings in combined for number, record in enumerate(held)]


def _tried(task: tuple[dict[str, Any], int, Any]) -> Trial:
    settings, number, record = task
    named = tuple(settings.items())
    try:
        with one_thread():
            result = run(*record, **settings) if isinstance(record, tuple) else run(record, **settings)
    except ReplantError as problem:
        return Trial(named, number, None, str(problem))
    return Trial(named, number, result.model)
