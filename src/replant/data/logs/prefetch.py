"""Prefetch: the next blocks of a file are read and parsed while the caller uses the current one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def prefetch(jobs: Iterable[Callable[[], T]], workers: int) -> Iterator[T]:
    """Yield the results of ``jobs`` in their order, with ``workers`` + 1 jobs running or waiting.

    Threads suffice: reading, parsing and identification each release the interpreter's lock.

    Examples
    --------
    >>> list(prefetch((lambda k=k: k * k for k in range(5)), workers=2))
    [0, 1, 4, 9, 16]
    """
    pending: deque[Future[T]] = deque()
    pool = ThreadPoolExecutor(workers, "replant-read")
    try:
        for job in jobs:
            pending.append(pool.submit(job))
            if len(pending) > workers:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
    finally:
        # Never wait here: the garbage collector may end an abandoned generator in any thread, in one of the pool's too,
        # and at any place, also where that thread holds the locks of `threading`.
        pool.shutdown(wait=False, cancel_futures=True)
