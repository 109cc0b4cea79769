"""Processes of the workbench: commands that can be stopped, and the worker that computes for the page."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from replant.errors import ReplantError
from replant.numerics.operating_system import Worker, one_line


class Work:
    """One worker process, started at the first request, and anew where it has died."""

    def __init__(self) -> None:
        self._process: Any = None
        self._turn, self._closed = threading.Lock(), False

    def do(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return what a function of `replant.workbench.tasks` gives; waits for it."""
        with self._turn:
            try:
                self._start()
                self._wire.send((function, arguments))
                answer = self._wire.recv()
            except (EOFError, OSError):
                self._process = None
                raise ReplantError(
                    "the process that computes this has died: the memory may be too small; try again"
                ) from None
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the process, whatever it is computing."""
        self._closed, process = True, self._process
        if process is not None:
            process.kill()

    def _start(self) -> None:
        if self._closed:
            raise EOFError
        if self._process is None:
            spawn = get_context("spawn")
            self._wire, far = spawn.Pipe()
            self._process = spawn.Process(target=_answer, args=(far,), daemon=True)
            self._process.start()
            far.close()  # so that the end of the process is the end of what comes from it


def _answer(wire: Any) -> None:
    """Answer requests until the workbench has gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the server
    while True:
        try:
            function, arguments = wire.recv()
        except (EOFError, OSError):
            return
        try:
            answer = function(*arguments)
        except Exception as error:
            error.add_note(traceback.format_exc())
            answer = error
        wire.send(answer)


AT_ONCE = max(1, min(4, (os.cpu_count() or 1) - 1))  # commands that run at a time: a core is left to the page [count]
PATIENCE = 3.0  # time that a command gets to end by itself when it is stopped [s]
_PROGRESS = re.compile(r"replant: (.+?) (\d+) %")
_SAID = "replant: "


@dataclass(frozen=True)
class Outcome:
    """What a command has left: its JSON object and the file of the model, or why there is none."""

    found: dict[str, Any] | None = None
    model: str = ""
    error: str = ""


class Jobs:
    """Runs commands; each tells its progress, a stage and a part in percent, and its outcome, from other threads."""

    def __init__(
        self, progress: Callable[[str, str, int], None], finished: Callable[[str, Outcome | None], None]
    ) -> None:
        self._progress, self._finished = progress, finished
        self._waiting: deque[tuple[str, tuple[str, ...]]] = deque()
        self._running: dict[str, subprocess.Popen[str] | None] = {}
        self._stopped: set[str] = set()
        self._lock = threading.Lock()
        self._closed = False

    def start(self, name: str, words: tuple[str, ...]) -> None:
        """Run a command, when its turn has come."""
        with self._lock:
            self._waiting.append((name, words))
        self._next()

    def stop(self, name: str) -> None:
        """Stop a command, or take it off those that wait."""
        with self._lock:
            waits = [entry for entry in self._waiting if entry[0] == name]
            for entry in waits:
                self._waiting.remove(entry)
            self._stopped.add(name)
            process = self._running.get(name)
        if process is not None:
            end(process)
        if waits:
            self._finished(name, None)

    def close(self) -> None:
        """Stop all of them."""
        with self._lock:
            self._closed = True
            self._waiting.clear()
            running = list(self._running.values())
            self._stopped |= set(self._running)
        for process in running:
            if process is not None:
                end(process)

    def _next(self) -> None:
        with self._lock:
            if self._closed or len(self._running) >= AT_ONCE or not self._waiting:
                return
            name, words = self._waiting.popleft()
            self._running[name] = None
        Worker(lambda: self._run(name, words)).start()

    def _run(self, name: str, words: tuple[str, ...]) -> None:
        try:
            outcome = self._outcome(name, words)
        except OSError as error:
            outcome = Outcome(error=one_line(error))
        with self._lock:
            del self._running[name]
            stopped = name in self._stopped
            self._stopped.discard(name)
        self._finished(name, None if stopped else outcome)
        self._next()

    def _outcome(self, name: str, words: tuple[str, ...]) -> Outcome:
        self._progress(name, "starting", 0)
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
                stopped = name in self._stopped
            if stopped:
                end(process)
            last = self._listen(name, process)
            if process.wait() or not saved.is_file():
                return Outcome(error=last.removeprefix(_SAID) or f"the command ended with code {process.returncode}")
            found = json.loads(printed.read_text(encoding="utf-8"))
            return Outcome(found, saved.read_text(encoding="utf-8"))

    def _listen(self, name: str, process: subprocess.Popen[str]) -> str:
        """Pass the progress on until the command ends; return the last line that is none."""
        last = ""
        assert process.stderr is not None
        with process.stderr:
            for line in process.stderr:
                found = _PROGRESS.fullmatch(line.strip())
                if found:
                    self._progress(name, found[1], int(found[2]))
                elif line.strip():
                    last = line.strip()
        return last


def end(process: subprocess.Popen[str]) -> None:
    """End a process, by force if it does not listen."""
    with contextlib.suppress(OSError):
        process.terminate()
    try:
        process.wait(PATIENCE)
    except subprocess.TimeoutExpired:
        with contextlib.suppress(OSError):
            process.kill()
