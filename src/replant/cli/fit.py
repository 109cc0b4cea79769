"""``replant fit``: fits one structure, or a grid of structures, to a whole recorded log."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from replant.cli.nearest_word import Choice
from replant.cli.options import (
    preprocess_of,
    read_several,
    request_of,
    search_options,
    structure_of,
)
from replant.cli.output import deliver, make_folder
from replant.cli.progress import progress_bar
from replant.cli.save_and_validate import Keeping, keeping_options
from replant.data.logs import Log
from replant.offline.fit import METHODS, fit
from replant.offline.fit_result import FitResult
from replant.offline.samples import Samples
from replant.offline.structure_search import SearchResult, search
from replant.report.html.python_program import fit_as_python
from replant.report.terminal import candidates
from replant.runs.result import result_of_fit


@click.command(name="fit")
@search_options
@click.option("--method", type=Choice(METHODS), default="auto", show_default=True, help="Method of the fit.")
@keeping_options
def fit_command(as_json: bool, out: Path | None, method: str, **options: Any) -> None:
    """Fit G(s) to all of LOG (csv, mat, parquet and more; - is standard input).

    Several logs of one rig give one model: of each, offset and initial state are its own.

    The method is refined instrumental variables, or least squares.

    With a range of poles, zeros or dead times, the structure with the most evidence is chosen: the log-likelihood of
    all samples, less ln(K) / 2 for every number that is fitted to K samples (BIC).  Structures that cannot win are left
    early.  The dead time is found between the points of the grid.
    """
    from rich.console import Console

    keeping, begun, found = Keeping.of(options), time.perf_counter(), None
    if any(len(options[name] or ()) > 1 for name in ("poles", "zeros", "delay")):
        if method == "least_squares":
            raise click.UsageError("a range of structures is searched by srivc: drop --method least_squares")
        if options["feedthrough"]:
            raise click.UsageError("a range of structures is searched without --feedthrough: give one number of each")
        logs = read_several(options)
        make_folder(out)
        found = _search(logs, options)
        fitted = found.best
        if not as_json:
            candidates.print_candidates(Console(), found)
    else:
        structure_of(options)
        logs = read_several(options)
        request = request_of(options, logs[0].dt)
        make_folder(out)
        given = logs if len(logs) > 1 else logs[0]
        fitted = fit(given, structure=request.structure, method=method, preprocess=request.preprocess)
    _deliver(fitted, logs, begun, found, keeping, as_json=as_json, out=out)


def _search(logs: list[Log], options: dict[str, Any]) -> SearchResult:
    zeros = options["zeros"]
    if zeros is None and len(options["poles"]) == 1:
        zeros = (0,)
    with progress_bar() as bar:
        task = bar.add_task("structures", total=None)
        return search(
            logs if len(logs) > 1 else logs[0],
            poles=options["poles"],
            zeros=zeros,
            delays=options["delay"],
            bias=options["bias"],
            preprocess=preprocess_of(options),
            progress=lambda done, of: bar.update(task, completed=done, total=of),
        )


def _deliver(
    fitted: FitResult,
    logs: list[Log],
    begun: float,
    found: SearchResult | None,
    keeping: Keeping,
    *,
    as_json: bool,
    out: Path | None,
) -> None:
    log = _as_one(logs)
    report: dict[str, Any] = {
        "filter": fitted.fixed_filter, "preprocess": fitted.preprocess, "python": fit_as_python(fitted, logs)
    }  # fmt: skip
    more = {}
    if found is not None:
        report["candidates"] = candidates.HEADINGS, candidates.rows_of(found), found.rest
        more["candidates"] = candidates.as_json(found)
    result = result_of_fit(fitted, log.input, log.output, begun, log.stamps)
    deliver(result, log, keeping, as_json=as_json, out=out, more=more, **report)


def _as_one(logs: list[Log]) -> Log:
    """Return several logs as one, for plots of them; a single one as it is."""
    if len(logs) == 1:
        return logs[0]
    all_of = Samples.of_several(logs)
    return Log(
        all_of.u, all_of.y, all_of.dt, all_of.t, all_of.input_name, all_of.output_name, Path(all_of.source),
        reference=all_of.reference, reference_name=all_of.reference_name, irregular=True, input_hold=all_of.input_hold,
    )  # fmt: skip
