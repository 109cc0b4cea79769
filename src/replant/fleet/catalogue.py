"""Catalogue: which rigs are in a folder of logs, from names, sizes and footers; no sample is read."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

from replant.data.logs.formats import FORMATS
from replant.data.logs.packed import SUFFIXES as PACKED
from replant.data.logs.parquet import SUFFIXES as PARQUET
from replant.errors import LogError
from replant.fleet.job import Piece, Rig
from replant.fleet.rig_column import rigs_in_columns

FILE, FOLDER = "file", "folder"
_MAGIC = frozenset("*?[")


def find_rigs(logs: str | os.PathLike[str], by: str, leave_out: Path | None = None) -> list[Rig]:
    """Return the rigs of a folder of logs, sorted by name.

    Parameters
    ----------
    logs : path
        A file, a folder, which is searched with all that lie in it, or a pattern with ``*``, ``?`` or ``**``.
    by : str
        What a rig is: "file", "folder", or the name of a column: of a hive folder ``COLUMN=rig``, or in Parquet files.
    leave_out : Path, optional
        A folder that is not searched, such as that of the results.

    Raises
    ------
    LogError
        If there is no log, or a file has no such column.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("b.csv", "a.csv", "notes.md"):
    ...         _ = Path(folder, name).write_text("t,u,y")
    ...     [rig.name for rig in find_rigs(folder, by="file")]
    ['a.csv', 'b.csv']
    """
    root, files = _files(logs)
    left_out = None if leave_out is None else leave_out.resolve()
    pieces = [_piece(path, root) for path in files if left_out is None or left_out not in path.resolve().parents]
    if not pieces:
        known = " ".join(FORMATS)
        raise LogError(f"{logs}: no log in it; a log is one of {known}, perhaps with {' '.join(PACKED)}")
    if by == FILE:
        return sorted((Rig(piece.name, (piece,)) for piece in pieces), key=lambda rig: rig.name)
    grouped: dict[str, list[Piece]] = defaultdict(list)
    inside = []
    for piece in pieces:
        key = _folder(piece.name, root) if by == FOLDER else _hive_key(piece.name, by)
        if key is None:
            inside.append(piece)
        else:
            grouped[key].append(piece)
    problems: dict[str, str] = {}
    for key, piece, problem in rigs_in_columns(inside, by):
        grouped[key].append(piece)
        problems[key] = problems.get(key) or problem
    return [
        Rig(name, tuple(sorted(of, key=lambda piece: piece.name)), problems.get(name, ""))
        for name, of in sorted(grouped.items())
    ]


def is_parquet(piece: Piece) -> bool:
    """Return whether a file is Parquet by its name."""
    return Path(piece.path).suffix.lower() in PARQUET


def _files(logs: str | os.PathLike[str]) -> tuple[Path, list[Path]]:
    """Return the folder that names count from, and the logs in it, sorted."""
    text = os.fspath(logs)
    path = Path(text)
    if path.is_dir():
        return path, sorted(_walked(path))
    if path.exists():
        return path.parent, [path]
    if not _MAGIC & set(text):
        raise LogError(f"{logs}: no such file or folder; check the path")
    fixed = next(count for count, part in enumerate(path.parts) if _MAGIC & set(part))
    root = Path(*path.parts[:fixed])
    found = set(root.glob(str(Path(*path.parts[fixed:]))))
    files = {each for each in found if each.is_file() and _is_log(each)}
    files |= {inner for each in found if each.is_dir() for inner in _walked(each)}
    return root, sorted(each for each in files if not any(part[0] in "._" for part in each.relative_to(root).parts))


def _walked(folder: Path) -> Iterator[Path]:
    """Yield the logs in a folder and in those in it; names that begin with a dot or an underscore are no logs."""
    for where, folders, names in os.walk(folder, followlinks=True):
        folders[:] = sorted(name for name in folders if name[0] not in "._")
        yield from (Path(where, name) for name in names if _is_log(Path(name)))


def _is_log(path: Path) -> bool:
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    if suffixes and suffixes[-1] in PACKED:
        suffixes.pop()
    return path.name[0] not in "._" and bool(suffixes) and suffixes[-1] in FORMATS


def _piece(path: Path, root: Path) -> Piece:
    name = path.relative_to(root).as_posix()
    try:
        about = path.stat()
    except OSError:  # it vanished, or leads nowhere: reading it will say so
        return Piece(str(path.absolute()), name, 0, 0)
    return Piece(str(path.absolute()), name, about.st_size, about.st_mtime_ns)


def _folder(name: str, root: Path) -> str:
    """Return the folder of a file, from the folder of all logs on; that one by its own name."""
    folder = Path(name).parent.as_posix()
    return folder if folder != "." else root.resolve().name


def _hive_key(name: str, column: str) -> str | None:
    """Return the value of ``COLUMN=value`` among the folders of a path.

    Examples
    --------
    >>> _hive_key("year=2026/rig=a%20b/part.parquet", "rig"), _hive_key("rig/part.parquet", "rig")
    ('a b', None)
    """
    for part in Path(name).parts[:-1]:
        found, sign, value = part.partition("=")
        if sign and found == column:
            return unquote(value)
    return None
