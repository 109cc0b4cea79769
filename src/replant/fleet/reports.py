"""Reports of single rigs, made where they are asked for: the first ones of a fleet by rank."""

from __future__ import annotations

import json
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replant.errors import InvalidArgumentError, ReplantError
from replant.fleet.catalogue import find_rigs
from replant.fleet.coordinate import carried_out
from replant.fleet.executors import workers
from replant.fleet.files import REPORTS, replacing, report_path
from replant.fleet.identify import result_of
from replant.fleet.job import Job, Rig
from replant.fleet.oddness import oddness_of
from replant.fleet.results import Fleet
from replant.fleet.rig_record import opened
from replant.fleet.watched_record import Watched
from replant.fleet.work import one_thread
from replant.report.html.report import write_report

MOST_REPORTS = 100  # reports that are made at most: each takes some seconds [count]


@dataclass(frozen=True)
class ReportTask:
    """The report of one rig, to be made by a worker.

    Attributes
    ----------
    job : Job
    rig : Rig
    folder : str
        Of the fleet.
    """

    job: Job
    rig: Rig
    folder: str


def write_reports(fleet: Fleet, count: int, executor: Executor | str | None = None) -> int:
    """Write the reports of the first rigs of a fleet by rank, and return how many were written.

    A rig that cannot be identified has no report.
    """
    if fleet.job is None:
        raise InvalidArgumentError("a fleet that was loaded has no options: call fit again, which does nothing twice")
    table = fleet.table()
    names = table.column("rig").to_pylist()
    first = {names[row] for row in oddness_of(table, fleet.structure).order[: min(count, MOST_REPORTS)].tolist()}
    rigs = [rig for rig in find_rigs(fleet.logs, fleet.by, leave_out=fleet.folder) if rig.name in first]
    (fleet.folder / REPORTS).mkdir(exist_ok=True)
    tasks = [ReportTask(fleet.job, rig, str(fleet.folder.absolute())) for rig in rigs]
    with workers(executor) as found:
        return sum(done for _, done in carried_out(found, write_one, tasks))


def write_one(task: ReportTask) -> int:
    """Write the report of a rig; return how many that are: 1, or 0 for a rig that cannot be identified."""
    rig, job = task.rig, task.job
    with one_thread():
        try:
            watched = Watched(opened(rig, job))
            result = result_of(watched, job, with_history=True)
        except MemoryError:
            raise
        except ReplantError:
            return 0
        shown, log = result.overview, watched.recording.held
        if shown is not None:
            log = watched.recording.newest(shown.newest_input, shown.newest_output, shown.newest_times)
        assert log is not None
        more: dict[str, Any] = {"title": rig.name, "python": _program(task)}
        if job.method == "fit":
            more["preprocess"] = job.preprocess.resolve(log.input, log.output)
        with replacing(Path(task.folder, report_path(rig.name))) as new:
            write_report(new, result, log, **more)
    return 1


def _program(task: ReportTask) -> str:
    """Return the Python program that loads the rig's model from the results of the fleet."""
    return (
        f"import replant as rp\n\nfleet = rp.fleet.load({task.folder!r})\n"
        f"model = fleet.model({json.dumps(task.rig.name, ensure_ascii=False)})\nprint(model)"
    )
