"""``replant run``: one online pass over a recorded log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from replant.cli.options import log_options, open_log
from replant.cli.output import deliver
from replant.optimizers import OPTIMIZERS
from replant.runs import run_online


@click.command(name="run")
@log_options
@click.option("--optimizer", type=click.Choice(["auto", *OPTIMIZERS]), default="auto", show_default=True)
@click.option("--startup", type=int, metavar="N", help="Samples that the first model is made from.  [default: a tenth]")
def command(as_json: bool, out: Path | None, startup: int | None, **options: Any) -> None:
    """Identify G(s) online from LOG (csv, txt, parquet, mat, npz), one pass, sample by sample.

    Cutoff, scaling, step size and buffer are chosen from the data and printed.
    """
    log, request = open_log(options)
    deliver(run_online(request, log.input, log.output, startup=startup), log, as_json=as_json, out=out)
