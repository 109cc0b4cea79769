"""Catalogue: which rigs are in a folder of logs, from names, sizes and footers; no sample is read."""

from __future__ import annotations

import os
import stat
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from replant.arguments import instance, text
from replant.data.logs.arrow import SUFFIXES as PARQUET
from replant.data.logs.formats import FORMATS
from replant.data.logs.formats import SUFFIXES as PACKED
from replant.errors import InvalidArgumentError, LogError
from replant.fleet.files import is_results, printable
from replant.fleet.job import Piece, Rig
from replant.fleet.rig_column import NAMELESS, rigs_in_columns
from replant.operating_system.os_errors import reason_of

FILE, FOLDER = "file", "folder"
HIVE_NULL = "__HIVE_DEFAULT_PARTITION__"  # what writers of hive folders put in the place of no value
NOBODY = "{}: the folder {}= has no value, so that its rows are no rig's"
SHOWN = 200  # characters of a path that is not there that a message shows [characters]
_MAGIC = frozenset("*?[")


def find_rigs(logs: str | os.PathLike[str], by: str, leave_out: Path | None = None) -> list[Rig]:
    """Return the rigs of a folder of logs, sorted by name.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("b.csv", "a.csv", "notes.md"):
    ...         _ = Path(folder, name).write_text("t,u,y")
    ...     [rig.name for rig in find_rigs(folder, by="file")]
    ['a.csv', 'b.csv']
    """
    if not text("by", by).strip():
        raise InvalidArgumentError("by is empty; it must be file, folder, or the name of a column (by, --by)")
    if not os.fspath(instance("logs", logs, str, os.PathLike)):
        raise InvalidArgumentError("logs is empty; name a file, a folder or a pattern")
    root, files = _files(logs, leave_out)
    if not files:
        known = " ".join(FORMATS)
        raise LogError(f"{logs}: no log in it; a log is one of {known}, perhaps with {' '.join(PACKED)}")
    pieces = [(_piece(each, root), each.problem) for each in files]
    if by == FILE:
        return sorted((Rig(piece.name, (piece,), problem) for piece, problem in pieces), key=lambda rig: rig.name)
    grouped: dict[str, list[Piece]] = defaultdict(list)
    problems: dict[str, str] = {}

    def add(name: str, piece: Piece, problem: str) -> None:
        grouped[name].append(piece)
        problems[name] = problems.get(name) or problem

    inside = []
    own = _own_name(root, [piece.name for piece, _ in pieces])
    for piece, problem in pieces:
        key = (_folder(piece.name) or own) if by == FOLDER else _hive_key(piece.name, by)
        if key is not None:
            add(key, piece, problem or (NOBODY.format(piece.path, by) if key == NAMELESS else ""))
        elif problem:
            add(piece.name, piece, problem)
        else:
            inside.append(piece)
    for key, piece, problem in rigs_in_columns(inside, by):
        add(key, piece, problem)
    return [
        Rig(name, tuple(sorted(of, key=lambda piece: piece.name)), problems[name])
        for name, of in sorted(grouped.items())
    ]


def is_parquet(piece: Piece) -> bool:
    """Return whether a file is Parquet by its name."""
    return Path(piece.path).suffix.lower() in PARQUET


def _files(logs: str | os.PathLike[str], leave_out: Path | None) -> tuple[Path, list[Found]]:
    """Return the folder that names count from, and the logs in it, sorted."""
    given = os.fspath(logs)
    path = Path(given)
    left_out = set() if leave_out is None else {os.path.realpath(leave_out)}

    def is_left_out(folder: Path) -> bool:
        return os.path.realpath(folder) in left_out or is_results(folder)

    try:
        kind = path.stat().st_mode
    except (OSError, ValueError) as error:
        if not _MAGIC & set(given):
            raise LogError(f"{given[:SHOWN]}: no such file or folder ({reason_of(error)}); check the path") from error
    else:
        if not stat.S_ISDIR(kind):
            return path.parent, [looked_at(path)]
        _check_root(path, leave_out)
        return path, sorted(walked(path, is_left_out), key=lambda each: each.path)
    fixed = next(count for count, part in enumerate(path.parts) if _MAGIC & set(part))
    root = Path(*path.parts[:fixed])
    _check_root(root, leave_out)
    try:
        found = set(root.glob(str(Path(*path.parts[fixed:]))))
    except (OSError, ValueError, NotImplementedError) as error:
        raise LogError(f"{logs}: not a pattern that can be used ({error}); write it as in 'logs/**/*.csv'") from error
    files = {each: looked_at(each) for each in found if not each.is_dir() and is_log(each)}
    for folder in (each for each in found if each.is_dir()):
        files |= {inner.path: inner for inner in walked(folder, is_left_out)}
    judged: dict[Path, bool] = {root: False}
    return root, [files[each] for each in sorted(files) if not _is_inside(each.parent, judged, is_left_out)
                  and not any(part[0] in "._" for part in each.relative_to(root).parts)]  # fmt: skip


def _is_inside(folder: Path, judged: dict[Path, bool], is_left_out: Callable[[Path], bool]) -> bool:
    """Return whether a folder, or one that it lies in, is left out; ``judged`` holds those that were asked for."""
    if folder not in judged:
        judged[folder] = is_left_out(folder) or _is_inside(folder.parent, judged, is_left_out)
    return judged[folder]


def _check_root(root: Path, leave_out: Path | None) -> None:
    """Check that the logs do not lie where results are."""
    if leave_out is not None and os.path.realpath(root) == os.path.realpath(leave_out):
        raise InvalidArgumentError(
            f"{leave_out} is the folder of the logs; name another one for the results (out, --out), such as "
            f"{leave_out / 'fleet'}"
        )
    if is_results(root):
        raise LogError(f"{root}: holds the results of a fleet, which are no logs; name the folder of the logs")


def _piece(found: Found, root: Path) -> Piece:
    name = printable(found.path.relative_to(root).as_posix())
    return Piece(str(found.path.absolute()), name, found.size, found.modified)


def _folder(name: str) -> str:
    """Return the folder of a file, from the folder of all logs on; empty for that one itself."""
    folder = Path(name).parent.as_posix()
    return folder if folder != "." else ""


def _own_name(root: Path, names: Iterable[str]) -> str:
    """Return the name of the folder of all logs as a rig: its own, or a dot where a folder in it has the same."""
    name = printable(root.resolve().name)
    return name if name and not any(_folder(each) == name for each in names) else "."


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
            return NAMELESS if value in ("", HIVE_NULL) else unquote(value)
    return None


@dataclass(frozen=True)
class Found:
    """A log that was found, or a folder that cannot be searched.

    Attributes
    ----------
    path : Path
    size, modified : int
        In bytes, and in ns since 1970; 0 where they are not known.
    problem : str
        Why it cannot be read, where that is known without opening it.
    """

    path: Path
    size: int = 0
    modified: int = 0
    problem: str = ""


def walked(folder: Path, is_left_out: Callable[[Path], bool]) -> Iterator[Found]:
    """Yield the logs in a folder and in those in it; names that begin with a dot or an underscore are no logs.

    A link to a folder that is being searched is not followed: it would lead round for ever.
    """
    refused: list[OSError] = []
    above: dict[str, frozenset[tuple[int, int]]] = {os.fspath(folder): _identity(os.fspath(folder))}
    for where, folders, names in os.walk(folder, onerror=refused.append, followlinks=True):
        chain = above.get(where, frozenset())
        kept = []
        for name in sorted(folders):
            inner = os.path.join(where, name)  # noqa: PTH118 - as os.walk names it
            identity = _identity(inner)
            if name[0] in "._" or identity & chain or is_left_out(Path(inner)):
                continue
            above[inner] = chain | identity
            kept.append(name)
        folders[:] = kept
        yield from (looked_at(Path(where, name)) for name in names if is_log(Path(name)))
    for error in refused:
        path = Path(os.fsdecode(error.filename))
        yield Found(path, problem=f"{path}: the folder cannot be searched ({error.strerror}); check its permissions")


def looked_at(path: Path) -> Found:
    """Return a log with its size and time; one that is not there is left to the reader to tell."""
    try:
        about = path.stat()
    except OSError:
        return Found(path)
    if not stat.S_ISREG(about.st_mode):  # reading a pipe would wait for ever
        return Found(path, problem=f"{path}: no file, but a folder, a pipe or a device; take it out of the logs")
    return Found(path, about.st_size, about.st_mtime_ns)


def is_log(path: Path) -> bool:
    """Return whether a file is a log by its name.

    Examples
    --------
    >>> is_log(Path("a.csv.gz")), is_log(Path("_a.csv")), is_log(Path("a.md"))
    (True, False, False)
    """
    suffixes = [suffix.lower() for suffix in path.suffixes[-2:]]
    if suffixes and suffixes[-1] in PACKED:
        suffixes.pop()
    return path.name[0] not in "._" and bool(suffixes) and suffixes[-1] in FORMATS


def _identity(folder: str) -> frozenset[tuple[int, int]]:
    """Return what a folder is known by under all its names; empty where it cannot be looked at."""
    try:
        about = os.stat(folder)  # noqa: PTH116
    except OSError:
        return frozenset()
    return frozenset({(about.st_dev, about.st_ino)})
