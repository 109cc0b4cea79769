"""Computations outside the server: commands, each in a process that can be stopped; requests, in one worker process.

The functions for the worker take and return plain values; the worker caches logs and validations for further requests.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np

from replant.errors import ReplantError, SystemRefusedError
from replant.fitting.log_inspection import Inspection, inspect, key_of
from replant.fitting.model import Model
from replant.fitting.model_json import finite
from replant.fitting.validation import Validation
from replant.logs import open_recording
from replant.logs.conditioning import STEPS
from replant.logs.log import Log
from replant.numerics.arguments import FloatArray
from replant.numerics.operating_system import one_line, reason_of
from replant.numerics.residuals import BAND_95
from replant.plotting.numbers import rounded
from replant.report.log_as_text import as_json, findings_of
from replant.workbench.choices import Setup, Stretch
from replant.workbench.drawn_samples import doubts, thinned
from replant.workbench.model_cards import DONE, FAILED, RUNNING, STOPPED

KEPT_LOGS = 2  # logs in the cache [count]
KEPT_VALIDATIONS = 32  # validations in the cache [count]
CURVE = 300  # points of a response curve [count]


def look(path: str, chosen: tuple[str, str, str]) -> dict[str, Any]:
    """Inspect a log with the chosen columns of input, output and time."""
    u, y, t = (each or None for each in chosen)
    found = inspect(path, input=u, output=y, time=t)
    told = as_json(found)
    for shown, given in zip(told["columns"], found.contents.columns, strict=True):
        shown["key"] = key_of(found.table, given) if given.name else str(given.number)
        shown["in_record"] = given in found.record and not given.problem
    clock = found.clock
    column = None if clock is None or math.isnan(clock.dt) else clock.column
    told["clock_number"] = None if column is None else column.number
    notes = [("Note", each.removeprefix(f"{path}: ")) for each in found.table.notes]
    told["findings"] = [list(each) for each in (*findings_of(found), *notes)]
    told["delay"] = found.delay
    told["doubts"] = [vars(each) for each in doubts(*_seen(found))]
    return told


def _seen(found: Inspection) -> tuple[FloatArray, FloatArray | None, FloatArray | None]:
    """Return time in s from the first row, input and output of the rows that were inspected."""
    clock, values = found.clock, found.contents.values
    u, y = (None if role is None else values[role.column.number] for role in (found.roles.input, found.roles.output))
    if clock is None or clock.column is None or math.isnan(clock.dt) or clock.backward:
        dt = 1.0 if clock is None or math.isnan(clock.dt) else clock.dt
        return dt * np.arange(found.rows, dtype=np.float64), u, y
    stamps = values[clock.column.number]
    return np.asarray((stamps - stamps[0]) * clock.unit, np.float64), u, y


@lru_cache(KEPT_LOGS)
def _log(path: str, setup: Setup, part: Stretch | None, _: float) -> Log:
    """Return a log or a part of it, read and conditioned as by the command line."""
    between: dict[str, Any] = {} if part is None else {"begin": part.begin, "end": part.end}
    clock: dict[str, Any] = {"dt": setup.dt} if setup.dt is not None else {"time": setup.time or None}
    recording = open_recording(
        path, input=setup.input, output=setup.output, reference=setup.reference or None, **clock, **between,
        most_held=sys.maxsize,
    )  # fmt: skip
    log = recording.held
    assert log is not None
    for name, change in STEPS.items():
        given = getattr(setup, name, None)
        log = log if given is None or given is False else change(log, given)
    return replace(log, input_hold="foh" if setup.decimate else "zoh")


@dataclass(frozen=True)
class Excerpt:
    """What plots show of a log."""

    path: str
    modified: float  # when the file was
    setup: Setup  # without stretches of time
    part: Stretch | None  # the part that models are validated on; None: all
    between: tuple[float, float] | None  # the times shown in s; None: all
    points: int  # most points of a curve

    def read(self) -> tuple[Log, FloatArray, slice]:
        """Return the part of the log, its times in s from the first row of the file, and which rows are shown."""
        log = _log(self.path, self.setup, self.part, self.modified)
        t = np.asarray(log.dt * np.arange(log.input.size) if log.time is None else log.time - log.time[0], np.float64)
        t = t + (log.begin or 0.0)  # of the part, and of what decimation leaves out
        if self.between is None:
            return log, t, slice(0, t.size)
        first, last = np.searchsorted(t, self.between).tolist()
        return log, t, slice(max(0, first - 1), min(t.size, last + 1))


def conditioned(shown: Excerpt) -> dict[str, Any]:
    """Return the conditioned input and output."""
    log, t, rows = shown.read()
    signals = {"input": log.input, "output": log.output}
    drawn = {name: thinned(t, signal, rows, shown.points) for name, signal in signals.items()}
    return {"signals": drawn, "samples": len(log), "dt": log.dt}


@lru_cache(KEPT_VALIDATIONS)
def _validation(model: str, path: str, setup: Setup, part: Stretch | None, changed: float) -> Validation:
    return Model.from_json(model).validate(_log(path, setup, part, changed))


def compared(models: dict[str, str], shown: Excerpt) -> dict[str, Any]:
    """Return outputs of models and the measured output."""
    (log, t, rows), points = shown.read(), shown.points
    found: dict[str, Any] = {
        "all": [float(t[0]), float(t[-1])],
        "measured": thinned(t, log.output, rows, points),
        "input": thinned(t, log.input, rows, points),
        "models": {},
    }
    for name, written in models.items():
        try:
            validation = _validation(written, shown.path, shown.setup, shown.part, shown.modified)
            found["models"][name] = _beside(validation, t, rows, points)
        except Exception as error:  # a failure of one model must not hide the others
            found["models"][name] = {"failed": reason_of(error)}
    return found


def _beside(found: Validation, t: FloatArray, rows: slice, points: int) -> dict[str, Any]:
    correlations, by_frequency = found.correlations, found.by_frequency
    return {
        "fit": finite(found.fit),
        "how": found.how,
        "output": thinned(t, found.output, rows, points),
        "residual": thinned(t, found.residual, rows, points),
        "verdict": {"status": found.verdict.status, "reasons": list(found.verdict.reasons)},
        "correlations": None if correlations is None else {
            "auto": rounded(correlations.auto), "cross": rounded(correlations.cross),
            "limit_auto": BAND_95 * correlations.auto_std, "limit_cross": BAND_95 * correlations.cross_std,
        },
        "error": None if by_frequency is None else {
            "omega": rounded(by_frequency.frequency), "error": rounded(by_frequency.error),
            "limit": rounded(by_frequency.limit),
        },
    }  # fmt: skip


def responses(models: dict[str, str]) -> dict[str, Any]:
    """Return step responses, frequency responses and poles of models, on common axes."""
    loaded = {name: Model.from_json(written) for name, written in models.items()}
    if not loaded:
        return {"models": {}}
    steps = [float(model.step().time[-1]) for model in loaded.values()]
    lasts = float(np.median(steps)) if len(steps) > 2 else max(steps)
    ends = [model.bode().frequency[[0, -1]] for model in loaded.values()]
    omega = np.geomspace(min(low for low, _ in ends), max(high for _, high in ends), CURVE)
    found = {name: _responses(model, lasts, omega) for name, model in loaded.items()}
    return {"models": found, "omega": rounded(omega), "lasts": lasts}


def _responses(model: Model, lasts: float, omega: FloatArray) -> dict[str, Any]:
    step, bode, poles = model.step(lasts), model.bode(omega), model.poles()
    t = np.linspace(0.0, lasts, CURVE)  # a common grid: a model's own grid depends on its oscillation
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        size = 20.0 * np.log10(bode.magnitude)
        wide = (20.0 / math.log(10.0)) * _twice(bode.relative_std, omega.size)
    turn, spread = np.degrees(_twice(bode.phase_std, omega.size)), _twice(step.std, step.time.size)
    regions = [
        (mode.mode.pole, [[finite(each) for each in row] for row in mode.covariance]) for mode in poles.uncertain
    ]
    roots: Any = regions or [(pole, None) for pole in poles.values]
    over_time = {"t": t, "y": np.interp(t, step.time, step.output), "wide": np.interp(t, step.time, spread)}
    return {
        "step": {name: rounded(values) for name, values in over_time.items()},
        "bode": {"size": rounded(size), "wide": rounded(wide), "phase": rounded(np.degrees(bode.phase)),
                 "turn": rounded(turn)},
        "poles": [_complex(pole) | {"covariance": covariance} for pole, covariance in roots],
        "zeros": [_complex(zero) for zero in poles.zeros],
    }  # fmt: skip


def _twice(std: FloatArray | None, size: int) -> FloatArray:
    return np.full(size, np.nan) if std is None else 2.0 * std


def _complex(value: complex) -> dict[str, float | None]:
    return {"real": finite(value.real), "imag": finite(value.imag)}


class Work:
    """One worker process, started at the first request and restarted if it has died."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._process = 0
        self._turn, self._closed = threading.Lock(), False

    def do(self, function: Callable[..., dict[str, Any]], *arguments: Any) -> dict[str, Any]:
        """Call a function of `replant.workbench.tasks` in the worker, and wait for its result."""
        with self._turn:
            try:
                return self._started().submit(function, *arguments).result()
            except BrokenExecutor:
                self._pool = None
                raise ReplantError(
                    "the process that computes this has died: the memory may be too small; try again"
                ) from None

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None and not self._closed:
            from replant.fleet.executors import processes  # slow to import

            try:
                self._pool = processes(1)
            except SystemRefusedError as error:  # its remedy, fewer processes, does not apply here
                raise BrokenExecutor from error
            self._process = self._pool.submit(os.getpid).result()
        if self._pool is None or self._closed:
            raise BrokenExecutor
        return self._pool

    def close(self) -> None:
        """Kill the process, even during a computation."""
        self._closed = True
        for process in active_children():
            if process.pid == self._process:
                process.kill()


AT_ONCE = max(1, min(4, (os.cpu_count() or 1) - 1))  # most simultaneous commands; one core is left for the page [count]
PATIENCE = 3.0  # timeout for a stopped command to end by itself [s]
_PROGRESS = re.compile(r"replant: (.+?) (\d+) %")


class Jobs:
    """Runs the commands of cards; calls ``tell`` with a card's name and changes, from other threads."""

    def __init__(self, tell: Callable[[str, dict[str, Any]], None]) -> None:
        self._tell = tell
        self._pool, self._lock, self._closed = ThreadPoolExecutor(AT_ONCE), threading.Lock(), False
        self._futures: dict[str, Future[None]] = {}
        self._running: dict[str, subprocess.Popen[str]] = {}
        self._stopped: set[str] = set()

    def start(self, name: str, words: tuple[str, ...]) -> None:
        """Queue a command."""
        with self._lock:
            if not self._closed:
                self._stopped.discard(name)
                self._futures[name] = self._pool.submit(self._run, name, words)

    def stop(self, name: str) -> None:
        """Stop a command, or remove it from the queue."""
        with self._lock:
            self._stopped.add(name)
            process, future = self._running.get(name), self._futures.get(name)
        if process is not None:
            end(process)
        elif future is not None and future.cancel():
            self._tell(name, {"state": STOPPED})

    def close(self) -> None:
        """Stop all commands."""
        with self._lock:
            self._closed, running = True, list(self._running.values())
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in running:
            end(process)

    def _run(self, name: str, words: tuple[str, ...]) -> None:
        try:
            changes = self._made(name, words)
        except Exception as error:
            changes = {"state": FAILED, "error": one_line(error)}
        with self._lock:
            self._running.pop(name, None)
            stopped = self._closed or name in self._stopped
        self._tell(name, {"state": STOPPED} if stopped else changes)

    def _made(self, name: str, words: tuple[str, ...]) -> dict[str, Any]:
        """Run a command; return its JSON object and its model as changes of the card, or the error."""
        self._tell(name, {"state": RUNNING, "stage": "starting", "percent": 0})
        with tempfile.TemporaryDirectory(prefix="replant-job-") as folder:
            saved, printed = Path(folder, "model.json"), Path(folder, "printed.json")
            with printed.open("wb") as output:
                process = subprocess.Popen(
                    [sys.executable, "-m", "replant", *words, "--json", "--progress", "--save", str(saved)],
                    stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.PIPE, text=True,
                    encoding="utf-8", errors="replace",
                )  # fmt: skip
            with self._lock:
                self._running[name] = process
                stopped = self._closed or name in self._stopped
            if stopped:
                end(process)
            last = self._listen(name, process)
            if process.wait() or not saved.is_file():
                error = last.removeprefix("replant: ") or f"the command ended with code {process.returncode}"
                return {"state": FAILED, "error": error}
            found, model = json.loads(printed.read_text(encoding="utf-8")), saved.read_text(encoding="utf-8")
            return {"state": DONE, "found": found, "model": model, "percent": 100}

    def _listen(self, name: str, process: subprocess.Popen[str]) -> str:
        """Report the progress until the command ends; return the last line of another kind."""
        last = ""
        assert process.stderr is not None
        with process.stderr:
            for line in process.stderr:
                found = _PROGRESS.fullmatch(line.strip())
                if found:
                    self._tell(name, {"state": RUNNING, "stage": found[1], "percent": int(found[2])})
                elif line.strip():
                    last = line.strip()
        return last


def end(process: subprocess.Popen[str]) -> None:
    """Terminate a process, and kill it if it does not end in time."""
    with contextlib.suppress(OSError):
        process.terminate()
    try:
        process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(OSError):
            process.kill()
