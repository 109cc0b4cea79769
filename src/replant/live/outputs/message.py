"""Output of a session: the estimate as a message, notices, and records in folders of Parquet files.

A Parquet file cannot be read before its end is written.  Therefore each part of the record is a small file that is
written under a temporary name, synced to the disk and renamed: a crash loses at most the part being written.
pandas, pyarrow, DuckDB and `replant run` read such a folder as one table.
"""

from __future__ import annotations

import contextlib
import importlib.util
import json
import math
import queue
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from replant.errors import InvalidArgumentError, MissingDependencyError
from replant.live.streams import UY, Batch, Signals
from replant.logs.arrow import CHECKED, check_rows, open_parquet
from replant.numerics.arguments import FloatArray
from replant.numerics.operating_system import ENDING, Worker, one_line, replacing

AGAIN = 60.0  # least time between two messages about the same subject [s]


class Notices:
    """Passes messages to ``show``, at most one a minute about each subject."""

    def __init__(self, show: Callable[[str], None]) -> None:
        self._show = show
        self._said: dict[str, float] = {}

    def say(self, subject: str, message: str) -> None:
        """Show a message, unless one about the same subject was shown within the last minute."""
        now = time.monotonic()
        if now - self._said.get(subject, -AGAIN) >= AGAIN:
            self._said[subject] = now
            self._show(message)


VERSION = 1  # version of `schema/message-1.json`; a new one if an entry is removed or changes its meaning [count]
UNKNOWN = "unknown"  # the verdict while there is none
LEAST_TTL = 5.0  # least time to live: a network takes time to retransmit [s]
INTERVALS = 10  # least time to live: a slow plant may send ten samples in a message [sampling times]
#: `EstimateMessage.status` while no sample is accepted, and after the session's end.
WAITING, ENDED = "waiting", "ended"


def time_to_live(dt: float) -> float:
    """Return the default time to live in s: how long "trusted" stays valid without an accepted sample."""
    return max(LEAST_TTL, INTERVALS * dt)


@dataclass(frozen=True, eq=False)
class EstimateMessage:
    """The estimate after a sample, with the newest verdict and the newest standard deviations."""

    timestamp: float  # rig time of the sample in s
    sequence: int | None  # number of the sample, if the device numbers them
    samples: int  # accepted samples so far
    names: tuple[str, ...]  # names of the P parameters
    parameters: FloatArray  # (P,): NaN until there is a first model
    # (P,): standard deviations.  They and the verdict may be tenths of a second older than the sample; they are NaN and
    # "unknown" if the estimate has changed significantly since
    std: FloatArray
    status: str  # starting, running, diverged; waiting: no sample is accepted; ended: the session is over
    verdict: str
    excited: bool = False  # see `Assessment`; False while the verdict is unknown
    coefficients: bool = False  # whether the parameters are known one by one; else, if trusted, G(s) as a whole is
    ttl: float = 0.0  # time in s after the receipt in which a controller may use the model; 0: it may not
    sent: float | None = None  # Unix time in s at which the message was sent; None before that

    @property
    def trusted(self) -> bool:
        """Whether a controller may use G(s), for `ttl` seconds; its coefficients one by one only if they are known."""
        return self.verdict == "trusted" and self.ttl > 0.0

    def as_json(self) -> bytes:
        """Return one line of JSON without the line end: a flat object; unknown numbers are null."""
        numbers = {
            prefix + name: value if math.isfinite(value) else None
            for prefix, values in (("", self.parameters), ("std_", self.std))
            for name, value in zip(self.names, values.tolist(), strict=True)
        }
        fields = {
            "schema_version": VERSION, "timestamp": self.timestamp,
            **({} if self.sequence is None else {"sequence": self.sequence}), "samples": self.samples, **numbers,
            "trusted": int(self.trusted), "excited": int(self.excited), "ttl": self.ttl, "status": self.status,
            "verdict": self.verdict, "coefficients": int(self.trusted and self.coefficients), "sent": self.sent,
        }  # fmt: skip
        return json.dumps(fields, separators=(",", ":"), allow_nan=False).encode()


class Sink(Protocol):
    """A receiver of estimates.  `send` must not block; only one thread at a time calls it."""

    name: str
    #: Least time between two estimates in s; estimates in between are skipped, except the newest one.
    interval: float
    #: Whether the receiver lacks the newest estimate, which must be sent again: the receiver is slow, was disconnected,
    #: or has just connected.
    behind: bool = False

    def send(self, estimate: EstimateMessage) -> None:
        """Send the estimate, or skip it and set `behind`, or raise OSError with the reason."""

    def close(self) -> None:
        """Send queued messages, and close the connection; by default do nothing."""
        return


MOST_WAITING = 16  # most jobs in the queue of the disk [count]


class DiskWriter:
    """Runs jobs in order in its own thread; a failed job is reported, and the next one runs."""

    def __init__(self, notices: Notices) -> None:
        self._notices = notices
        self._jobs: queue.Queue[tuple[str, Callable[[], None]] | None] = queue.Queue(MOST_WAITING)
        self._thread = Worker(self._work)
        self._thread.start()

    def submit(self, subject: str, job: Callable[[], None]) -> bool:
        """Queue a job; return False if the queue is full.  A message about a failure begins with ``subject``."""
        try:
            self._jobs.put_nowait((subject, job))
        except queue.Full:
            self._notices.say(subject + " late", f"replant: {subject}: the disk is too slow; a part is left out")
            return False
        return True

    def wait(self) -> None:
        """Wait until all jobs are done."""
        self._jobs.join()

    def close(self) -> None:
        """Finish the queued jobs, and end the thread."""
        self._jobs.put(None)
        self._thread.join()

    def _work(self) -> None:
        running = True
        while running:
            # if memory is exhausted, even taking a job from the queue or reporting a failure may fail; the thread must
            # survive, as otherwise `wait` and `close` never return
            with contextlib.suppress(Exception):
                running = self._do_next()

    def _do_next(self) -> bool:
        """Wait for a job and do it; return False at the end of the queue."""
        entry = self._jobs.get()
        if entry is None:
            return False
        subject, job = entry
        try:
            job()
        except Exception as error:  # such as a full disk or a missing folder: identification continues
            self._notices.say(subject, f"replant: {subject}: {one_line(error)}; identification continues")
        finally:
            self._jobs.task_done()
        return True


ROWS = 200_000  # rows after which a part is written: a few megabytes [rows]
SECONDS = 30.0  # time after which a shorter part is written [s]
PART = "part-{:08d}.parquet"

Samples = tuple[npt.NDArray[np.int64] | None, dict[str, FloatArray]]  # the device's numbers, and the columns


class ParquetRecorder(Sink):
    """Records samples in FOLDER/samples (n, t, the signals, r) and estimates in FOLDER/estimates."""

    name = "record"
    interval = 0.1  # least real time between two recorded estimates, in s

    def __init__(self, folder: Path, disk_writer: DiskWriter, signals: Signals = UY, *, go_on: bool = False) -> None:
        if importlib.util.find_spec("pyarrow") is None:
            raise MissingDependencyError("--record needs pyarrow: pip install 'replant[live]'")
        self._signals = signals
        self._samples = _Parts(folder / "samples", _samples_table, disk_writer, go_on=go_on)
        self._estimates = _Parts(folder / "estimates", _estimates_table, disk_writer, go_on=go_on)
        self._last = self._samples.last_number()
        self._rows, self._start = 0, time.monotonic()

    def add_samples(self, batch: Batch, t: FloatArray) -> None:
        """Record samples with their rig time (K,) in s."""
        if batch.sequence is not None and batch.sequence[0] <= self._last:
            new = int(np.searchsorted(batch.sequence, self._last, side="right"))
            batch, t = batch.select(slice(new, None)), t[new:]
        signals = dict(zip(self._signals.names, [*np.atleast_2d(batch.u.T), batch.y], strict=True))
        reference = {} if batch.r is None else {"r": batch.r}
        self._samples.waiting.append((batch.sequence, {"t": t, **signals, **reference}))
        self._rows += len(batch)
        if self._rows >= ROWS or time.monotonic() - self._start >= SECONDS:
            self.flush()

    def send(self, estimate: EstimateMessage) -> None:
        """Record an estimate."""
        self._estimates.waiting.append(estimate)

    def flush(self) -> None:
        """Queue the writing of a part with the samples, and of one with the estimates, since the last parts."""
        self._samples.flush()
        self._estimates.flush()
        self._rows, self._start = 0, time.monotonic()


class _Parts:
    """A folder of numbered Parquet files, and the entries for the next one."""

    def __init__(
        self, folder: Path, table_of: Callable[[list[Any]], Any], disk_writer: DiskWriter, *, go_on: bool
    ) -> None:
        self.waiting: list[Any] = []
        self._table_of, self._disk_writer = table_of, disk_writer
        self._folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._found = sorted(folder.glob("part-*.parquet"))
            for unfinished in (*folder.glob(f".*{ENDING}"), *folder.glob(".part-*")):  # .part-*: of older versions
                unfinished.unlink()
        except OSError as error:
            raise InvalidArgumentError(f"--record: {one_line(error)}; choose a folder that can be written") from None
        if self._found and not go_on:
            raise InvalidArgumentError(
                f"--record: {folder} already holds a record; choose another folder, or continue with its --checkpoint; "
                "if there is none, move the record away"
            )
        self._number = int(self._found[-1].stem.removeprefix("part-")) if self._found else 0

    def last_number(self) -> int:
        """Return the largest number n in the newest part; the smallest integer if there is none."""
        import pyarrow.compute

        last = None
        if self._found:
            with open_parquet(self._found[-1]) as part:
                numbers = part.read(columns=["n"]).column("n")
                check_rows(self._found[-1], part, len(numbers))
            last = pyarrow.compute.max(numbers).as_py()
        return int(np.iinfo(np.int64).min) if last is None else int(last)

    def flush(self) -> None:
        """Queue the writing of the waiting entries as a part; it gets its name when it is complete on the disk."""
        waiting, self.waiting = self.waiting, []
        if waiting:
            self._number += 1
            path = self._folder / PART.format(self._number)
            self._disk_writer.submit("record", lambda: self._write(path, waiting))

    def _write(self, path: Path, waiting: list[Any]) -> None:
        import pyarrow.parquet

        with replacing(path) as new:
            pyarrow.parquet.write_table(self._table_of(waiting), new, **CHECKED)


def _samples_table(samples: list[Samples]) -> Any:
    import pyarrow

    numbers = [
        pyarrow.nulls(signals["t"].size, pyarrow.int64()) if n is None else pyarrow.array(n, pyarrow.int64())
        for n, signals in samples
    ]
    signals = {name: np.concatenate([entry[name] for _, entry in samples]) for name in samples[0][1]}
    return pyarrow.table({"n": pyarrow.chunked_array(numbers, pyarrow.int64()), **signals})


def _estimates_table(estimates: list[EstimateMessage]) -> Any:
    import pyarrow

    def each(attribute: str) -> list[Any]:
        return [getattr(entry, attribute) for entry in estimates]

    columns: dict[str, Any] = {
        "t": pyarrow.array(each("timestamp"), pyarrow.float64()),
        "n": pyarrow.array(each("sequence"), pyarrow.int64()),
        "samples": pyarrow.array(each("samples"), pyarrow.int64()),
    }
    for prefix, attribute in (("", "parameters"), ("std_", "std")):
        values = np.array(each(attribute))
        columns |= {prefix + name: values[:, k] for k, name in enumerate(estimates[0].names)}
    return pyarrow.table(columns | {name: each(name) for name in ("status", "verdict", "excited")})
