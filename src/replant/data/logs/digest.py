"""The digest of a log's file, by which the record of a model can be recognised."""

from __future__ import annotations

import hashlib
from pathlib import Path


def digest(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal; empty where there is no file to read.

    Examples
    --------
    >>> digest(Path("no-such-log.csv"))
    ''
    """
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError:
        return ""
