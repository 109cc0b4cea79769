"""Files of a fleet: each whole or not there, and what writers that were killed have left."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replant.errors import SystemRefusedError
from replant.operating_system import whole_file
from replant.operating_system.os_errors import refusal


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the name under which a file is written, see `operating_system.whole_file.replacing`."""
    try:
        with whole_file.replacing(path) as new:
            yield new
    except OSError as error:
        raise SystemRefusedError(f"{path} cannot be written: {refusal(error)}") from error


def clear(folder: Path) -> None:
    """Remove what writers that were killed have left."""
    for left in folder.glob(f".*{whole_file.ENDING}"):
        with contextlib.suppress(OSError):
            left.unlink(missing_ok=True)
