"""``replant run``: one online pass over a recorded log."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import click

from replant.cli.options import (
    OPTIMIZER,
    log_options,
    recording_of,
    request_of,
)
from replant.cli.output import (
    deliver,
    make_folder,
)
from replant.cli.progress import progress_bar
from replant.cli.save_and_validate import Keeping, keeping_options
from replant.data.logs import Recording
from replant.runs.full_trace import FullTrace
from replant.runs.result import Result
from replant.runs.run import run_source
from replant.runs.run_log import judged_by_log
from replant.settings import Request
from replant.simulation.score import FITTED


@click.command(name="run")
@log_options(several="replant run takes one log, in one pass; replant fit makes one model of several")
@OPTIMIZER
@click.option("--startup", type=int, metavar="N", help="Number of samples for the first model.  [default: a tenth]")
@click.option(
    "--full-trace",
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Write the estimate after each sample (.parquet).",
)
@keeping_options
def run_command(as_json: bool, out: Path | None, full_trace: Path | None, startup: int | None, **options: Any) -> None:
    """Identify G(s) online from LOG (csv, mat, parquet and more; - is standard input), sample by sample in one pass.

    Settings that no option gives are chosen from the data, and printed as Python code.  LOG may be larger than memory.
    """
    keeping = Keeping.of(options)
    with progress_bar(rate=True) as bar:
        task = bar.add_task("checking", total=None)

        def progress(stage: str, done: int, total: int) -> None:
            if bar.tasks[task].description != stage:
                bar.reset(task, description=stage)
            bar.update(task, completed=done, total=total)

        recording = recording_of(options, lambda rows, about: progress("checking", rows, about))
        request = request_of(options, recording.dt)
        make_folder(out)
        stages = partial(_with_total, progress, recording.samples)
        result = _run(recording, request, full_trace, startup, stages)
    shown = result.overview
    log = recording.held
    if shown is not None:
        log = recording.newest(shown.newest_input, shown.newest_output, shown.newest_times)
    assert log is not None
    result = judged_by_log(result, log)
    if full_trace is not None and not as_json:
        click.echo(f"wrote {full_trace}")
    deliver(result, log, keeping, as_json=as_json, out=out)


def _with_total(progress: Callable[[str, int, int], None], total: int, stage: str, done: int) -> None:
    progress(stage, done, total)


def _run(
    recording: Recording,
    request: Request,
    full_trace: Path | None,
    startup: int | None,
    progress: Callable[[str, int], None],
) -> Result:
    newest = None if recording.held is not None else FITTED
    with nullcontext() if full_trace is None else FullTrace(full_trace, recording.dt) as trace:
        sink = (lambda rows: None) if trace is None else trace.take
        return run_source(request, recording, progress, sink, newest, startup, recording.irregular)
