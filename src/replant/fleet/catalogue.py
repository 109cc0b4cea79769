"""The catalogue of a fleet: the logs of each rig, which are files or rows of Parquet files.

A row group whose smallest and largest name are equal belongs to one rig.  If it has several rigs or no statistics, only
the column of names is read; each rig then reads the whole row group and keeps its own rows.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections import defaultdict
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from replant.errors import InvalidArgumentError, LogError
from replant.fleet.job import Piece, Rig, is_results, printable
from replant.logs.arrow import SUFFIXES, open_parquet
from replant.logs.file_formats import SUFFIXES as PACKED
from replant.logs.parser_process import FORMATS
from replant.logs.table import listed
from replant.logs.text_layout import is_prose
from replant.numerics.arguments import instance, text
from replant.numerics.operating_system import reason_of

READERS = 8  # threads that read footers: they wait for the disk, or the network [count]
NAMELESS = "(no name)"

Key = str | int | None


def rigs_in_columns(pieces: Sequence[Piece], column: str) -> list[tuple[str, Piece]]:
    """Return name and rows of each rig; an unreadable file is a rig with the file's name."""
    for piece in pieces:
        if not is_parquet(piece):
            raise LogError(
                f"{piece.path}: no folder {column}=..., and only Parquet files can name rigs in a column; "
                "choose --by file or --by folder"
            )
    with ThreadPoolExecutor(READERS, "replant-footers") as pool:
        return [rig for found in pool.map(partial(_rigs_of, column=column), pieces) for rig in found]


def _rigs_of(piece: Piece, column: str) -> list[tuple[str, Piece]]:
    try:
        with open_parquet(Path(piece.path)) as file:
            schema = file.schema_arrow
            names = schema.names
            usable = column in names and _is_name(schema.field(column).type)
            found = _groups(file, column) if usable else {}
    except LogError as problem:
        return [(piece.name, replace(piece, problem=str(problem)))]
    if column not in names:
        raise LogError(
            f"{piece.path}: no column {column!r}, nor a folder {column}=...; there are: {listed(names)}; "
            "choose --by file, --by folder or a column"
        )
    if not usable:
        raise LogError(
            f"{piece.path}: column {column!r} holds {schema.field(column).type}; a rig is named by text or a whole "
            "number"
        )
    parts = []
    for key, of in found.items():
        groups, counts, alone = zip(*of, strict=True)
        rows = sum(counts)
        part = replace(piece, groups=groups, rows=rows)
        if not all(alone):
            part = replace(part, column=column, key=key)
        name = "" if key is None else str(key)
        if not name.strip():
            lacking = f"{piece.path}: {rows} rows have no value in column {column!r}, and belong to no rig"
            name, part = NAMELESS, replace(part, problem=lacking)
        parts.append((name, part))
    return parts


def _groups(file: Any, column: str) -> dict[Key, list[tuple[int, int, bool]]]:
    """Return for each rig its row groups: number, the rig's rows in it, and whether it contains no other rig."""
    about, found = file.metadata, defaultdict[Key, list[tuple[int, int, bool]]](list)
    # the column's number in the footer, which counts each field of a structure
    leaf = [about.schema.column(number).path for number in range(about.num_columns)].index(column)
    for group in range(about.num_row_groups):
        rows, statistics = about.row_group(group).num_rows, about.row_group(group).column(leaf).statistics
        if rows == 0:
            continue
        known = statistics is not None and statistics.has_min_max and statistics.has_null_count
        is_one = known and statistics.min == statistics.max and statistics.null_count == 0
        for key, count in [(statistics.min, rows)] if is_one else _counted(file, group, column):
            found[key].append((group, count, count == rows))
    return found


def _counted(file: Any, group: int, name: str) -> list[tuple[Key, int]]:
    column = file.read_row_group(group, columns=[name], use_threads=False).column(0)
    counts = column.combine_chunks().value_counts() if column.num_chunks else []
    return [(entry["values"].as_py(), entry["counts"].as_py()) for entry in counts]


def _is_name(kind: Any) -> bool:
    """Return whether an Arrow type is text or a whole number."""
    from pyarrow import types

    if types.is_dictionary(kind):
        kind = kind.value_type
    return bool(types.is_integer(kind) or types.is_string(kind) or types.is_large_string(kind))


FILE, FOLDER = "file", "folder"
HIVE_NULL = "__HIVE_DEFAULT_PARTITION__"  # the value of hive folders for a missing value
NOBODY = "{}: the folder {}= has no value, and its rows belong to no rig"
SHOWN = 200  # most characters of a missing path in a message [characters]
NOTES = ".txt"  # the suffix that logs share with notes
_MAGIC = frozenset("*?[")


def find_rigs(
    logs: str | os.PathLike[str],
    by: str,
    leave_out: Path | None = None,
    no_log: Callable[[str], None] = lambda name: None,
) -> list[Rig]:
    """Return the rigs of a folder of logs, sorted by name; ``no_log`` gets the names of texts that are no logs."""
    if not text("by", by).strip():
        raise InvalidArgumentError("by is empty; it must be file, folder, or the name of a column (by, --by)")
    if not os.fspath(instance("logs", logs, str, os.PathLike)):
        raise InvalidArgumentError("logs is empty; name a file, a folder or a pattern")
    found = _pieces(logs, leave_out)
    # a text without rows of numbers, such as notes.txt beside the logs
    texts = [each for each in found if not each.problem and Path(each.path).suffix.lower() == NOTES]
    notes = [] if Path(logs).is_file() else [each for each in texts if is_prose(Path(each.path))]
    for note in notes:
        no_log(note.name)
    pieces = [piece for piece in found if piece not in notes]
    if not pieces:
        known = " ".join(FORMATS)
        raise LogError(f"{logs}: no log in it; a log is one of {known}, perhaps with {' '.join(PACKED)}")
    named: list[tuple[str, Piece]] = []
    inside, own = [], _own_name(pieces)
    for piece in pieces:
        if by == FILE:
            named.append((piece.name, piece))
        elif by == FOLDER:
            named.append((_folder(piece.name) or own, piece))
        elif (key := _hive_key(piece.name, by)) is not None:
            problem = NOBODY.format(piece.path, by) if key == NAMELESS else ""
            named.append((key, replace(piece, problem=piece.problem or problem)))
        elif piece.problem:
            named.append((piece.name, piece))
        else:
            inside.append(piece)
    grouped = defaultdict(list)
    for name, piece in named + rigs_in_columns(inside, by):
        grouped[name].append(piece)
    return [Rig(name, tuple(sorted(of, key=lambda piece: piece.name))) for name, of in sorted(grouped.items())]


def is_parquet(piece: Piece) -> bool:
    """Return whether a file is Parquet by its name."""
    return Path(piece.path).suffix.lower() in SUFFIXES


def _pieces(logs: str | os.PathLike[str], leave_out: Path | None) -> list[Piece]:
    """Return the logs of a file, a folder or a pattern, sorted by name; names are relative to its fixed part."""
    given = os.fspath(logs)
    root, pattern = Path(given), ""
    try:
        kind = root.stat().st_mode
    except (OSError, ValueError) as error:
        if not _MAGIC & set(given):
            raise LogError(f"{given[:SHOWN]}: no such file or folder ({reason_of(error)}); check the path") from error
        fixed = next(count for count, part in enumerate(root.parts) if _MAGIC & set(part))
        root, pattern = Path(*root.parts[:fixed]), str(Path(*root.parts[fixed:]))
    else:
        if not stat.S_ISDIR(kind):
            return [_piece(root, root.parent)]
    _check_root(root, leave_out)
    try:
        matched = set(root.glob(pattern)) if pattern else {root}
    except (OSError, ValueError, NotImplementedError) as error:
        raise LogError(f"{logs}: not a valid pattern ({error}); write it as in 'logs/**/*.csv'") from error
    results = None if leave_out is None else os.path.realpath(leave_out)

    @cache
    def is_left_out(folder: Path) -> bool:
        return os.path.realpath(folder) == results or is_results(folder)

    found: dict[Path, str] = {}
    for each in matched:
        if each.is_dir():
            found |= _walked(each, is_left_out)
        elif is_log(each):
            found[each] = ""
    pieces = []
    for path, problem in found.items():
        inner = path.relative_to(root)
        is_hidden = any(part[0] in "._" for part in inner.parts)
        if not is_hidden and not any(is_left_out(root / folder) for folder in inner.parents if folder.name):
            pieces.append(_piece(path, root, problem))
    return sorted(pieces, key=lambda piece: piece.name)


def _check_root(root: Path, leave_out: Path | None) -> None:
    """Check that the folder of the logs is not one of results."""
    if leave_out is not None and os.path.realpath(root) == os.path.realpath(leave_out):
        raise InvalidArgumentError(
            f"{leave_out} is the folder of the logs; name another one for the results (out, --out), such as "
            f"{leave_out / 'fleet'}"
        )
    if is_results(root):
        raise LogError(f"{root}: holds the results of a fleet, not logs; name the folder of the logs")


def _folder(name: str) -> str:
    """Return the folder of a file, relative to the folder of all logs; empty for that folder itself."""
    folder = Path(name).parent.as_posix()
    return folder if folder != "." else ""


def _own_name(pieces: Sequence[Piece]) -> str:
    """Return the rig name of the folder of all logs: its own name, or a dot if a folder in it has the same name."""
    inner = next((piece for piece in pieces if not _folder(piece.name)), None)
    name = "" if inner is None else printable(Path(inner.path).parent.resolve().name)
    return name if name and not any(_folder(piece.name) == name for piece in pieces) else "."


def _hive_key(name: str, column: str) -> str | None:
    """Return the value of ``COLUMN=value`` among the folders of a path."""
    for part in Path(name).parts[:-1]:
        found, sign, value = part.partition("=")
        if sign and found == column:
            return NAMELESS if value in ("", HIVE_NULL) else unquote(value)
    return None


def _walked(folder: Path, is_left_out: Callable[[Path], bool]) -> dict[Path, str]:
    """Return the logs in a folder and its subfolders, with the problem of each; hidden folders are not searched."""
    found: dict[Path, str] = {}
    refused: list[OSError] = []
    # a link to a folder above itself would be followed for ever
    above = {folder: {os.path.realpath(folder)}}
    for top, folders, names in os.walk(folder, onerror=refused.append, followlinks=True):
        where = Path(top)
        for name in list(folders):
            inner, real = where / name, os.path.realpath(where / name)
            if name[0] in "._" or real in above[where] or is_left_out(inner):
                folders.remove(name)
            above[inner] = above[where] | {real}
        found |= {where / name: "" for name in names if is_log(Path(name))}
    for error in refused:
        path = Path(os.fsdecode(error.filename))
        found[path] = f"{path}: the folder cannot be searched ({error.strerror}); check its permissions"
    return found


def _piece(path: Path, root: Path, problem: str = "") -> Piece:
    """Return a log with its size and time; a missing file is reported by the reader."""
    size = modified = 0
    with contextlib.suppress(OSError):
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):  # reading a pipe would wait for ever
            problem = problem or f"{path}: a folder, a pipe or a device, not a file; remove it from the logs"
        size, modified = about.st_size, about.st_mtime_ns
    name = printable(path.relative_to(root).as_posix())
    return Piece(str(path.absolute()), name, size, modified, problem=problem)


def is_log(path: Path) -> bool:
    """Return whether a file is a log by its name."""
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    if suffixes and suffixes[-1] in PACKED:
        suffixes.pop()
    return path.name[0] not in "._" and bool(suffixes) and suffixes[-1] in FORMATS
