"""Lines: a stream of bytes is split into whole lines; a line that never ends takes no memory."""

from __future__ import annotations

from collections import Counter

import numpy as np

LONGEST = 1 << 16  # the longest line; a longer one is skipped [bytes]


class LineSplitter:
    r"""Splits one stream into lines.

    >>> lines = LineSplitter(Counter())
    >>> lines.split(b"1,2\n3,"), lines.split(b"4\n5,6"), lines.rest()
    (b'1,2\n', b'3,4\n', b'5,6\n')
    """

    def __init__(self, counters: Counter[str], longest: int = LONGEST) -> None:
        self._counters = counters
        self._longest = longest
        self._tail = b""
        self._skipping = False  # bytes are skipped until the next line begins
        self._midway = False  # the line being skipped has not been counted yet

    def split(self, data: bytes) -> bytes:
        """Return the lines that ``data`` completes, each with its line end."""
        if self._skipping:
            skipped, end, data = data.partition(b"\n")
            counted = self._midway and bool(skipped.strip())
            if counted:
                self._counters["cut off"] += 1
            self._skipping = not end
            self._midway = self._midway and not end and not counted
        last = data.rfind(b"\n") + 1
        complete = self._tail + data[:last] if last else b""
        tail = data[last:] if last else self._tail + data
        if len(tail) > self._longest:
            self._counters["too long"] += 1
            self._skipping, tail = True, b""
        self._tail = tail
        return self._without_long(complete)

    def _without_long(self, block: bytes) -> bytes:
        if len(block) <= self._longest + 1:
            return block
        ends = np.flatnonzero(np.frombuffer(block, np.uint8) == ord("\n"))
        if np.diff(ends, prepend=-1).max() <= self._longest + 1:
            return block
        lines = [line + b"\n" for line in block[:-1].split(b"\n")]
        kept = [line for line in lines if len(line) <= self._longest + 1]
        self._counters["too long"] += len(lines) - len(kept)
        return b"".join(kept)

    def rest(self) -> bytes:
        """Return the last line, which ended with the stream."""
        tail, self._tail = self._tail, b""
        return tail + b"\n" if tail.strip() else b""

    def restart(self) -> None:
        """Start again at the beginning of a line; an unfinished line is dropped and counted as "cut off"."""
        if self._tail.strip():
            self._counters["cut off"] += 1
        self._tail, self._skipping, self._midway = b"", False, False

    def restart_midway(self) -> None:
        """Start again in the middle of a line; the rest of that line is skipped."""
        self.restart()
        self._skipping = self._midway = True
