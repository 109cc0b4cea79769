"""The structures that a search has tried: as rows of a table, as JSON, and on the terminal."""

from __future__ import annotations

import math
from typing import Any

from replant.assessment.verdict import percent as share
from replant.identified.model_json import finite
from replant.offline.structure_search import Candidate, SearchResult
from replant.report.number_format import percent

HEADINGS = ("poles", "zeros", "dead time", "held-out fit", "least known coefficient", "criterion", "")
CHOSEN = "chosen"


def rows_of(found: SearchResult) -> list[tuple[str, ...]]:
    """Return a row of cells for each structure; the chosen one is marked."""
    rows: list[tuple[str, ...]] = []
    for candidate in found.candidates:
        structure, failed = candidate.structure, math.isinf(candidate.held_out)
        size = (str(structure.poles), str(structure.zeros), f"{structure.delay:g} s")
        figures = ("no model", "", "")
        if not failed:
            known = f"± {share(candidate.uncertainty)}"
            figures = (percent(candidate.held_out), known, f"{candidate.criterion:.0f}")
        mark = CHOSEN if candidate is found.chosen else "" if failed or candidate.is_known else "not known"
        rows.append((*size, *figures, mark))
    return rows


def as_json(found: SearchResult) -> list[dict[str, Any]]:
    """Return an object of JSON for each structure; figures that are not finite become null."""
    return [_object(candidate, chosen=candidate is found.chosen) for candidate in found.candidates]


def _object(candidate: Candidate, *, chosen: bool) -> dict[str, Any]:
    structure = candidate.structure
    return {
        "poles": structure.poles,
        "zeros": structure.zeros,
        "delay": structure.delay,
        "held_out": finite(candidate.held_out),
        "uncertainty": finite(candidate.uncertainty),
        "criterion": finite(candidate.criterion),
        "chosen": chosen,
    }


def print_candidates(console: Any, found: SearchResult) -> None:
    """Print the table, and the dead time where it lies between the points of the grid."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    for row in rows_of(found):
        table.add_row(*row, style="bold" if row[-1] == CHOSEN else None)
    console.print(table)
    delay = found.best.structure.delay
    if delay != found.chosen.structure.delay:
        console.print(f"\nThe dead time between the points of the grid: {delay:.4g} s", highlight=False)
