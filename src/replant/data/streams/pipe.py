"""Standard input: the lines that another program writes into the pipe."""

from __future__ import annotations

import os
import stat
import sys
import time

from replant.data.streams.address import Address
from replant.data.streams.lines import LineSplitter
from replant.data.streams.parser import Parser
from replant.data.streams.reader import Reader
from replant.errors import InvalidArgumentError

BLOCK = 1 << 18  # bytes taken at once at the most [bytes]


class PipeSource(Reader):
    """Lines from an open file, ``-`` for standard input.  While the queue is full nothing is read: the writer waits."""

    def __init__(self, name: str, file: int, columns: tuple[str, ...] | None = None) -> None:
        super().__init__(name, waits=True)
        self._file = file
        self._parser = Parser(self._counts, columns)

    def _read(self) -> None:
        self._connected(again=False)
        lines = LineSplitter(self._counts)
        # on POSIX select() also waits for pipes, on Windows for sockets only; a regular file is always readable
        waits = os.name == "posix" and not stat.S_ISREG(os.fstat(self._file).st_mode)
        while not self._stop.requested:
            if waits and not self._stop.wait_readable(self._file, 60.0):
                continue
            data = os.read(self._file, BLOCK)
            if not data:
                self._deliver(self._parser.parse(lines.rest(), time.monotonic()))
                break
            self._deliver(self._parser.parse(lines.split(data), time.monotonic()))
        self._deliver(self._parser.finish(time.monotonic()))


def open_pipe(address: Address, columns: tuple[str, ...] | None) -> PipeSource:
    """Return the source that reads standard input."""
    address.allow("columns")
    try:
        file = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        raise InvalidArgumentError("-: there is no standard input; pipe samples into the command") from None
    return PipeSource(address.name, file, columns)
