"""Workspace: memory for one large temporary array, which each thread keeps.

The system gives new memory page by page, and clears each: for a search in 30,000 samples that takes as long as the
search itself.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from replant.numerics.arguments import FloatArray

# 4 MB: the signals of a search in 30,000 samples with models of four poles
KEPT = 1 << 19  # numbers of an array up to which its memory is kept [count]

_own = threading.local()


@contextmanager
def borrowed(rows: int, columns: int) -> Iterator[FloatArray]:
    """Lend an array (rows, columns) of any content; a call within, as of a signal handler, is lent another one."""
    size = rows * columns
    room = vars(_own).pop("room", None)
    if room is None or room.size < size:
        room = np.empty(size)
    try:
        yield room[:size].reshape(rows, columns)
    finally:
        if room.size <= KEPT:
            _own.room = room
