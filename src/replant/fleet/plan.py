"""Plan: the tasks (`Task`), groups of rigs of about equal work, from the sizes of their files."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from replant.data.logs.parquet import SUFFIXES
from replant.fleet.job import Job, Rig, digest

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
