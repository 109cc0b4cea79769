"""The structures that a search has tried: those worth reading as rows of a table, all as JSON."""

from __future__ import annotations

from typing import Any

from replant.assessment.verdict import percent as share
from replant.identified.model_json import finite
from replant.offline.structure_search import Candidate, SearchResult
from replant.report.number_format import percent

HEADINGS = ("poles", "zeros", "dead time", "fit", "least known coefficient", "evidence", "")
CHOSEN = "chosen"


def rows_of(found: SearchResult) -> list[tuple[str, ...]]:
    """Return a row for each structure worth reading, its evidence beside the most; the chosen one is marked."""
    rows: list[tuple[str, ...]] = []
    for candidate in found.likely:
        structure = candidate.structure
        size = (str(structure.poles), str(structure.zeros), f"{structure.delay:g} s")
        evidence = 0.5 * (found.likely[0].criterion - candidate.criterion)
        figures = (percent(candidate.fit), _known(candidate.uncertainty), f"{evidence:.1f}")
        rows.append((*size, *figures, CHOSEN if candidate is found.chosen else ""))
    return rows


def _known(uncertainty: float) -> str:
    """Return how well the least known coefficient is known.

    Examples
    --------
    >>> _known(0.021), _known(52.0)
    ('± 2.1 %', 'unknown')
    """
    return f"± {share(uncertainty)}" if uncertainty < 1.0 else "unknown"


def as_json(found: SearchResult) -> list[dict[str, Any]]:
    """Return an object of JSON for each structure; figures that are not finite become null."""
    return [_object(candidate, chosen=candidate is found.chosen) for candidate in found.candidates]


def _object(candidate: Candidate, *, chosen: bool) -> dict[str, Any]:
    structure = candidate.structure
    return {
        "poles": structure.poles,
        "zeros": structure.zeros,
        "delay": structure.delay,
        "fit": finite(candidate.fit),
        "uncertainty": finite(candidate.uncertainty),
        "likelihood": finite(candidate.likelihood),
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
    if found.rest:
        console.print(found.rest, highlight=False)
    if found.likely[0] is not found.chosen:
        console.print("Orders are compared with the dead time found between the points of the grid", highlight=False)
    delay = found.best.structure.delay
    if delay != found.chosen.structure.delay:
        console.print(f"\nThe dead time between the points of the grid: {delay:.4g} s", highlight=False)
