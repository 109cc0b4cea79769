"""``replant fit``: fits one structure, or a grid of structures, to a whole recorded log."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from replant.assessment.verdict import percent
from replant.cli.options import (
    open_log,
    preprocess_of,
    read,
    search_options,
)
from replant.cli.output import deliver, make_folder
from replant.data.logs import Log
from replant.offline.fit import METHODS, FitResult, fit
from replant.offline.structure_search import Candidate, SearchResult, search
from replant.report.html.python_program import fit_as_python
from replant.runs.result import result_of_fit


@click.command(name="fit")
@search_options
@click.option("--method", type=click.Choice(METHODS), default="auto", show_default=True, help="Method of the fit.")
def command(as_json: bool, out: Path | None, method: str, **options: Any) -> None:
    """Fit G(s) to all of LOG (csv, txt, parquet, mat, npz): refined instrumental variables, or least squares.

    With a range of poles, zeros or dead times, every structure of the grid is fitted to the first 70 % of the record
    and judged by its simulated fit on the rest, and to the last 70 %.  Those with a coefficient that is not known are
    left out.  Of the structures that predict no worse than the best one, by a standard error or by half a point of fit,
    the one with the fewest parameters is chosen; among equals the one with the smallest criterion (BIC).  Its dead time
    is then found between the points of the grid.
    """
    begun, found = time.perf_counter(), None
    if any(len(options[name] or ()) > 1 for name in ("poles", "zeros", "delay")):
        if method == "least_squares":
            raise click.UsageError("a range of structures is searched by srivc: drop --method least_squares")
        log = read(options)
        make_folder(out)
        found = _search(log, options)
        fitted = found.best
        if not as_json:
            _print_candidates(found)
    else:
        log, request = open_log(options)
        make_folder(out)
        fitted = fit(
            log.input, log.output, log.dt, request.structure, method=method, preprocess=request.preprocess,
            **_reference(log),
        )  # fmt: skip
    _deliver(fitted, log, begun, found, as_json=as_json, out=out)


def _search(log: Log, options: dict[str, Any]) -> SearchResult:
    zeros = options["zeros"]
    if zeros is None and len(options["poles"]) == 1:
        zeros = (0,)
    with _progress() as show:
        return search(
            log.input,
            log.output,
            log.dt,
            poles=options["poles"],
            zeros=zeros,
            delays=options["delay"],
            bias=options["bias"],
            preprocess=preprocess_of(options),
            progress=show,
            **_reference(log),
        )


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Show on a terminal how many structures were tried; elsewhere nothing."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("structures", total=None)
        yield lambda done, of: bar.update(task, completed=done, total=of)


def _reference(log: Log) -> dict[str, Any]:
    return {} if log.reference is None else {"reference": log.reference}


def _deliver(
    fitted: FitResult, log: Log, begun: float, found: SearchResult | None, *, as_json: bool, out: Path | None
) -> None:
    report: dict[str, Any] = {
        "filter": fitted.fixed_filter, "preprocess": fitted.preprocess, "python": fit_as_python(fitted, log)
    }  # fmt: skip
    more = {}
    if found is not None:
        report["candidates"] = HEADINGS, _candidates(found)
        more["candidates"] = [_as_json(candidate, found) for candidate in found.candidates]
    deliver(result_of_fit(fitted, log.input, log.output, begun), log, as_json=as_json, out=out, more=more, **report)


HEADINGS = ("poles", "zeros", "dead time", "held-out fit", "least known coefficient", "criterion", "")


def _candidates(found: SearchResult) -> list[tuple[str, ...]]:
    """Return the structures that were tried as rows of a table; the chosen one is marked."""
    rows: list[tuple[str, ...]] = []
    for candidate in found.candidates:
        structure, failed = candidate.structure, math.isinf(candidate.held_out)
        size = (str(structure.poles), str(structure.zeros), f"{structure.delay:g} s")
        figures = ("no model", "", "")
        if not failed:
            known = f"± {percent(candidate.uncertainty)}"
            figures = (f"{candidate.held_out:.1f} %", known, f"{candidate.criterion:.0f}")
        mark = "chosen" if candidate is found.chosen else "" if failed or candidate.is_known else "not known"
        rows.append((*size, *figures, mark))
    return rows


def _as_json(candidate: Candidate, found: SearchResult) -> dict[str, Any]:
    """Return a structure that was tried as an object of JSON; a figure that is not finite becomes null."""
    structure = candidate.structure
    figures = {name: getattr(candidate, name) for name in ("held_out", "uncertainty", "criterion")}
    return {
        "poles": structure.poles,
        "zeros": structure.zeros,
        "delay": structure.delay,
        **{name: value if math.isfinite(value) else None for name, value in figures.items()},
        "chosen": candidate is found.chosen,
    }


def _print_candidates(found: SearchResult) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in HEADINGS:
        table.add_column(heading, justify="right")
    for row in _candidates(found):
        table.add_row(*row, style="bold" if row[-1] == "chosen" else None)
    Console().print(table)
    delay = found.best.structure.delay
    if delay != found.chosen.structure.delay:
        click.echo(f"\nThe dead time between the points of the grid: {delay:.4g} s")
