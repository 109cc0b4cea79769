"""Identify one rig after the other: what a worker of the fleet does."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from replant.data.logs import Recording
from replant.data.logs.arrow import CHECKED, SUFFIXES
from replant.errors import ReplantError, SystemRefusedError
from replant.fleet.job import MANIFEST, PARTS, Job, Rig, digest, printable, replacing
from replant.fleet.records import Watched, begin_of, opened
from replant.fleet.store import FAILED, Row, table_of
from replant.identified.model import Model
from replant.offline.fit import fit
from replant.operating_system import refusal
from replant.runs.result import Result, result_of_fit
from replant.runs.run import run_source
from replant.simulation.fitted_run import FITTED


def identify(rig: Rig, job: Job) -> Row:
    """Identify a rig; a rig that cannot be identified is a row as well."""
    begun = time.perf_counter()
    try:
        row = _identified(rig, job)
    except MemoryError as error:
        raise SystemRefusedError(f"rig {rig.name}: {refusal(error)}, or use the method run") from error
    except SystemRefusedError:
        raise
    except Exception as error:  # one rig is not the end of the others
        reason = str(error) if isinstance(error, ReplantError) else f"unexpected {type(error).__name__}: {error}"
        row = Row(rig.name, FAILED, (" ".join(reason.split()),), rig.pieces[0].name, len(rig.pieces))
    return dataclasses.replace(row, seconds=time.perf_counter() - begun)


def _identified(rig: Rig, job: Job) -> Row:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what a reader warns of stands in the notes
        recording = opened(rig, job)
        watched = Watched(recording)
        result = result_of(watched, job)
    verdict, begin = result.verdict, begin_of(rig, recording, job)
    stretch = (recording.samples - 1) * recording.dt
    if result.clock is not None and result.clock.irregular:
        stretch = float(result.clock.at(recording.samples - 1))
    notes = (*recording.table.notes, *((recording.irregularity,) if recording.irregular else ()))
    of = tuple(sorted(rig.pieces, key=lambda piece: piece.name))
    return Row(
        rig.name,
        verdict.status,
        verdict.reasons,
        of[0].name,
        len({piece.path for piece in of}),
        _named(result.model, recording),
        result.samples,
        tuple(result.rejected.items()),
        begin,
        begin + stretch,
        watched.movement,
        tuple(" ".join(note.replace(f"{Path(of[0].path).parent}/", "").split()) for note in notes),
    )


def result_of(watched: Watched, job: Job, *, with_history: bool = False) -> Result:
    """Return the result of a record by the job's method, as ``replant run`` or ``replant fit`` gives it."""
    recording, log = watched.recording, watched.recording.held
    if job.method == "run":
        newest = None if log is not None else FITTED
        request = job.request(recording.dt)
        irregular = recording.irregular
        return run_source(request, watched, newest=newest, irregular=irregular, with_history=with_history)
    assert log is not None
    for _ in watched.batches():  # it notes how the signals move
        pass
    begun = time.perf_counter()
    more: dict[str, Any] = {} if log.reference is None else {"reference": log.reference}
    fitted = fit(
        log.input, log.output, log.dt, job.structure, preprocess=job.preprocess, t=log.stamps, **more
    )  # fmt: skip
    return result_of_fit(fitted, log.input, log.output, begun, log.stamps)


def _named(model: Model, recording: Recording) -> Model:
    """Return a model with the names of its signals, and without a date: the same files give the same bytes."""
    entered, given = (recording.table.names[column] for column in recording.columns[:2])
    model = model.of_log(entered, given, printable(recording.path.name))
    return dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, date=""))


@dataclass(frozen=True)
class Done:
    """What a task reports."""

    key: str  # of the task
    rigs: int
    failed: int
    samples: int
    seconds: float  # time that the worker spent on the rigs


def carry_out(task: Task) -> Done:
    """Identify the rigs of a task, and write their results; this is what an executor calls."""
    from pyarrow import parquet

    with one_thread():
        rows = [identify(rig, task.job) for rig in task.rigs]
    folder = Path(task.folder)
    with replacing(folder / PARTS / f"{task.key}.parquet") as new:
        parquet.write_table(table_of(rows, task.job.structure), new, **CHECKED)
    entry = {"job": task.job.key, "rigs": {rig.name: rig.fingerprint for rig in task.rigs}}
    with replacing(folder / MANIFEST / f"{task.key}.json") as new:
        new.write_text(json.dumps(entry), encoding="utf-8")
    return Done(
        task.key,
        len(rows),
        sum(row.verdict == FAILED for row in rows),
        sum(row.samples for row in rows),
        sum(row.seconds for row in rows),
    )


@contextmanager
def one_thread() -> Iterator[None]:
    """Let the linear algebra of this process use one thread, so that no sum depends on their number.

    Without threadpoolctl the environment decides; workers of ours are started with one thread.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError):
            from threadpoolctl import threadpool_limits

            stack.enter_context(threadpool_limits(1))
        yield


FIXED = 100_000
"""Work of a rig beside its samples: starting, solving as a whole, judging; benchmarks/fleet measures it [samples that
take as long].
"""
TEXT_ROW, BINARY_ROW = 24, 12  # usual size of a row of time, input and output in text, and in other formats [bytes]
FEWEST, LARGEST = 64, 20_000_000
"""Tasks that a fleet is divided into at least, so that workers end together, and work of a task at most, so that little
is lost with a worker: about a minute [count, samples].
"""


@dataclass(frozen=True)
class Task:
    """A group of rigs that one worker identifies one after the other."""

    job: Job
    rigs: tuple[Rig, ...]
    folder: str  # where its part of the results is written, as every worker finds it

    @property
    def key(self) -> str:
        """Name of its part of the results: the same for the same rigs, files and options."""
        return digest(self.job.key, [(rig.name, rig.fingerprint) for rig in self.rigs])

    @property
    def work(self) -> int:
        """How long it takes, in samples that take as long."""
        return sum(map(work_of, self.rigs))


def work_of(rig: Rig) -> int:
    """Return how long a rig takes, in samples that take as long.

    Examples
    --------
    >>> from replant.fleet.job import Piece
    >>> work_of(Rig("a", (Piece("a.csv", "a.csv", size=2_400_000, modified=0),)))
    200000
    """
    rows = 0
    for piece in rig.pieces:
        suffix = Path(piece.path).suffix.lower()
        binary = suffix in SUFFIXES or suffix not in (".csv", ".txt", ".tsv", ".dat", ".jsonl")
        rows += piece.rows or piece.size // (BINARY_ROW if binary else TEXT_ROW)
    return FIXED + rows


def planned(job: Job, rigs: Sequence[Rig], folder: Path) -> list[Task]:
    """Return the tasks for rigs, which are sorted by name; those with the most work first.

    Examples
    --------
    >>> from replant.model.structure import Structure
    >>> tasks = planned(Job("u", "y", Structure(1)), [Rig(f"{k:03}", ()) for k in range(128)], Path("out"))
    >>> len(tasks), [rig.name for rig in tasks[0].rigs]
    (64, ['000', '001'])
    """
    share = min(LARGEST, sum(map(work_of, rigs)) / FEWEST)
    tasks = [Task(job, tuple(group), str(folder)) for group in _grouped(rigs, share)]
    return sorted(tasks, key=lambda task: -task.work)


def _grouped(rigs: Iterable[Rig], share: float) -> list[list[Rig]]:
    groups: dict[int, list[Rig]] = {}
    before = 0
    for rig in rigs:
        work = work_of(rig)
        groups.setdefault(int((before + work / 2) // share), []).append(rig)
        before += work
    return list(groups.values())
