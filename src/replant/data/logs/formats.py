"""The formats of logs: a file's suffix selects the reader."""

from __future__ import annotations

import importlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replant.data.logs import mcap, parquet, parser_child, parser_process
from replant.data.logs.packed import STANDARD_INPUT, SUFFIXES, read_packed, read_standard_input
from replant.data.logs.table import Table, unreadable_error
from replant.errors import LogError

# For each suffix the function of a module here, read(path) -> Table; it is imported when such a file is opened
FORMATS = {
    ".csv": "csv.read",
    ".txt": "csv.read",
    ".tsv": "csv.read",
    ".dat": "csv.read",
    ".parquet": "parquet.read",
    ".pq": "parquet.read",
    ".mat": "matlab.read",
    ".npz": "npz.read",
    ".jsonl": "jsonl.read",
    ".ndjson": "jsonl.read",
    ".feather": "arrow_ipc.read",
    ".arrow": "arrow_ipc.read",
    ".xlsx": "xlsx.read",
    ".xlsm": "xlsx.read",
    ".h5": "hdf5.read",
    ".hdf5": "hdf5.read",
    ".tdms": "tdms.read",
    ".mf4": "mdf.read",
    ".mdf": "mdf.read",
    ".ulg": "ulog.read",
    ".mcap": "mcap.read",
}


def read_columns(path: str | os.PathLike[str]) -> Table:
    r"""Open a log file of any format; the table knows its columns' names, and reads columns on request.

    Parameters
    ----------
    path : path
        A file with one of the suffixes in `FORMATS`, perhaps compressed (.gz, .zip, .zst); a folder of Parquet files,
        the parts of one log in the order of their names, or of a ROS 2 bag; or ``-``, standard input.

    Raises
    ------
    LogError
        If the file is missing, empty, damaged, or of another format.
    MissingDependencyError
        If the package that reads the format is not installed.

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
    if path == STANDARD_INPUT:
        return read_standard_input(_read_file, _check_head)
    if path.suffix.lower() in SUFFIXES and not path.is_dir():
        with _unreadable_as_log_error(path):
            _check_file(path)
            return read_packed(path, _read_file, _check_head)
    return _read_file(path)


def _read_file(path: Path) -> Table:
    suffix = _suffix_of_folder(path) if path.is_dir() else path.suffix.lower()
    if suffix not in FORMATS:
        known = " ".join(FORMATS)
        raise LogError(
            f"{path}: unknown file type {suffix!r}; a log is one of {known}, perhaps with {' '.join(SUFFIXES)}"
        )
    with _unreadable_as_log_error(path):
        for part in _parts(path, suffix):
            _check_file(part)
        if FORMATS[suffix] in parser_process.PARSERS and parser_process.is_possible():
            return parser_process.read(path, FORMATS[suffix])
        table: Table = parser_child.reader(FORMATS[suffix])(path)
    return table


def _parts(path: Path, suffix: str) -> list[Path]:
    if not path.is_dir():
        return [path]
    return mcap.parts_of(path) if suffix == ".mcap" else parquet.parts_of(path)


def _check_file(path: Path) -> None:
    """Check that a path leads to a file with bytes in it: reading a device or a pipe may not end."""
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):
        raise LogError(
            f"{path}: a device, pipe or socket; copy the log into a file, or pipe it in and give - as the log"
        )
    if about.st_size == 0:
        raise LogError(f"{path}: the file is empty; record the log again")


def _check_head(path: Path) -> None:
    """Check that the beginning of a text log holds rows; the other formats have their numbers where they say."""
    module = FORMATS.get(path.suffix.lower(), "").partition(".")[0]
    if module in ("csv", "jsonl"):
        importlib.import_module(f"replant.data.logs.{module}").check_head(path)


def _suffix_of_folder(path: Path) -> str:
    """Return the format of the parts of a log in a folder."""
    with _unreadable_as_log_error(path):
        if mcap.parts_of(path):
            return ".mcap"
        if parquet.parts_of(path):
            return ".parquet"
        if any(part.suffix == ".db3" for part in path.iterdir()):
            raise LogError(f"{path}: a ROS 2 bag in SQLite; write it as MCAP with: ros2 bag convert")
    raise LogError(
        f"{path}: a directory; give the log file inside it, or a folder of Parquet files; `replant fleet` makes a "
        "model of each file"
    )


@contextmanager
def _unreadable_as_log_error(path: Path) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; check the path") from None
    except OSError as error:
        raise unreadable_error(path, error) from error
