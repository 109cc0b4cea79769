"""Memory: have it stay flat over days."""

from __future__ import annotations

import contextlib
import ctypes

M_MMAP_THRESHOLD = -3
"""Name of the setting in malloc.h [number]."""

THRESHOLD = 1 << 17
"""Size from which on a block is given back to the system at once; glibc begins with it, and raises it by itself as
blocks of different sizes come and go [bytes].
"""


def hold_flat() -> None:
    """Have the C library map blocks of 128 KiB and more one by one, and give them back when they are freed.

    Else blocks of lines and samples of ever new sizes leave holes in the heap, which grows by some megabytes a minute
    at hundreds of thousands of samples a second until it has found its size.  Without effect where there is no glibc.
    """
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, THRESHOLD)
