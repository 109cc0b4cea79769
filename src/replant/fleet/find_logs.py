"""Find logs: those in a folder and in all folders in it, each once, whatever links lead where."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from replant.data.logs.formats import FORMATS
from replant.data.logs.packed import SUFFIXES as PACKED


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
