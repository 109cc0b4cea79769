"""Recorder: samples and estimates into folders of Parquet files, readable at every moment.

A Parquet file is of no use before its end is written.  So each stretch of samples becomes a small file of its own,
written under another name, forced to the disk and renamed: a crash costs at most the stretch it interrupts.  pandas,
pyarrow, DuckDB and `replant run` read such a folder as one table.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from replant.arguments import FloatArray
from replant.data.logs.parquet import CHECKED, check_rows, opened
from replant.errors import InvalidArgumentError, MissingDependencyError
from replant.live.outputs.disk_writer import Background, one_line
from replant.live.outputs.message import Estimate

ROWS = 200_000
"""Rows of a part: a few megabytes [rows]."""
SECONDS = 30.0
"""Time after which a part is written even if it is short [s]."""
PART = "part-{:08d}.parquet"


class Recorder:
    """Record samples into FOLDER/samples and estimates into FOLDER/estimates.

    Columns of samples: n (the device's number, or null), t [s], u, y.  Columns of estimates: t, n, samples,
    each parameter and its standard deviation (std_...), status and verdict.

    Parameters
    ----------
    folder : path
    background : Background
        Writes the parts.
    go_on : bool
        Whether the folder may hold a record already, which is continued: numbers already in it are not taken again.

    Raises
    ------
    InvalidArgumentError
        If the folder cannot be made, or holds a record that is not to be continued.
    MissingDependencyError
        Without pyarrow.
    """

    name = "record"
    interval = 0.1  # s of real time at the least between two recorded estimates
    behind = False  # nobody waits for a record

    def __init__(self, folder: Path, background: Background, *, go_on: bool = False) -> None:
        if importlib.util.find_spec("pyarrow") is None:
            raise MissingDependencyError("--record needs pyarrow: pip install 'replant[live]'")
        self._background = background
        self._samples = _Parts(folder / "samples", go_on=go_on)
        self._estimates = _Parts(folder / "estimates", go_on=go_on)
        self._last = self._samples.last_number()
        self._clear()

    def _clear(self) -> None:
        self._taken: list[tuple[npt.NDArray[np.int64] | None, FloatArray, FloatArray, FloatArray]] = []
        self._rows = 0
        self._given: list[Estimate] = []
        self._begun = time.monotonic()

    def take(self, n: npt.NDArray[np.int64] | None, t: FloatArray, u: FloatArray, y: FloatArray) -> None:
        """Take samples (K,): their numbers if there are any, rig time, input and output."""
        if n is not None and n[0] <= self._last:
            new = int(np.searchsorted(n, self._last, side="right"))
            n, t, u, y = n[new:], t[new:], u[new:], y[new:]
        self._taken.append((n, t, u, y))
        self._rows += u.size
        if self._rows >= ROWS or time.monotonic() - self._begun >= SECONDS:
            self.flush()

    def send(self, estimate: Estimate) -> None:
        """Take an estimate."""
        self._given.append(estimate)

    def close(self) -> None:
        """Have the rest written."""
        self.flush()

    def flush(self) -> None:
        """Have what was taken written as a part, in the background."""
        taken, given = self._taken, self._given
        self._clear()
        if taken:
            number = self._samples.next_number()
            self._background.submit("record", lambda: self._samples.write(number, _samples_table(taken)))
        if given:
            place = self._estimates.next_number()
            self._background.submit("record", lambda: self._estimates.write(place, _estimates_table(given)))


class _Parts:
    """A folder of Parquet files, numbered in their order."""

    def __init__(self, folder: Path, *, go_on: bool) -> None:
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._found = sorted(folder.glob("part-*.parquet"))
            for unfinished in folder.glob(".part-*"):
                unfinished.unlink()
        except OSError as error:
            raise InvalidArgumentError(f"--record: {one_line(error)}; choose a folder that can be written") from None
        if self._found and not go_on:
            raise InvalidArgumentError(
                f"--record: {folder} holds a record already; choose another folder, or go on with its --checkpoint"
            )
        self._number = int(self._found[-1].stem.removeprefix("part-")) if self._found else 0

    def last_number(self) -> int:
        """Return the largest number n in the newest part, or the least integer where there is none."""
        import pyarrow.compute

        last = None
        if self._found:
            with opened(self._found[-1]) as part:
                numbers = part.read(columns=["n"]).column("n")
                check_rows(self._found[-1], part, len(numbers))
            last = pyarrow.compute.max(numbers).as_py()
        return int(np.iinfo(np.int64).min) if last is None else int(last)

    def next_number(self) -> int:
        """Return the number of a new part."""
        self._number += 1
        return self._number

    def write(self, number: int, table: Any) -> None:
        """Write a part under another name, force it to the disk and rename it."""
        import pyarrow.parquet

        path = self._folder / PART.format(number)
        unfinished = path.with_name("." + path.name)
        try:
            with unfinished.open("wb") as file:
                pyarrow.parquet.write_table(table, file, **CHECKED)
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(path)
        finally:
            with contextlib.suppress(OSError):  # a full disk, say: what was begun is of no use
                unfinished.unlink(missing_ok=True)


def _samples_table(taken: list[tuple[npt.NDArray[np.int64] | None, FloatArray, FloatArray, FloatArray]]) -> Any:
    import pyarrow

    numbers = [
        pyarrow.nulls(u.size, pyarrow.int64()) if n is None else pyarrow.array(n, pyarrow.int64())
        for n, _, u, _ in taken
    ]
    signals = {name: np.concatenate([entry[k] for entry in taken]) for k, name in ((1, "t"), (2, "u"), (3, "y"))}
    return pyarrow.table({"n": pyarrow.chunked_array(numbers, pyarrow.int64()), **signals})


def _estimates_table(given: list[Estimate]) -> Any:
    import pyarrow

    names = given[0].names
    columns: dict[str, Any] = {
        "t": pyarrow.array([entry.timestamp for entry in given], pyarrow.float64()),
        "n": pyarrow.array([entry.sequence for entry in given], pyarrow.int64()),
        "samples": pyarrow.array([entry.samples for entry in given], pyarrow.int64()),
    }
    for prefix, values in (
        ("", np.array([entry.parameters for entry in given])),
        ("std_", np.array([entry.std for entry in given])),
    ):
        columns |= {prefix + name: values[:, k] for k, name in enumerate(names)}
    columns["status"] = [entry.status for entry in given]
    columns["verdict"] = [entry.verdict for entry in given]
    return pyarrow.table(columns)
