"""``replant fit``: fits one structure, or a grid of structures, to a whole recorded log."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from replant.cli.options import (
    open_log,
    preprocess_of,
    read,
    search_options,
)
from replant.cli.output import deliver, make_folder
from replant.data.logs import Log
from replant.offline.fit import METHODS, FitResult, fit
from replant.offline.structure_search import SearchResult, search
from replant.report.html.python_program import fit_as_python
from replant.runs.result import result_of_fit


@click.command(name="fit")
@search_options
@click.option("--method", type=click.Choice(METHODS), default="auto", show_default=True, help="Method of the fit.")
def command(as_json: bool, out: Path | None, method: str, **options: Any) -> None:
    """Fit G(s) to all of LOG (csv, txt, parquet, mat, npz): refined instrumental variables, or least squares.

    With a range of poles, zeros or dead times, every structure of the grid is fitted to the first 70 % of the record
    and judged by its simulated fit on the rest.  Of the structures within half a percentage point of the best fit, the
    one with the fewest parameters is chosen; among equals the one with the smallest criterion (BIC).
    """
    begun = time.perf_counter()
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
    _deliver(fitted, log, begun, as_json=as_json, out=out)


def _search(log: Log, options: dict[str, Any]) -> SearchResult:
    zeros = options["zeros"]
    if zeros is None and len(options["poles"]) == 1:
        zeros = (0,)
    return search(
        log.input,
        log.output,
        log.dt,
        poles=options["poles"],
        zeros=zeros,
        delays=options["delay"],
        bias=options["bias"],
        preprocess=preprocess_of(options),
        **_reference(log),
    )


def _reference(log: Log) -> dict[str, Any]:
    return {} if log.reference is None else {"reference": log.reference}


def _deliver(fitted: FitResult, log: Log, begun: float, *, as_json: bool, out: Path | None) -> None:
    report = {"filter": fitted.fixed_filter, "preprocess": fitted.preprocess, "python": fit_as_python(fitted, log)}
    deliver(result_of_fit(fitted, log.input, log.output, begun), log, as_json=as_json, out=out, **report)


def _print_candidates(found: SearchResult) -> None:
    """Print the structures that were tried; the chosen one is marked."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("poles", "zeros", "dead time", "held-out fit", "criterion", ""):
        table.add_column(heading, justify="right")
    for candidate in found.candidates:
        structure = candidate.structure
        chosen = structure == found.best.structure
        failed = candidate.held_out == float("-inf")
        table.add_row(
            str(structure.poles),
            str(structure.zeros),
            f"{structure.delay:g} s",
            "no model" if failed else f"{candidate.held_out:.1f} %",
            "" if failed else f"{candidate.criterion:.0f}",
            "chosen" if chosen else "",
            style="bold" if chosen else None,
        )
    Console().print(table)
