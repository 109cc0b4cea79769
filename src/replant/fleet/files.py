"""Files of a fleet: their names, each whole or not there, and what writers that were killed have left."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replant.errors import SystemRefusedError
from replant.fleet.job import digest
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


def printable(text: str) -> str:
    r"""Return a text with the bytes of a file's name that are no UTF-8 written out: tables and pages hold text alone.

    Examples
    --------
    >>> print(printable("rig \udcff.csv"))
    rig \udcff.csv
    """
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


TABLE, TIMING, MODELS, ABOUT = "rigs.parquet", "timing.parquet", "models.jsonl", "fleet.json"
PARTS, MANIFEST, REPORTS = "parts", "manifest", "reports"
MARK = ".lock"  # A file in the manifest that every run makes first: where it is, a fleet has written


def is_results(folder: Path) -> bool:
    """Return whether a fleet has written into a folder, be it done or not.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     before = is_results(Path(folder))
    ...     _ = Path(folder, ABOUT).write_text("{}")
    ...     before, is_results(Path(folder))
    (False, True)
    """
    return (folder / ABOUT).is_file() or (folder / MANIFEST / MARK).is_file()


def foreign(folder: Path) -> list[str]:
    """Return the names in a folder under which a fleet would write, although no fleet has written there."""
    if is_results(folder):
        return []
    return [name for name in (TABLE, TIMING, MODELS, PARTS, MANIFEST, REPORTS) if (folder / name).exists()]


def report_path(rig: str) -> str:
    """Return the path of a rig's report, from the folder of the fleet on; rigs with like names have different ones.

    Examples
    --------
    >>> report_path("hall 2/rig 7.csv")
    'reports/hall-2-rig-7-csv-5b25fc.html'
    """
    plain = re.sub(r"[^A-Za-z0-9]+", "-", rig).strip("-")[:60]
    return f"{REPORTS}/{plain}-{digest(rig)[:6]}.html"
