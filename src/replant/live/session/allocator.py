"""Allocator: a setting of the C library's malloc that keeps memory from growing over days."""

from __future__ import annotations

import contextlib
import ctypes

M_MMAP_THRESHOLD = -3  # name of the setting in malloc.h [number]

THRESHOLD = 1 << 17
"""Size from which on a block is given back to the system at once: glibc's initial value, which it raises as blocks of
different sizes come and go [bytes].
"""


def limit_heap_growth() -> None:
    """Have the C library map blocks of 128 KiB and more one by one, and return them when they are freed.

    Otherwise blocks of lines and samples, whose sizes vary, leave holes in the heap: at hundreds of thousands of
    samples a second it grows by some megabytes a minute until it has found its size.  Without glibc this has no effect.

    Examples
    --------
    >>> limit_heap_growth()
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, THRESHOLD)
