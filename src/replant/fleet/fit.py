"""Fit a fleet, and load its results; sweep a function or a grid of settings over records."""

from __future__ import annotations

import itertools
import json
import os
import pickle
import shutil
import tempfile
import weakref
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, TypeVar, overload

from replant.errors import ArgumentTypeError, InvalidArgumentError, LogError, ReplantError, shown
from replant.estimation.optimizers import Optimizer
from replant.estimation.settings import AUTO
from replant.fitting.miso_model import RowModel
from replant.fitting.model import Model
from replant.fitting.model_json import STRUCTURE
from replant.fleet.catalogue import find_rigs
from replant.fleet.executors import Progress, carried_out, workers
from replant.fleet.job import ABOUT, MODELS, Job, Shape, wanted
from replant.fleet.store import Store, column, read_table, verdicts_of
from replant.fleet.worker import identify_all
from replant.model.structure import Structure
from replant.numerics.arguments import iterable
from replant.numerics.limits import file_path
from replant.online.runs.run_log import run

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, eq=False)
class Trial:
    """The result of one setting of a grid on one record.

    Attributes
    ----------
    settings : tuple of (str, object)
        Arguments of `replant.run`, by name.
    record : int
        Number of the record, from 0.
    model : Model or None
        None if the record could not be identified.
    problem : str
        Why it could not be identified; empty if it could.
    """

    settings: tuple[tuple[str, Any], ...]
    record: int
    model: Model | None
    problem: str = ""


@overload
def sweep(
    function: Callable[[T], R],
    records: Iterable[T],
    executor: Executor | str | None = None,
    progress: Callable[[int, int], None] | None = ...,
) -> list[R]: ...


@overload
def sweep(
    function: Mapping[str, Sequence[Any]],
    records: Iterable[Any],
    executor: Executor | str | None = None,
    progress: Callable[[int, int], None] | None = ...,
) -> list[Trial]: ...


def sweep(
    function: Any,
    records: Iterable[Any],
    executor: Executor | str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Any]:
    """Call a function with every record, or run every setting of a grid on every record.

    The results do not depend on the executor, nor on the order in which the work ends.

    >>> sweep(abs, [-1, 2, -3], executor="threads:2")
    [1, 2, 3]
    >>> import numpy as np
    >>> from replant import TransferFunction
    >>> u = np.where(np.arange(1000) // 50 % 2 == 0, 1.0, -1.0)
    >>> y = TransferFunction([2.0], [1.0, 0.5]).simulate(u, dt=0.1)
    >>> for trial in sweep({"poles": [1, 2]}, [(u, y, 0.1)]):
    ...     print(trial.settings, trial.model.structure.poles)
    (('poles', 1),) 1
    (('poles', 2),) 2
    """
    if isinstance(function, Mapping):
        tasks: list[Any] = _trials(function, records)
        call: Callable[[Any], Any] = _tried
    elif callable(function):
        _check_sendable(function, executor)
        tasks, call = _listed(records), partial(_called, function)
    else:
        raise ArgumentTypeError(f"sweep needs a function or a grid of settings, got {type(function).__name__}")
    results: list[Any] = [None] * len(tasks)
    with workers(executor) as found:
        for done, (number, result) in enumerate(carried_out(found, call, tasks), 1):
            results[number] = result
            if progress is not None:
                progress(done, len(tasks))
    return results


def _called(function: Callable[[T], R], record: T) -> R:
    try:
        return function(record)
    except Exception as error:
        if parent_process() is None:
            raise
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:  # sent as it is, an error whose arguments are not its text would often break the pool
            raise RuntimeError(f"{type(error).__name__}: {error}") from None
        raise


def _check_sendable(function: Any, executor: Executor | str | None) -> None:
    """Check that a function can be called by other processes."""
    if not (isinstance(executor, str) and executor.startswith("processes:")):
        return
    try:
        pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidArgumentError(
            f"the function cannot be sent to other processes ({error}): define it at the top of a module, or use "
            "threads:N"
        ) from error


def _listed(records: Iterable[T]) -> list[T]:
    if not iterable(records):
        raise ArgumentTypeError(f"records must be a sequence of records, got {type(records).__name__}")
    return list(records)


def _trials(grid: Mapping[str, Sequence[Any]], records: Iterable[Any]) -> list[tuple[dict[str, Any], int, Any]]:
    if not grid:
        raise InvalidArgumentError("the grid is empty: give the values to try by name, such as {'poles': [1, 2]}")
    for name, values in grid.items():
        if isinstance(values, str) or not isinstance(values, Sequence):
            raise InvalidArgumentError(
                f"the grid's {name} must be a sequence of the values to try, got {shown(values)}"
            )
    held = _listed(records)
    combined = [dict(zip(grid, values, strict=True)) for values in itertools.product(*grid.values())]
    return [(settings, number, record) for settings in combined for number, record in enumerate(held)]


def _tried(task: tuple[dict[str, Any], int, Any]) -> Trial:
    settings, number, record = task
    named = tuple(settings.items())
    try:
        result = run(*record, **settings) if isinstance(record, tuple) else run(record, **settings)
    except ReplantError as problem:
        return Trial(named, number, None, str(problem))
    return Trial(named, number, result.model)


@dataclass(frozen=True, eq=False)
class Fleet:
    """The results of a fleet.

    Attributes
    ----------
    folder : Path
        Contains ``rigs.parquet`` with one row per rig, ``models.jsonl``, ``timing.parquet`` and ``report.html``.
    structure : Structure or tuple of Structure
        Structure of all models; for several inputs one for each.
    input_name : str or tuple of str
    output_name : str
        The requested columns.
    logs, by : str
        The identified logs, and what names their rigs.
    job : Job or None
        The options of the identification; None for loaded results.
    left_out : tuple of str
        Texts among the logs that hold no rows of numbers, such as notes.
    """

    folder: Path
    structure: Structure | tuple[Structure, ...]
    input_name: str | tuple[str, ...] = "u"
    output_name: str = "y"
    logs: str = ""
    by: str = ""
    job: Job | None = None
    left_out: tuple[str, ...] = ()

    @property
    def shape(self) -> Shape:
        """The structure of the models with the names of several inputs, which determine the columns of the table."""
        return Shape.of(self.structure, self.input_name)

    def table(self) -> Any:
        """Return one row per rig as a `pyarrow.Table`, sorted by rig."""
        return read_table(self.folder)

    def to_pandas(self) -> Any:
        """Return one row per rig as a `pandas.DataFrame`, sorted by rig."""
        return self.table().to_pandas()

    def __len__(self) -> int:
        return int(self.table().num_rows)

    @property
    def verdicts(self) -> dict[str, int]:
        """Number of rigs by verdict, the most frequent first; "failed" are rigs without a model."""
        counts = Counter(verdicts_of(self.table()).tolist())
        return dict(sorted(counts.items(), key=lambda each: (-each[1], each[0])))

    def model(self, rig: str) -> Model | RowModel:
        """Return the model of a rig.

        Parameters
        ----------
        rig : str

        Returns
        -------
        Model or RowModel
            A RowModel for several inputs.

        Raises
        ------
        InvalidArgumentError
            If there is no such rig, or it has no model.
        """
        begin = f'{{"rig": {json.dumps(rig)}, "model": '
        with (self.folder / MODELS).open(encoding="utf-8") as lines:
            for line in lines:
                if line.startswith(begin):
                    kind = RowModel if isinstance(self.structure, tuple) else Model
                    return kind.from_json(line[len(begin) : -2])
        raise InvalidArgumentError(f"{self.folder}: no rig {rig!r} with a model")

    def column(self, name: str) -> Any:
        """Return a column of numbers (N,) as float64, in the order of the rigs; NaN if unknown."""
        return column(self.table(), name)


def load(folder: str | Path) -> Fleet:
    """Load the results from a folder that `fit` or ``replant fleet --out`` has written.

    Raises
    ------
    LogError
        If there are no results.

    Examples
    --------
    >>> load("no-such-folder")
    Traceback (most recent call last):
    replant.errors.LogError: no-such-folder: no results of `replant fleet` there (fleet.json cannot be read)
    """
    folder = file_path("folder", folder)
    try:
        about = json.loads(Path(folder, ABOUT).read_text(encoding="utf-8"))
        shapes, entered = about["structure"], about["input_name"]
        several = isinstance(shapes, list)
        structure = tuple(Structure(**each) for each in shapes) if several else Structure(**shapes)
        entered = tuple(map(str, entered)) if several else str(entered)
        given, logs, by = (str(about[name]) for name in ("output_name", "logs", "by"))
        left_out = tuple(map(str, about.get("left_out", ())))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise LogError(f"{folder}: no results of `replant fleet` there ({ABOUT} cannot be read)") from error
    return Fleet(Path(folder), structure, entered, given, logs, by, left_out=left_out)


AnyPath = str | os.PathLike[str]


def fit(
    logs: AnyPath,
    *,
    by: str,
    input: str | int | Sequence[str | int],  # noqa: A002 - the field's word
    output: str | int,
    structure: Structure | Sequence[Structure] | None = None,
    poles: int | tuple[int, ...] | None = None,
    zeros: int | tuple[int, ...] = 0,
    delay: float | tuple[float, ...] = 0.0,
    method: str = "run",
    executor: Executor | str | None = None,
    out: AnyPath | None = None,
    reference: str | int | Sequence[str | int] | None = None,
    time: str | int | None = None,
    dt: float | None = None,
    begin: float | None = None,
    end: float | None = None,
    input_map: str = "identity",
    optimizer: Optimizer | str = AUTO,
    progress: Callable[[Progress], None] | None = None,
) -> Fleet:
    """Identify each rig of a fleet separately, and write one row per rig.

    Rigs that an earlier call with the same options has identified are kept, unless their files have changed.  A rig
    that cannot be identified gives a row with the verdict "failed" and the reason.

    For several inputs, ``input`` is a list of columns, and ``poles``, ``zeros`` and ``delay`` have one entry for each;
    the table's columns about one input end in its name, as ``dc_gain.Q1``.

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
    columns: Any = (*input,) if iterable(input) else input  # type: ignore[misc]
    asked, r = wanted(columns, structure, poles, zeros, delay), reference
    job = Job(columns, output, asked, method, r, time, dt, begin, end, input_map, optimizer)  # type: ignore[arg-type]
    logs = file_path("logs", logs)
    folder = Path(tempfile.mkdtemp(prefix="replant-fleet-") if out is None else file_path("out", out))
    left_out: list[str] = []
    rigs = find_rigs(logs, by, leave_out=folder, no_log=left_out.append)
    store = Store(folder, job)
    with store.alone():
        missing = store.missing(rigs)
        store.forget_reports(missing)
        identify_all(store, missing, len(rigs), executor, progress or (lambda state: None))
        names = tuple(map(str, columns)) if isinstance(columns, tuple) else str(columns)
        fleet = Fleet(folder, job.structure, names, str(output), os.fspath(logs), by, job, tuple(left_out))
        if out is None:
            weakref.finalize(fleet, shutil.rmtree, folder, ignore_errors=True)
        structures = [{name: getattr(each, name) for name in STRUCTURE} for each in fleet.shape.structures]
        about: dict[str, Any] = {"structure": structures if job.several else structures[0]}
        about |= {name: getattr(fleet, name) for name in ("input_name", "output_name", "logs", "by")}
        store.merge({**about, "method": job.method, "job": job.key, "left_out": fleet.left_out})
    return fleet
