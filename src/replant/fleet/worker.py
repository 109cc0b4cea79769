"""The work of a fleet and its workers: read the record of a rig, measure the movement of its signals, identify it."""

from __future__ import annotations

import dataclasses
import math
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import LogError, ReplantError, SystemRefusedError
from replant.estimation.simulation.fitted_run import FITTED
from replant.fitting.fit import fit
from replant.fitting.fit_result import FitResult
from replant.fitting.miso_fit import RowFit, fit_row
from replant.fitting.miso_model import RowModel
from replant.fitting.model import Model
from replant.fitting.samples import Samples
from replant.fleet.catalogue import is_parquet
from replant.fleet.executors import Progress, carried_out, workers
from replant.fleet.job import Job, Rig, planned, printable, work_of
from replant.fleet.store import FAILED, Store, cells_of
from replant.logs import Recording, Table, open_recording, read_columns
from replant.logs.arrow import first_stamp, read_row_groups
from replant.logs.recording import MOST_HELD, joined
from replant.logs.sampling_time import time_columns
from replant.model.structure import Structure
from replant.numerics.operating_system import refusal
from replant.online.runs.result import Result, result_of_fit
from replant.online.runs.run import run_source
from replant.online.runs.run_log import run_row


def identify_all(
    store: Store, missing: Sequence[Rig], rigs: int, on: Executor | str | None, progress: Callable[[Progress], None]
) -> None:
    """Identify the missing ones among a number of rigs on an executor, and store the results."""
    tasks = planned(missing)
    work = [sum(map(work_of, task)) for task in tasks]
    ended = failed = samples = 0
    count = rigs - len(missing)
    progress(Progress(rigs, count, 0, 0, 0.0 if tasks else 1.0))
    if not tasks:
        return
    with workers(on) as found:
        for number, done in carried_out(found, partial(carry_out, store.job), tasks):
            ended += work[number]
            store.add(tasks[number], done)
            count += len(done)
            failed += sum(cells["verdict"] == FAILED for cells in done)
            samples += sum(cells["samples"] for cells in done)
            progress(Progress(rigs, count, failed, samples, ended / sum(work)))


def carry_out(job: Job, rigs: Sequence[Rig]) -> list[dict[str, Any]]:
    """Identify the rigs of a task, and return the cells of each; executors call this function."""
    return [identify(rig, job) for rig in rigs]


def identify(rig: Rig, job: Job) -> dict[str, Any]:
    """Return the cells of a rig, and the time in s that it took; a rig that cannot be identified has cells, too."""
    begun = time.perf_counter()
    try:
        cells = _identified(rig, job)
    except MemoryError as error:
        raise SystemRefusedError(f"rig {rig.name}: {refusal(error)}, or use the method run") from error
    except SystemRefusedError:
        raise
    except Exception as error:  # a failure of one rig must not stop the others
        reason = str(error) if isinstance(error, ReplantError) else f"unexpected {type(error).__name__}: {error}"
        about = {"reasons": " ".join(reason.split()), "source": rig.pieces[0].name, "files": len(rig.pieces)}
        cells = cells_of(job.shape, None, rig=rig.name, verdict=FAILED, **about)
    return cells | {"seconds": time.perf_counter() - begun}


def _identified(rig: Rig, job: Job) -> dict[str, Any]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the notes have the readers' warnings
        recording = opened(rig, job)
        result = result_of(recording, job)
    begin, stretch = begin_of(rig, recording, job), (recording.samples - 1) * recording.dt
    if isinstance(result, Result) and result.clock is not None and result.clock.irregular:
        stretch = float(result.clock.at(recording.samples - 1))
    elif isinstance(result, RowFit) and recording.held is not None and recording.held.stamps is not None:
        stretch = float(recording.held.stamps[-1] - recording.held.stamps[0])
    first = min(rig.pieces, key=lambda piece: piece.name)
    notes = (*recording.table.notes, *((recording.irregularity,) if recording.irregular else ()))
    stds, output_std, output_held = movement_of(recording)
    return cells_of(
        job.shape,
        _named(result.model, recording),
        rig=rig.name,
        verdict=result.verdict.status,
        reasons="; ".join(result.verdict.reasons),
        source=first.name,
        files=len({piece.path for piece in rig.pieces}),
        notes="; ".join(" ".join(note.replace(f"{Path(first.path).parent}/", "").split()) for note in notes),
        samples=result.samples,
        recorded=recording.samples,
        rejected=sum(result.rejected.values()),
        rejected_why=", ".join(f"{count} {why}" for why, count in result.rejected.items() if count),
        begin=begin,
        end=begin + stretch,
        output_std=output_std,
        output_held=output_held,
        **{f"input_std{end}": std for (_, end, _), std in zip(job.shape.branches, stds, strict=True)},
    )


def result_of(recording: Recording, job: Job, *, with_history: bool = False) -> Result | RowFit:
    """Return the result of a record by the job's method, equal to that of ``replant run`` or ``replant fit``."""
    log = recording.held
    if job.several:
        assert log is not None
        given, structures = Samples.of(log, None, None, None, None), job.shape.structures
        orders = {name: tuple(getattr(one, name) for one in structures) for name in ("poles", "zeros", "delay")}
        return run_row(given, orders) if job.method == "run" else fit_row(given, **orders)
    if job.method == "run":
        newest = None if log is not None else FITTED
        request = job.request(recording.dt)
        irregular = recording.irregular
        return run_source(request, recording, newest=newest, irregular=irregular, with_history=with_history)
    assert log is not None
    assert isinstance(job.structure, Structure)
    begun = time.perf_counter()
    more: dict[str, Any] = {} if log.reference is None else {"reference": log.reference}
    fitted = fit(log.input, log.output, log.dt, job.structure, preprocess=job.preprocess, t=log.stamps, **more)
    assert isinstance(fitted, FitResult)
    return result_of_fit(fitted, log.input, log.output, begun, log.stamps)


def _named(model: Model | RowModel, recording: Recording) -> Model | RowModel:
    """Return a model with the names of its signals but without a date, so that equal files give equal bytes."""
    entered: Any
    entered, given = (recording.table.names[column] for column in recording.columns[:2])
    if isinstance(model, RowModel) and recording.held is not None:
        entered = recording.held.input_names
    model = model.of_log(entered, given, printable(recording.path.name))
    return dataclasses.replace(model, provenance=dataclasses.replace(model.provenance, date=""))


def movement_of(recording: Recording) -> tuple[list[float], float, float]:
    """Return the movement of a record's signals; moments of batches are combined as by Chan, Golub and LeVeque.

    The standard deviations of the raw inputs and of the output are NaN without a sample.  The last number is the
    longest stretch over which the output is constant to the bit, as a part of the record.
    """
    log, last = recording.held, math.nan  # a log of several inputs is held, and comes in one batch
    more = [] if log is None else [log.others[name] for name in log.more_inputs]
    count, mean, sums = np.zeros((3, 2 + len(more)))
    rows = longest = now = 0  # samples; the longest stretch of equal outputs, and the current one
    for u, y, *_ in recording.batches():
        for i, signal in enumerate((y, u, *more)):
            known = signal[np.isfinite(signal)]
            if known.size:
                off, before = float(known.mean()) - mean[i], count[i]
                count[i] += known.size
                sums[i] += float(np.square(known - known.mean()).sum()) + off * off * before * known.size / count[i]
                mean[i] += off * known.size / count[i]
        if y.size:
            changes = np.flatnonzero(np.diff(y, prepend=last) != 0.0)  # NaN is a change
            stretches = np.diff([-now, *changes, y.size])
            rows, last, now = rows + y.size, float(y[-1]), int(stretches[-1])
            longest = max(longest, *stretches.tolist())
    of_output, *of_inputs = np.sqrt(sums / np.where(count > 0.0, count, np.nan)).tolist()
    return of_inputs, of_output, longest / rows if rows else math.nan


def opened(rig: Rig, job: Job) -> Recording:
    """Open the record of a rig; several files are joined in the order of their first time stamps."""
    if rig.problem:
        raise LogError(rig.problem)
    return open_recording(
        _table(rig, job), input=job.input, output=job.output, time=job.time, dt=job.dt, reference=job.reference,
        begin=job.begin, end=job.end, most_held=sys.maxsize if job.method == "fit" or job.several else MOST_HELD,
    )  # fmt: skip


def begin_of(rig: Rig, recording: Recording, job: Job) -> float:
    """Return the time of a rig's first sample in s, from its time column, for dates since 1970; 0 without one."""
    table = recording.table
    number = None if job.dt is not None else _time_column(table, job)
    if number is None:
        return 0.0
    if number in table.in_seconds and all(map(is_parquet, rig.pieces)):
        return min(first_stamp(piece.row_groups, number) for piece in rig.pieces) + (job.begin or 0.0)
    return table.origins.get(number, 0) / 1e9 + float(recording.arrays[-1][0]) * recording.unit


def _table(rig: Rig, job: Job) -> Table:
    """Return the rows of a rig; several files are in the order of their first stamps, else of their names."""
    if all(map(is_parquet, rig.pieces)):
        pieces = list(rig.pieces)
        if len(pieces) > 1:
            number = _time_column(read_row_groups([pieces[0].row_groups]), job)
            if number is not None:
                pieces.sort(key=lambda piece: (first_stamp(piece.row_groups, number), piece.name))
        return read_row_groups([piece.row_groups for piece in pieces])
    tables = [(read_columns(Path(piece.path)), piece.name) for piece in rig.pieces]
    if len(tables) == 1:
        return tables[0][0]

    def place(found: tuple[Table, str]) -> tuple[float, str]:
        table, name = found
        if (number := _time_column(table, job)) is None:
            return math.inf, name
        (block,) = table.head([number], 1)
        known = block[np.isfinite(block)]
        return table.origins.get(number, 0) / 1e9 + (float(known[0]) if known.size else math.inf), name

    return joined([table for table, _ in sorted(tables, key=place)])


def _time_column(table: Table, job: Job) -> int | None:
    if job.time is not None:
        return table.find(job.time)
    candidates = time_columns(table)
    return candidates[0] if len(candidates) == 1 else None
