"""Work: tasks of about equal work; a worker identifies the rigs of one, and writes a part of the results."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from replant.data.logs.arrow import CHECKED, SUFFIXES
from replant.fleet.files import MANIFEST, PARTS, replacing
from replant.fleet.identify import identify
from replant.fleet.job import Job, Rig, digest
from replant.fleet.store import FAILED, table_of


@dataclass(frozen=True)
class Done:
    """What a task reports.

    Attributes
    ----------
    key : str
        Of the task.
    rigs, failed : int
    samples : int
    seconds : float
        Time that the worker spent on the rigs.
    """

    key: str
    rigs: int
    failed: int
    samples: int
    seconds: float


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
    """A group of rigs that one worker identifies one after the other.

    Attributes
    ----------
    job : Job
    rigs : tuple of Rig
    folder : str
        Where its part of the results is written, as every worker finds it.
    """

    job: Job
    rigs: tuple[Rig, ...]
    folder: str

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
