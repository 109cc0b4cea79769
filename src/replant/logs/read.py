"""Open a log by its file's suffix and take input, output and time from its columns."""

from __future__ import annotations

import importlib
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from replant.errors import InvalidArgumentError, LogError
from replant.logs import parquet
from replant.logs.log import Log
from replant.logs.table import Table, unreadable
from replant.logs.time import check_dt, sampling_time, time_candidates, unit_in_seconds

# The module that reads a suffix: a function read(path) -> Table, imported when such a file comes
FORMATS = {
    ".csv": "csv",
    ".txt": "csv",
    ".tsv": "csv",
    ".dat": "csv",
    ".parquet": "parquet",
    ".pq": "parquet",
    ".mat": "matlab",
    ".npz": "npz",
}

_GIVE_TIME = "name the time column (time, --time) or give the sampling time (dt, --dt)"


def read_columns(path: str | os.PathLike[str]) -> Table:
    r"""Open a log file of any format: the names of its columns, and the columns when asked for.

    Parameters
    ----------
    path : path
        A file .csv .txt .tsv .dat (text), .parquet .pq, .mat (up to v7) or .npz, or a folder of .parquet files.

    Raises
    ------
    LogError
        If the file is missing, empty, damaged, or of another format.
    MissingDependencyError
        If it is a Parquet file and pyarrow is not installed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.csv")
    ...     _ = file.write_text("t;u [V];y\n0,0;1,5;0,0\n0,1;1,5;0,7\n")
    ...     table = read_columns(file)
    ...     print(table.names, table.column("y"))
    ('t', 'u [V]', 'y') [0.  0.7]
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if path.is_dir():
        return parquet.read_folder(path)
    if suffix not in FORMATS:
        raise LogError(f"{path}: unknown file type {suffix!r}; a log is one of {' '.join(FORMATS)}")
    module = importlib.import_module(f"replant.logs.{FORMATS[suffix]}")
    try:
        if path.stat().st_size == 0:
            raise LogError(f"{path}: the file is empty; record the log again")
        table: Table = module.read(path)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; check the path") from None
    except OSError as error:
        raise unreadable(path, error) from error
    return table


def read_log(
    path: str | os.PathLike[str],
    *,
    input: str | int,  # noqa: A002 - the field's word
    output: str | int,
    time: str | int | None = None,
    dt: float | None = None,
) -> Log:
    """Read input and output of a plant from a recorded log.

    Without `time` and `dt`, a column called t, time or timestamp (in any case, also with a unit as in ``time [s]``)
    gives the sampling time.

    Parameters
    ----------
    path : path
        A file .csv .txt .tsv .dat (text), .parquet .pq, .mat (up to v7) or .npz, or a folder of .parquet files.
    input, output : str or int
        The columns, by name or 0-based number. In .mat and .npz files also ``udat[:,0]`` and ``data.udat[:,0]``.
    time : str or int, optional
        The column of time stamps, in seconds or the unit that its name states (``t [ms]``). They must be regular.
    dt : float, optional
        The sampling time in seconds, instead of `time`.

    Returns
    -------
    Log
        The samples as float64; a missing one is NaN.

    Raises
    ------
    LogError
        If the file or a column cannot be read, or the time stamps are irregular: one line that says where and what
        to do.
    InvalidArgumentError
        If `time` and `dt` are both given, or `dt` is not finite and positive.
    MissingDependencyError
        If it is a Parquet file and pyarrow is not installed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder, "log.npz")
    ...     np.savez(file, t=[0.0, 0.1, 0.2], u=[1.0, 1.0, 1.0], y=[0.0, 0.5, 0.75])
    ...     log = read_log(file, input="u", output="y")
    >>> log.dt, log.output
    (0.1, array([0.  , 0.5 , 0.75]))
    """
    if time is not None and dt is not None:
        raise InvalidArgumentError("give one of the time column (time, --time) and the sampling time (dt, --dt)")
    step = None if dt is None else check_dt(dt)
    table = read_columns(path)
    roles = {"input": table.find(input), "output": table.find(output)}
    if time is not None:
        roles["time"] = table.find(time)
    _check_distinct(table, roles)
    if time is None and step is None:
        roles["time"] = _find_time(table, roles)
    columns = dict(zip(roles, table.columns(list(roles.values())), strict=True))
    _check_lengths(table, roles, columns)
    stamps = None
    if step is None:
        step, stamps = _timing(table, roles["time"], columns["time"])
    names = table.names[roles["input"]], table.names[roles["output"]]
    return Log(columns["input"], columns["output"], step, stamps, *names, table.path)


def _check_distinct(table: Table, roles: dict[str, int]) -> None:
    chosen: dict[int, str] = {}
    for role, number in roles.items():
        if number in chosen:
            raise LogError(
                f"{table.path}: {chosen[number]} and {role} are the same column {table.names[number]!r}; "
                "choose two different columns"
            )
        chosen[number] = role


def _find_time(table: Table, roles: dict[str, int]) -> int:
    candidates = [number for number in time_candidates(table.names) if number not in roles.values()]
    if len(candidates) > 1:  # structs in one file often have a time each
        samples, *stamps = table.columns([roles["input"], *candidates])
        candidates = [number for number, column in zip(candidates, stamps, strict=True) if len(column) == len(samples)]
    if len(candidates) == 1:
        return candidates[0]
    if not candidates:
        raise LogError(f"{table.path}: no column is called t, time or timestamp; {_GIVE_TIME}")
    names = ", ".join(repr(table.names[number]) for number in candidates)
    raise LogError(f"{table.path}: several columns could be the time: {names}; {_GIVE_TIME}")


def _check_lengths(table: Table, roles: dict[str, int], columns: dict[str, NDArray[np.float64]]) -> None:
    named: Sequence[tuple[str, int]] = [(table.names[number], len(columns[role])) for role, number in roles.items()]
    first, length = named[0]
    for name, other in named[1:]:
        if other != length:
            raise LogError(
                f"{table.path}: column {first!r} has {length} samples but {name!r} has {other}; "
                "choose columns of one length"
            )
    if length < 2:
        rows = "1 row" if length == 1 else f"{length} rows"
        raise LogError(f"{table.path}: {rows} of data where at least 2 are needed; record more samples")


def _timing(table: Table, number: int, column: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
    name = table.names[number]
    unit = 1.0 if number in table.in_seconds else unit_in_seconds(name)
    step = sampling_time(table.path, name, column, table.place)
    return float(f"{step * unit:.12g}"), column * unit
