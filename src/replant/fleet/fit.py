"""fit: a model of every rig of a fleet, on the cores of one machine or of many."""

from __future__ import annotations

import os
import shutil
import tempfile
import weakref
from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

from replant.fleet.catalogue import find_rigs
from replant.fleet.coordinate import Progress, carried_out
from replant.fleet.executors import workers
from replant.fleet.job import Job
from replant.fleet.results import Fleet
from replant.fleet.store import Store
from replant.fleet.work import carry_out, one_thread, planned
from replant.limits import file_path
from replant.model.structure import Structure
from replant.optimizers import Optimizer
from replant.settings import AUTO

AnyPath = str | os.PathLike[str]


def fit(
    logs: AnyPath,
    *,
    by: str,
    input: str | int,  # noqa: A002 - the field's word
    output: str | int,
    structure: Structure | None = None,
    poles: int | None = None,
    zeros: int = 0,
    delay: float = 0.0,
    method: str = "run",
    executor: Executor | str | None = None,
    out: AnyPath | None = None,
    reference: str | int | None = None,
    time: str | int | None = None,
    dt: float | None = None,
    begin: float | None = None,
    end: float | None = None,
    input_map: str = "identity",
    optimizer: Optimizer | str = AUTO,
    progress: Callable[[Progress], None] | None = None,
) -> Fleet:
    """Identify every rig of a fleet, each by itself, and write one row a rig.

    Rigs that an earlier call with the same options has done stay as they are, unless their files have changed.  A rig
    that cannot be identified is a row with the verdict "failed" and the reason.

    >>> import tempfile
    >>> import numpy as np
    >>> from replant import TransferFunction
    >>> u = np.where(np.arange(1000) // 50 % 2 == 0, 1.0, -1.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for rig, gain in (("a", 2.0), ("b", 3.0)):
    ...         y = TransferFunction([gain], [1.0, 0.5]).simulate(u, dt=0.1)
    ...         np.savez(Path(folder, f"{rig}.npz"), t=0.1 * np.arange(1000), u=u, y=y)
    ...     found = fit(folder, by="file", input="u", output="y", poles=1, method="fit")
    ...     found.verdicts, found.column("b0").round(6), found.model("b.npz")
    ({'trusted': 2}, array([2., 3.]), <Model 3 / (s + 0.5): u -> y, fit 100.0 %, trusted>)
    """
    structure = Structure.wanted(structure, poles, zeros, delay)
    job = Job(input, output, structure, method, reference, time, dt, begin, end, input_map, optimizer)
    logs = file_path("logs", logs)
    folder = Path(tempfile.mkdtemp(prefix="replant-fleet-") if out is None else file_path("out", out))
    rigs = find_rigs(logs, by, leave_out=folder)
    store = Store(folder, job)
    with store.alone():
        done = store.done(rigs)
        missing = [rig for rig in rigs if rig.name not in done]
        store.forget_reports(missing)
        _identify_all(store, missing, len(rigs), executor, progress or (lambda state: None))
        fleet = Fleet(folder, structure, str(input), str(output), os.fspath(logs), by, job)
        if out is None:
            weakref.finalize(fleet, shutil.rmtree, folder, ignore_errors=True)
        store.merge(rigs, _about(fleet, job))
    return fleet


def _identify_all(
    store: Store, missing: list[Any], rigs: int, on: Executor | str | None, progress: Callable[[Progress], None]
) -> None:
    tasks = planned(store.job, missing, store.folder) if missing else []
    work, ended, failed, samples = sum(task.work for task in tasks), 0, 0, 0
    count = rigs - len(missing)
    progress(Progress(rigs, count, 0, 0, 0.0 if tasks else 1.0))
    if not tasks:
        return
    with workers(on) as found, one_thread():
        for number, done in carried_out(found, carry_out, tasks):
            ended += tasks[number].work
            count, failed, samples = count + done.rigs, failed + done.failed, samples + done.samples
            progress(Progress(rigs, count, failed, samples, ended / work))


def _about(fleet: Fleet, job: Job) -> dict[str, Any]:
    s = fleet.structure
    structure = {"poles": s.poles, "zeros": s.zeros, "delay": s.delay, "bias": s.bias, "feedthrough": s.feedthrough}
    return {
        "structure": structure, "input_name": fleet.input_name, "output_name": fleet.output_name, "logs": fleet.logs,
        "by": fleet.by, "method": job.method,
    }  # fmt: skip
