"""The record of a rig: its files opened, in the order of time, as one recording."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

from replant.data.logs import Recording, Table, open_recording, read_columns
from replant.data.logs.arrow import first_stamp, read_row_groups
from replant.data.logs.read import time_columns
from replant.data.logs.recording import MOST_HELD, joined
from replant.errors import LogError
from replant.fleet.catalogue import is_parquet
from replant.fleet.job import Job, Piece, Rig


def opened(rig: Rig, job: Job) -> Recording:
    """Open the record of a rig; one of several files is joined in the order of their first time stamps."""
    if rig.problem:
        raise LogError(rig.problem)
    return open_recording(
        _table(rig, job), input=job.input, output=job.output, time=job.time, dt=job.dt, reference=job.reference,
        begin=job.begin, end=job.end, most_held=sys.maxsize if job.method == "fit" else MOST_HELD,
    )  # fmt: skip


def begin_of(rig: Rig, recording: Recording, job: Job) -> float:
    """Return the time of a rig's first sample in s: by its time column, dates since 1970; 0 without one."""
    table = recording.table
    number = None if job.dt is not None else _time_column(table, job)
    if number is None:
        return 0.0
    if number in table.in_seconds and all(map(is_parquet, rig.pieces)):
        first = min(first_stamp(piece.row_groups, number) for piece in rig.pieces)
        return first + (job.begin or 0.0)
    origin = table.origins.get(number, 0) / 1e9
    log = recording.held
    if log is not None and log.time is not None:
        return origin + float(log.time[0])
    known = next((block[np.isfinite(block)] for (block,) in table.stream([number])), np.empty(0))
    return origin + (float(known[0]) * recording.unit if known.size else 0.0)


def _table(rig: Rig, job: Job) -> Table:
    if len(rig.pieces) == 1 and not is_parquet(rig.pieces[0]):
        return read_columns(rig.pieces[0].path)
    if all(map(is_parquet, rig.pieces)):
        return read_row_groups([piece.row_groups for piece in _parquet_by_time(rig, job)])
    tables = [read_columns(Path(piece.path)) for piece in rig.pieces]
    firsts = [_first(table, job) for table in tables]
    order = sorted(range(len(tables)), key=lambda k: (firsts[k], rig.pieces[k].name))
    return joined([tables[k] for k in order])


def _parquet_by_time(rig: Rig, job: Job) -> list[Piece]:
    if len(rig.pieces) == 1:
        return list(rig.pieces)
    number = _time_column(read_row_groups([rig.pieces[0].row_groups]), job)
    if number is None:
        return list(rig.pieces)
    return sorted(rig.pieces, key=lambda piece: (first_stamp(piece.row_groups, number), piece.name))


def _first(table: Table, job: Job) -> float:
    """Return the first value of the time column; infinite where there is none, so that names decide."""
    number = _time_column(table, job)
    if number is None:
        return math.inf
    blocks = table.stream([number])
    try:
        (block,) = next(blocks, [np.empty(0)])
    finally:
        blocks.close()
    known = block[np.isfinite(block)]
    return table.origins.get(number, 0) / 1e9 + float(known[0]) if known.size else math.inf


def _time_column(table: Table, job: Job) -> int | None:
    if job.time is not None:
        return table.find(job.time)
    candidates = time_columns(table)
    return candidates[0] if len(candidates) == 1 else None
