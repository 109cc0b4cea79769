"""Folder: the names of what a fleet writes, and how the folder of a fleet is told from another."""

from __future__ import annotations

import re
from pathlib import Path

from replant.fleet.job import digest

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
