"""Reading a log of the table from a folder of git repositories."""

from __future__ import annotations

import io
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.io import loadmat

from public_logs.table import Log

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Data:
    """Input, output and reference (or None), each (K,)."""

    u: FloatArray
    y: FloatArray
    r: FloatArray | None


def git_folder(mirror: Path, repository: str) -> Path | None:
    """Return the git directory of a repository in ``mirror/owner+name``, however deep it lies there, or None."""
    folder = mirror / repository.replace("/", "+")
    found = [folder, *(folder / inner for inner in (".git", "repo", "repo/.git"))]
    return next((each for each in found if (each / "HEAD").is_file() and (each / "objects").is_dir()), None)


def how_to_clone(mirror: Path, logs: Iterable[Log]) -> list[str]:
    """Return a command for each repository that is missing."""
    missing = sorted({log.repository for log in logs if git_folder(mirror, log.repository) is None})
    return [f"git clone --bare https://github.com/{name} {mirror / name.replace('/', '+')}" for name in missing]


def read(mirror: Path, log: Log) -> Data:
    """Return the signals of a log whose repository is there."""
    folder = git_folder(mirror, log.repository)
    assert folder is not None
    u, y, r = (
        _column(_content(folder, log.commit, path), path, name) if name else None
        for name, path in ((log.input, log.path), (log.output, log.output_path or log.path), (log.reference, log.path))
    )
    assert u is not None
    assert y is not None
    rows = slice(*log.rows)
    return Data(u[rows], y[rows], None if r is None else r[rows])


@cache
def _content(folder: Path, commit: str, path: str) -> bytes:
    command = ["git", f"--git-dir={folder}", "show", f"{commit}:{path}"]
    return subprocess.run(command, check=True, capture_output=True).stdout


def _column(content: bytes, path: str, name: str) -> FloatArray:
    """Return a column: of text by its number, of a .mat file by variable, field and column: ``logs.InputData,0``."""
    variable, _, number = name.rpartition(",") if "," in name else (name, "", "")
    if not path.endswith(".mat"):
        return _of_text(content.decode("utf-8-sig"), int(name))
    first, *fields = variable.split(".")
    value = loadmat(io.BytesIO(content), struct_as_record=False, squeeze_me=True, variable_names=[first])[first]
    for field in fields:
        value = getattr(value, field)
    columns = np.asarray(value, float)
    if columns.ndim > 1:
        columns = (columns if columns.shape[0] > columns.shape[1] else columns.T)[:, int(number)]
    return np.ascontiguousarray(columns)


def _of_text(text: str, column: int) -> FloatArray:
    """Return a column of the lines that begin with a number, whatever stands between their entries."""
    values = []
    for line in text.splitlines():
        entries = line.replace(",", " ").replace(";", " ").split()
        try:
            values.append(float(entries[column]))
        except (IndexError, ValueError):
            if values and entries:
                raise
    return np.array(values)
