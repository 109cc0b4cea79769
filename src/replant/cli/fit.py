"""``replant fit``: a whole recorded log at once."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from replant.cli.options import log_options, open_log
from replant.cli.output import deliver
from replant.offline import fit
from replant.report.recipe import fit_as_python
from replant.runs import result_of_fit


@click.command(name="fit")
@log_options
def command(as_json: bool, out: Path | None, **options: Any) -> None:
    """Fit G(s) to all of LOG (csv, txt, parquet, mat, npz) by least squares: the batch reference of `run`."""
    log, request = open_log(options)
    begun = time.perf_counter()
    fitted = fit(log.input, log.output, log.dt, request.structure, preprocess=request.preprocess)
    python = fit_as_python(fitted, log)
    report = {"filter": fitted.fixed_filter, "preprocess": fitted.preprocess, "python": python}
    deliver(result_of_fit(fitted, begun), log, as_json=as_json, out=out, **report)
