"""Models in files: written whole or not at all, read with a reason where it cannot be done."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from replant.errors import ModelFileError
from replant.operating_system.os_errors import reason_of

AnyPath = str | os.PathLike[str]

LARGEST = 2**24
"""Largest file that is read as a model [bytes]."""


def write(path: AnyPath, written: str) -> None:
    """Write a text first under another name beside the file, so that nobody reads half of it.

    Raises
    ------
    ModelFileError
        If the file cannot be written; one that was there is unchanged.
    """
    try:
        file = Path(path).resolve()
        if file.exists() and not file.is_file():  # root could replace a device
            raise ValueError("it is not a regular file")
        new = file.with_name(file.name + ".new")
        try:
            new.write_text(written, encoding="utf-8")
            new.replace(file)
        finally:
            with contextlib.suppress(OSError):
                new.unlink(missing_ok=True)
    except (OSError, ValueError, RuntimeError) as error:
        raise ModelFileError(f"{path}: the model could not be written ({reason_of(error)})") from error


def read(path: AnyPath) -> bytes:
    """Return the bytes of a file.

    Raises
    ------
    ModelFileError
        If it cannot be read, or is too large for a model.
    """
    try:
        size = Path(path).stat().st_size if Path(path).is_file() else -1
        if 0 <= size <= LARGEST:
            return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        raise ModelFileError(f"{path}: it cannot be read ({reason_of(error)})") from error
    missing = not Path(path).exists()
    raise ModelFileError(f"{path}: " + ("no such file" if missing else "it is no model that --save has written"))
