"""Executors: the workers of a fleet, and the distribution of tasks to them."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from typing import TypeVar

from replant.errors import InvalidArgumentError, SystemRefusedError, needs, shown
from replant.numerics.operating_system import THREADS, refusal, signals_blocked

MOST_WAITING = 1024  # most tasks submitted at a time: enough for a large cluster, and little memory [count]
MOST_LOST = 3  # most deaths of a pool in a row without a finished task; after more a task must be the cause [count]

#: Names of Dask's errors for the death of a worker: Dask may not be installed.
LOST = ("KilledWorker", "CancelledError", "FutureCancelledError")

T = TypeVar("T")
R = TypeVar("R")


def carried_out(workers: Workers, function: Callable[[T], R], tasks: Iterable[T]) -> Iterator[tuple[int, R]]:
    """Yield number and result of each task as it ends; a pool whose worker died is replaced, and its tasks repeated."""
    call = partial(_alone, function)
    with _one_thread():  # also here: the limits are global, and threads would restore them while others still run
        if workers.executor is None:
            yield from enumerate(map(call, tasks))
            return
        executor, lost = workers.executor, 0
        waiting = list(enumerate(tasks))[::-1]
        running: dict[Future[R], tuple[int, T]] = {}
        try:
            while waiting or running:
                death: BaseException | None = None
                try:
                    while waiting and len(running) < MOST_WAITING:
                        running[executor.submit(call, waiting[-1][1])] = waiting[-1]
                        waiting.pop()
                except BrokenExecutor as error:
                    death = error
                ended = wait(running, return_when=FIRST_COMPLETED)[0] if running and death is None else ()
                for future in sorted(ended, key=lambda each: running[each][0]):
                    raised = CancelledError() if future.cancelled() else future.exception()
                    if isinstance(raised, BrokenExecutor) or type(raised).__name__ in LOST:
                        death = raised
                        continue
                    lost = 0
                    yield running.pop(future)[0], future.result()
                if death is not None:
                    waiting += running.values()
                    running.clear()
                    executor, lost = _renewed(workers, death, lost), lost + 1
        finally:
            for future in running:
                future.cancel()


def _alone(function: Callable[[T], R], task: T) -> R:
    with _one_thread():
        return function(task)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Limit linear algebra to one thread, as sums depend on their number; without threadpoolctl do nothing."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError):
            from threadpoolctl import threadpool_limits

            stack.enter_context(threadpool_limits(1))
        yield


def _renewed(workers: Workers, error: BaseException, lost: int) -> Executor:
    if workers.renew is None:
        raise SystemRefusedError(
            f"the workers died ({type(error).__name__}): restart them, with more memory each if they lacked it, and "
            "repeat the call; finished rigs are kept"
        ) from error
    if lost >= MOST_LOST:
        raise SystemRefusedError(
            f"the workers died {lost + 1} times in a row without a finished task: use fewer (--on), so that each has "
            "more memory; finished rigs are kept"
        ) from error
    return workers.renew()


@dataclass(frozen=True)
class Progress:
    """The progress of a fleet."""

    rigs: int  # all rigs
    done: int  # finished rigs, including those of an earlier run
    failed: int  # rigs that failed in this run
    samples: int  # samples used in this run
    part: float  # finished part of the planned work, up to 1


PATIENCE = 30.0  # timeout of a Dask scheduler [s]
RETRIES = 3  # most times that Dask moves a task to another worker after its worker died [count]
_FORMS = "threads:N, processes:N or dask://HOST:PORT"


@dataclass(frozen=True, eq=False)
class Workers:
    """An executor, and a function that replaces it after its workers died."""

    executor: Executor | None  # None: this thread
    renew: Callable[[], Executor] | None = None  # None if the executor is the caller's


@contextmanager
def workers(on: Executor | str | None) -> Iterator[Workers]:
    """Open an executor for the ``with`` block; the caller's own executor stays open."""
    if not isinstance(on, str):
        if on is not None and not callable(getattr(on, "submit", None)):
            raise InvalidArgumentError(f"executor must be {_FORMS}, or a concurrent.futures.Executor, got {shown(on)}")
        yield Workers(on)
        return
    kind, rest = parsed(on)
    if kind == "dask":
        with _dask(rest) as executor:
            yield Workers(executor)
    elif kind == "threads":
        with ThreadPoolExecutor(int(rest), "replant-fleet") as pool:
            yield Workers(pool)
    else:
        with contextlib.ExitStack() as stack:
            others = set(active_children())
            pools: list[ProcessPoolExecutor] = []

            def made() -> Executor:
                pools.append(stack.enter_context(processes(int(rest))))
                return pools[-1]

            try:
                yield Workers(made(), made)
            except KeyboardInterrupt:  # abandon running tasks without their results
                for started in pools:  # cancel first: a pool that breaks fails if it reports to cancelled tasks
                    started.shutdown(wait=False, cancel_futures=True)
                for process in set(active_children()) - others:
                    process.terminate()
                raise


def parsed(on: str) -> tuple[str, str]:
    """Return the kind of an executor, and the number of its workers or the address of its scheduler."""
    kind, _, rest = on.partition(":")
    if kind in ("threads", "processes") and rest.isdecimal() and int(rest) > 0:
        return kind, rest
    if kind == "dask" and rest.startswith("//") and rest[2:].rpartition(":")[2].isdecimal():
        return kind, rest[2:]
    raise InvalidArgumentError(f"{on!r} is not an executor; give {_FORMS} (executor, --on)")


def processes(count: int) -> ProcessPoolExecutor:
    """Return a pool of spawned processes with one thread each, which end with this one; a fork would lose threads."""
    with _one_thread_each():
        pool = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_end_with_parent)
        try:
            with signals_blocked(signal.SIGINT):
                started = [
                    pool.submit(os.getpid) for _ in range(count)
                ]  # starts all processes now, with this environment
            for future in started:
                future.result()
        except (BrokenExecutor, OSError) as error:
            pool.shutdown(cancel_futures=True)
            raise SystemRefusedError(
                f"{count} worker processes cannot be started ({refusal(error) or type(error).__name__}): use fewer; "
                "a script that starts processes must be a file, and needs: if __name__ == '__main__':"
            ) from error
    return pool


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Set the environment variables that limit the threads of new processes; those already set are kept."""
    added = [name for name in THREADS if name not in os.environ]
    os.environ.update(dict.fromkeys(added, "1"))
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)


def _end_with_parent() -> None:
    """End this process when its parent ends, even by a signal: otherwise it would wait for ever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in a terminal reaches both; the parent ends this process
    parent = parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


@contextmanager
def _dask(address: str) -> Iterator[Executor]:
    with needs("dask://... needs Dask", "cluster"):
        from distributed import Client
    try:
        client = Client(f"tcp://{address}", timeout=PATIENCE)
    except (OSError, ValueError) as error:
        raise SystemRefusedError(f"no Dask scheduler responds at {address}; start one with: dask scheduler") from error
    with client:
        yield client.get_executor(pure=False, retries=RETRIES)
