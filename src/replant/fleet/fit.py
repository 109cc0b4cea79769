"""Fit a fleet, and open its results."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import weakref
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replant.errors import InvalidArgumentError, LogError
from replant.fleet.catalogue import find_rigs
from replant.fleet.executors import Progress, carried_out, workers
from replant.fleet.job import ABOUT, MODELS, TABLE, Job
from replant.fleet.store import Store, column, read_table
from replant.fleet.work import carry_out, one_thread, planned
from replant.identified.model import Model
from replant.limits import file_path
from replant.model.structure import Structure
from replant.optimizers import Optimizer
from replant.settings import AUTO


@dataclass(frozen=True, eq=False)
class Fleet:
    """The results of a fleet.

    Attributes
    ----------
    folder : Path
        Holds ``rigs.parquet`` with one row a rig, ``models.jsonl``, ``timing.parquet`` and ``report.html``.
    structure : Structure
        Of all models.
    input_name, output_name : str
        The columns that were asked for.
    logs, by : str
        What was identified.
    job : Job or None
        How it was identified; None for results that were loaded.
    """

    folder: Path
    structure: Structure
    input_name: str = "u"
    output_name: str = "y"
    logs: str = ""
    by: str = ""
    job: Job | None = None

    def table(self) -> Any:
        """Return one row a rig as a `pyarrow.Table`, sorted by rig."""
        return read_table(self.folder, TABLE)

    def to_pandas(self) -> Any:
        """Return one row a rig as a `pandas.DataFrame`, sorted by rig."""
        return self.table().to_pandas()

    def __len__(self) -> int:
        return int(self.table().num_rows)

    @property
    def verdicts(self) -> dict[str, int]:
        """How many rigs have each verdict, the most frequent first; "failed" are those without a model."""
        counts = self.table().column("verdict").value_counts().to_pylist()
        return {
            each["values"]: each["counts"] for each in sorted(counts, key=lambda one: (-one["counts"], one["values"]))
        }

    def model(self, rig: str) -> Model:
        """Return the model of a rig.

        Parameters
        ----------
        rig : str

        Raises
        ------
        InvalidArgumentError
            If there is no such rig, or it has no model.
        """
        begin = f'{{"rig": {json.dumps(rig)}, "model": '
        with (self.folder / MODELS).open(encoding="utf-8") as lines:
            for line in lines:
                if line.startswith(begin):
                    return Model.from_json(line[len(begin) : -2])
        raise InvalidArgumentError(f"{self.folder}: no rig {rig!r} with a model")

    def column(self, name: str) -> Any:
        """Return a column of numbers (N,) as float64, in the order of the rigs; NaN where a figure is not known."""
        return column(self.table(), name)


def load(folder: str | Path) -> Fleet:
    """Return the results in a folder that `fit` or ``replant fleet --out`` has written.

    Raises
    ------
    LogError
        If there are none.

    Examples
    --------
    >>> load("no-such-folder")
    Traceback (most recent call last):
    replant.errors.LogError: no-such-folder: no results of `replant fleet` there (fleet.json cannot be read)
    """
    folder = file_path("folder", folder)
    try:
        about = json.loads(Path(folder, ABOUT).read_text(encoding="utf-8"))
        structure = Structure(**about["structure"])
        entered, given, logs, by = (str(about[name]) for name in ("input_name", "output_name", "logs", "by"))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise LogError(f"{folder}: no results of `replant fleet` there ({ABOUT} cannot be read)") from error
    return Fleet(Path(folder), structure, entered, given, logs, by)


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
