"""Cases: which call of a session is to fail and how, the run, and what has to hold afterwards."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

import replant as rp
from replant.errors import MissingCheckpointError
from replant.online import saving
from support.live_command import MODEL, lines
from support.live_fakes import DT, REQUEST, record

HERE = Path(__file__).parent
LIMIT = 120.0  # s: only guards against hanging
SAMPLES = 600
HALF = -1  # instead of an error: half of the bytes are written or read
LARGE = 1 << 14  # bytes of an allocation that the system may refuse

#: Of each kind of call, the errors that it meets at a rig; the first is the one met most.
ERRORS: dict[str, tuple[int, ...]] = {
    "open": (errno.EMFILE, errno.EACCES, errno.ENOMEM),
    "write": (errno.ENOSPC, HALF, errno.EIO, errno.EINTR),
    "send": (errno.ECONNRESET, HALF, errno.ENOBUFS, errno.EAGAIN, errno.EINTR),
    "read": (errno.EIO, HALF, errno.ENOMEM),
    "sync": (errno.EIO, errno.ENOSPC),
    "rename": (errno.EIO, errno.ENOSPC, errno.EROFS),
    "socket": (errno.EMFILE, errno.ENOBUFS, errno.EADDRINUSE, errno.ENOMEM),
    "fork": (errno.EAGAIN, errno.ENOMEM),
    "alloc": (errno.ENOMEM,),
    "wait": (errno.ENOMEM, errno.EINTR),
}


@dataclass(frozen=True)
class Fault:
    """The ``nth`` call of a kind by the session or its observer fails with ``error``; ``lasting``: all later ones, too.

    Allocations count from ``least`` bytes on.
    """

    kind: str
    nth: int
    error: int
    lasting: bool = False
    role: str = "session"
    least: int = 0

    def __str__(self) -> str:
        how = "half" if self.error == HALF else errno.errorcode[self.error]
        size = f" of {self.least} bytes" if self.kind == "alloc" else ""
        return f"{self.role}: {self.kind} {self.nth}{' and later' if self.lasting else ''}{size}, {how}"


@dataclass(frozen=True)
class Outcome:
    """What came of a case: how it ended, what it wrote, and which calls were made."""

    folder: Path
    code: int | None
    signal: int | None
    left: bool
    seconds: float
    fired: int
    call: str
    counts: dict[str, dict[str, int]]
    out: str
    err: str

    @property
    def said(self) -> list[str]:
        """The notices, and the error that ended it."""
        return [line for line in self.err.splitlines() if line.startswith("replant: ")]


class Mother:
    """A warm process that forks sessions, see ``mother.py``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        library, self._page = folder / "failing.so", folder / "page"
        subprocess.run(
            ["gcc", "-O1", "-shared", "-fPIC", "-o", library, HERE / "failing.c", "-ldl"], check=True, timeout=LIMIT
        )  # fmt: skip
        self._page.write_bytes(bytes(8192))
        self._trace = folder / "trace"
        u, y = record(SAMPLES)
        rows = lines(u, y, DT * np.arange(SAMPLES))
        self.log = folder / "log.csv"
        self.log.write_bytes(b"t,u,y\n" + b"".join(rows))
        self.environment = os.environ | {
            "LD_PRELOAD": str(library), "FAILING_PAGE": str(self._page), "FAILING_TRACE": str(self._trace)
        }  # fmt: skip
        # a line of Python's own, should its helper's pipe fail: it is started again
        warnings = ("-W", "error", "-W", "ignore:resource_tracker")
        command = [sys.executable, *warnings, str(HERE / "mother.py"), str(self._page), *MODEL]
        self._process = subprocess.Popen(
            command, env=self.environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )  # fmt: skip
        self._answer()

    def _answer(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the process that forks sessions has ended"
        answer: dict[str, Any] = json.loads(line)
        return answer

    def run(
        self,
        fault: Fault | None,
        source: str | None = None,
        *options: str,
        stdin: Path | None = None,
        fork: bool = True,
    ) -> Outcome:
        """Run a session: of the log, with all outputs, unless another source is given with options of its own."""
        folder = self.folder / "case"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        self._trace.unlink(missing_ok=True)
        out, err = folder / "out", folder / "err"
        out.touch()
        err.touch()
        arguments = ["live", source or f"{self.log}?speed=100", *MODEL, "--checkpoint", str(folder / "rig")]
        arguments += ["--every", "50ms", "--record", str(folder / "record"), "--to", "-"]
        page = () if "--dashboard" in options else ("--dashboard", "127.0.0.1:0")
        arguments += ["--to", "udp://127.0.0.1:9", *page, *options]
        case = {
            "fault": None if fault is None else asdict(fault), "fork": fork, "limit": LIMIT, "arguments": arguments,
            "stdin": str(stdin or os.devnull), "stdout": str(out), "stderr": str(err),
        }  # fmt: skip
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(case) + "\n")
        self._process.stdin.flush()
        answer = self._answer()
        return Outcome(folder, out=out.read_text(), err=err.read_text("utf-8", "replace"), **answer)

    def trace(self) -> str:
        """Return the Python code that made the call that failed first."""
        return self._trace.read_text() if self._trace.exists() else ""

    def close(self) -> None:
        """End the process."""
        self._process.communicate(timeout=LIMIT)


@contextmanager
def mother(folder: Path) -> Iterator[Mother]:
    """Run a `Mother` for the time of a block."""
    running = Mother(folder)
    try:
        yield running
    finally:
        running.close()


def findings(outcome: Outcome, fault: Fault | None) -> list[str]:
    """Return what is wrong with an outcome: nothing, where all of the contract holds."""
    found = [*_ending(outcome, fault), *_words(outcome, fault)]
    if outcome.code is not None:
        found += [*_checkpoint(outcome, fault), *_record(outcome, fault), *_lines(outcome, fault)]
        if not (fault and fault.lasting and fault.kind == "rename"):
            found += [f"left behind: {path.name}" for path in _unfinished(outcome.folder)]
    return found


def _ending(outcome: Outcome, fault: Fault | None) -> Iterator[str]:
    if outcome.signal is not None:
        yield f"died of signal {outcome.signal}"
    elif outcome.code is None:
        yield "hangs"
    elif outcome.code == 127 and fault and fault.kind == "alloc" and "for thread-local data: ABORT" in outcome.err:
        # the C library's own line and exit code, where a thread's first use of a library is refused its memory; the
        # observer, forked here and not spawned, holds the session's end of its pipe itself and cannot notice
        return
    elif outcome.code not in (0, 2):
        yield f"exit code {outcome.code}"
    if outcome.left:
        yield "a process is left behind"


def _words(outcome: Outcome, fault: Fault | None) -> Iterator[str]:
    # Python's own word on a thread that finds no memory to begin with
    err = outcome.err.replace("Exception ignored in thread started by", "")
    if fault and (fault.role, fault.kind) == ("observer", "alloc") and "it restarts in" in err:
        # a C library (seen below NumPy) that does not bear a refused allocation ends the observer's process alone; that
        # is said, and the next process takes over
        err = err.replace("Fatal Python error: Segmentation fault", "")
    for word in ("Traceback", "Exception ignored", "Exception in thread", "Fatal", "rror while", "leaked"):
        if word in err:
            yield f"{word!r} on standard error"
    if outcome.code == 2:
        last = outcome.err.splitlines()[-1:] or [""]
        if not last[0].startswith("replant: ") and outcome.call != "write":
            yield f"its last line is no error: {last[0]!r}"
    elif outcome.code == 0 and "Verdict" not in outcome.err and outcome.call != "write":
        yield "no summary"


def _unfinished(folder: Path) -> list[Path]:
    patterns = ("record/*/.*", "rig.new", "rig.old", "*.tmp*")
    return [path for pattern in patterns for path in folder.glob(pattern)]


def _checkpoint(outcome: Outcome, fault: Fault | None) -> Iterator[str]:
    """The last checkpoint loads, goes on, and is the last unless that could not be written and was said."""
    try:
        loaded = saving.load(outcome.folder / "rig")
    except MissingCheckpointError:
        if (outcome.folder / "rig.previous").exists() or (outcome.code == 0 and not (fault and fault.lasting)):
            yield "there is no checkpoint"
        return
    except rp.errors.ReplantError as error:
        yield f"the checkpoint is refused: {error}"
        return
    taken = int(loaded.progress["taken"])
    u, y = record(SAMPLES)
    t = DT * np.arange(SAMPLES)
    expected = rp.Identifier(**vars(REQUEST))
    expected.update_many(u[:taken], y[:taken], t[:taken])
    if loaded.identifier.to_bytes() != expected.to_bytes():
        yield f"the checkpoint after {taken} samples is not what they give"
    loaded.identifier.update_many(u[taken:], y[taken:], t[taken:])
    if outcome.code == 0 and taken < SAMPLES and not any("checkpoint" in line for line in outcome.said):
        yield f"the checkpoint ends after {taken} samples, and nothing is said"


def _record(outcome: Outcome, fault: Fault | None) -> Iterator[str]:
    import pyarrow.parquet

    numbers: list[int] = []
    for part in sorted((outcome.folder / "record" / "samples").glob("part-*.parquet")):
        numbers += pyarrow.parquet.read_table(part).column("n").to_pylist()
    for part in (outcome.folder / "record" / "estimates").glob("part-*.parquet"):
        pyarrow.parquet.read_table(part)
    if numbers != sorted(set(numbers)):
        yield "recorded samples are not in order"
    if outcome.code == 0 and len(numbers) < SAMPLES and not any("record" in line for line in outcome.said):
        yield f"{len(numbers)} samples are recorded, and nothing is said"


def _lines(outcome: Outcome, fault: Fault | None) -> Iterator[str]:
    """Each estimate on standard output is whole, but for one that the failing call cut off."""
    broken = [line for line in outcome.out.splitlines() if not _is_json(line)]
    allowed = 1 if fault is not None and fault.kind in ("write", "send") else 0
    if len(broken) > allowed and not fault.lasting:
        yield f"{len(broken)} broken lines on standard output: {broken[0]!r}"


def _is_json(line: str) -> bool:
    try:
        return bool(re.match(r"\{", line)) and isinstance(json.loads(line), dict)
    except ValueError:
        return False
