"""The complete trace of an online run as a Parquet file: one row for each sample, written during the run."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np

from replant.errors import LogError, MissingDependencyError
from replant.logs.arrow import CHECKED, SUFFIXES
from replant.numerics.operating_system import reason_of, replacing
from replant.online.trace import Trace, joined

GROUP_ROWS = 1 << 17  # rows of a row group, which are held until it is written [rows]


class FullTrace:
    """Writes the columns ``time [s]``, the parameters by name, and ``error``; leaves no file if its ``with`` fails."""

    def __init__(self, path: Path, dt: float) -> None:
        if path.suffix.lower() not in SUFFIXES:
            raise LogError(f"{path}: the full trace is a Parquet file; give it the suffix .parquet")
        try:
            import pyarrow.parquet  # noqa: F401 - raises before the run, not after it
        except ImportError as error:
            raise MissingDependencyError(f"{path}: writing needs pyarrow: pip install 'replant[parquet]'") from error
        if path.exists() and not _is_trace(path):
            raise LogError(f"{path}: it exists and is no full trace; give another name")
        self.path, self._dt = path, dt
        self._files, self._new = contextlib.ExitStack(), path
        self._held: list[Trace] = []
        self._rows = 0
        self._writer: Any = None

    def __enter__(self) -> FullTrace:
        with self._errors():
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._new = self._files.enter_context(replacing(self.path))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if kind is None:
            with self._errors(), self._files:
                self._write()
            return
        with contextlib.suppress(OSError):  # it may not be possible to close the file, as the disk is full
            self._files.__exit__(kind, error, traceback)

    def take(self, trace: Trace) -> None:
        """Take the trace of the next samples."""
        self._held.append(trace)
        if sum(map(len, self._held)) >= GROUP_ROWS:
            with self._errors():
                self._write()

    def _write(self) -> None:
        if not self._held:
            return
        import pyarrow
        from pyarrow import parquet

        whole = joined(self._held)
        clock = self._dt * np.arange(self._rows, self._rows + len(whole))
        columns: dict[str, Any] = {"time [s]": clock if whole.time is None else whole.time}
        columns |= {name: whole.parameters[:, i].copy() for i, name in enumerate(whole.names)}
        table = pyarrow.table({**columns, "error": whole.errors})
        if self._writer is None:
            self._writer = self._files.enter_context(parquet.ParquetWriter(self._new, table.schema, **CHECKED))
        self._writer.write_table(table)
        self._rows += len(whole)
        self._held = []

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise LogError(f"{self.path}: cannot be written ({reason_of(error)}); choose another file") from error


def _is_trace(path: Path) -> bool:
    """Return whether a file is one that `FullTrace` has written."""
    import pyarrow.parquet

    try:
        names = pyarrow.parquet.read_schema(path).names
    except (OSError, pyarrow.ArrowException):
        return False
    return [*names[:1], *names[-1:]] == ["time [s]", "error"]
