"""Coordinate: tasks given to workers, few at a time, again where a worker died; how far the fleet is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from dataclasses import dataclass
from typing import Any, TypeVar

from replant.errors import SystemRefusedError
from replant.fleet.executors import Workers

MOST_WAITING = 1024
"""Tasks that are with the workers at a time: enough for a large cluster, without all of them in memory [count]."""
MOST_LOST = 3
"""How often in a row all workers of a pool may die without a task done: then one of the tasks kills them [count]."""

T = TypeVar("T")
R = TypeVar("R")


def carried_out(workers: Workers, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[tuple[int, R]]:
    """Yield the number of each task and what came of it, in the order in which they end.

    >>> from replant.fleet.executors import workers
    >>> with workers(None) as found:
    ...     list(carried_out(found, abs, [-1, -2]))
    [(0, 1), (1, 2)]
    """
    queue = enumerate(tasks)
    again: list[tuple[int, T]] = []
    running: dict[Future[R], tuple[int, T]] = {}
    lost = 0
    try:
        while True:
            try:
                _fill(workers, function, queue, again, running)
            except BrokenExecutor as error:
                workers, lost = _renewed(workers, error, lost)
                continue
            if not running:
                return
            ended, _ = wait(running, return_when=FIRST_COMPLETED)
            broken: BaseException | None = None  # why a worker died
            for future in sorted(ended, key=lambda each: running[each][0]):
                number, task = running.pop(future)
                raised = CancelledError() if future.cancelled() else future.exception()
                if isinstance(raised, BrokenExecutor) or _is_lost(raised):
                    again.append((number, task))
                    broken = raised
                    continue
                lost = 0
                yield number, future.result()
            if broken is not None:
                again += running.values()
                running.clear()
                workers, lost = _renewed(workers, broken, lost)
    finally:
        for future in running:
            future.cancel()


def _fill(
    workers: Workers,
    function: Callable[[T], R],
    queue: Iterator[tuple[int, T]],
    again: list[tuple[int, T]],
    running: dict[Future[R], tuple[int, T]],
) -> None:
    """Give workers tasks until enough wait."""
    while len(running) < MOST_WAITING:
        entry: Any = again.pop() if again else next(queue, None)
        if entry is None:
            return
        try:
            running[workers.executor.submit(function, entry[1])] = entry
        except BrokenExecutor:
            again += [entry, *running.values()]
            running.clear()
            raise


def _is_lost(error: BaseException | None) -> bool:
    """Return whether an error says that a worker of Dask died, by the error's name: Dask may not be installed."""
    return type(error).__name__ in ("KilledWorker", "CancelledError", "FutureCancelledError")


def _renewed(workers: Workers, error: BaseException, lost: int) -> tuple[Workers, int]:
    if workers.renew is None:
        raise SystemRefusedError(
            f"the workers died ({type(error).__name__}): start them again, with more memory each if they lacked "
            "it, and then this; what is done stays done"
        ) from error
    if lost >= MOST_LOST:
        raise SystemRefusedError(
            f"the workers died {lost + 1} times in a row without a task done: give fewer of them (--on), so that each "
            "has more memory; what is done stays done"
        ) from error
    return workers.renew(), lost + 1


@dataclass(frozen=True)
class Progress:
    """How far a fleet is.

    Attributes
    ----------
    rigs, done, failed : int
        All rigs; those that are done, with those of an earlier run; how many of these failed in this run.
    samples : int
        Samples used in this run.
    part : float
        Part of the work that is done, by the plan, up to 1.
    """

    rigs: int
    done: int
    failed: int
    samples: int
    part: float
