"""Work: a worker identifies the rigs of a task, writes a part of the results, then its entry in the manifest."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from replant.data.logs.parquet import CHECKED
from replant.fleet.files import replacing
from replant.fleet.folder import MANIFEST, PARTS
from replant.fleet.identify import identify
from replant.fleet.plan import Task
from replant.fleet.result_row import FAILED, table_of


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
