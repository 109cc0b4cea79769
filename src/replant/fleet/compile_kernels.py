"""Kernels compiled once per machine: the first worker compiles under a lock, the others then load from the cache."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ReplantError
from replant.fleet.job import Job
from replant.offline.fit import fit
from replant.runs.run import run_online

SAMPLES = 400
"""Length of the record that the kernels are compiled with [samples]."""
_ready: set[str] = set()


def warm_up(job: Job) -> None:
    """Have the kernels of a job compiled, or loaded from the cache; once in each process."""
    if job.key in _ready:
        return
    with _alone_on_this_machine():
        u = np.where(np.random.default_rng(0).integers(0, 2, SAMPLES // 10).repeat(10) > 0, 1.0, -1.0)
        y = np.convolve(u, 0.1 * 0.9 ** np.arange(100))[:SAMPLES]
        reference: Any = None if job.reference is None else u
        with contextlib.suppress(ReplantError):  # what is compiled counts, not the model
            if job.method == "run":
                run_online(job.request(0.1), u, y, reference=reference)
            else:
                fit(u, y, 0.1, job.structure, preprocess=job.preprocess, reference=reference)
    _ready.add(job.key)


@contextmanager
def _alone_on_this_machine() -> Iterator[None]:
    """Hold a lock that all processes of this user on this machine share, where the system has one."""
    try:
        import fcntl
    except ImportError:  # Windows: two workers may compile the same kernel, and the later one's stays
        yield
        return
    path = Path(tempfile.gettempdir(), f"replant-compiling-{os.getuid()}.lock")
    with path.open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield
