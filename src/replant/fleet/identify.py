"""One rig: its record read and identified; a failure is a row with its reason."""

from __future__ import annotations

import dataclasses
import time
import warnings
from pathlib import Path
from typing import Any

from replant.data.logs import Recording
from replant.errors import ReplantError, SystemRefusedError
from replant.fleet.files import printable
from replant.fleet.job import Job, Rig
from replant.fleet.rig_record import begin_of, opened
from replant.fleet.store import FAILED, Row
from replant.fleet.watched_record import Watched
from replant.identified.model import Model
from replant.offline.fit import fit
from replant.operating_system.os_errors import refusal
from replant.runs.result import Result, result_of_fit
from replant.runs.run import run_source
from replant.simulation.score import FITTED


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
