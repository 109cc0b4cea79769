"""Where the report of a rig lies in the folder of a fleet."""

from __future__ import annotations

import re

from replant.fleet.job import digest

REPORTS = "reports"


def report_path(rig: str) -> str:
    """Return the path of a rig's report, from the folder of the fleet on; rigs with like names have different ones.

    Examples
    --------
    >>> report_path("hall 2/rig 7.csv")
    'reports/hall-2-rig-7-csv-5b25fc.html'
    """
    plain = re.sub(r"[^A-Za-z0-9]+", "-", rig).strip("-")[:60]
    return f"{REPORTS}/{plain}-{digest(rig)[:6]}.html"
