"""Reading files in forks: as safe from crashes as the process that reads a file for a user, and far quicker.

Lines on standard input name files; lines of JSON on standard output say what came of them.  Each fork has the limits of
a process that reads a file (`replant.logs.parser_process`).
"""

from __future__ import annotations

import importlib
import json
import os
import resource
import signal
import subprocess
import sys
import tempfile
import warnings
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from replant.errors import ReplantError
from replant.logs import parser_process, read_columns, read_log

WALL = 240  # s after which a fork hangs; its processor time is limited far below
MOST_WORDS = 300  # characters of a message beside the path


@dataclass(frozen=True)
class Outcome:
    """What came of reading a file.

    Parameters
    ----------
    kind : str
        "read", "refused" (by an error of replant), "raw" (another error), "crashed", "out of time" or "hung".
    words : str
        The message, or where the error was raised.
    memory : float
        More than before, at its peak [MiB].
    seconds : float
        Of the processor.
    """

    kind: str
    words: str = ""
    memory: float = 0.0
    seconds: float = 0.0


def is_isolated(path: Path) -> bool:
    """Whether a user's process does not read such a file itself."""
    name = parser_process.FORMATS.get(path.suffix.lower())
    return name is not None and parser_process.PARSERS[name].library != ""


def read(path: Path) -> Outcome:
    """Read a file in this process in every way that a user does."""
    try:
        if path.suffix == ".json":
            read_model(path)
        else:
            table = read_columns(path)
            table.columns(list(range(min(3, len(table.names)))))
            table.describe_row(0)
            read_log(path, input=0, output=1, dt=1.0)
    except ReplantError as error:
        fault = _fault(path, str(error))
        return Outcome("raw", f"{fault}: {error!r}") if fault else Outcome("refused", str(error))
    except BaseException as error:
        trace = error.__traceback__
        while trace is not None and trace.tb_next is not None:
            trace = trace.tb_next
        at = "" if trace is None else f" at {Path(trace.tb_frame.f_code.co_filename).name}:{trace.tb_lineno}"
        return Outcome("raw", f"{type(error).__name__}: {str(error)[:200]}{at}")
    return Outcome("read")


def read_model(path: Path) -> None:
    import replant as rp

    model = rp.load_model(path)
    str(model)
    if rp.Model.from_json(model.to_json()).to_json() != model.to_json():
        raise AssertionError("saved and loaded it is another one")


def _fault(path: Path, message: str) -> str:
    """What is wrong with a message for the user; empty if nothing is."""
    if not message.startswith(f"{path}: "):
        return "it does not name the file"
    if len(message.splitlines()) != 1:
        return "more than one line"
    return "too long" if len(message) > len(str(path)) + MOST_WORDS else ""


def work() -> None:
    """Fork for each line of standard input."""
    sys.frozen = True  # type: ignore[attr-defined]  # no process is started
    # replant reads the model with all that it needs
    for module in ["replant.fitting.model", *sys.argv[1:]]:
        importlib.import_module(module)
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # kB
    for line in iter(sys.stdin.readline, ""):
        path = Path(json.loads(line))
        receive, send = os.pipe()
        number = os.fork()
        if number == 0:
            os.close(receive)
            _one(path, send)
            os._exit(0)
        os.close(send)
        with os.fdopen(receive, "rb") as answer:
            said = answer.read()
        _, status, used = os.wait4(number, 0)
        code = os.waitstatus_to_exitcode(status)
        if code == 0 and said:
            outcome = Outcome(**json.loads(said))
        elif -code in (signal.SIGXCPU, signal.SIGALRM):
            outcome = Outcome("out of time" if -code == signal.SIGXCPU else "hung")
        else:
            outcome = Outcome("crashed", f"code {code}")
        memory = max(0, used.ru_maxrss - resident) / 1024
        print(json.dumps(asdict(replace(outcome, memory=memory, seconds=used.ru_utime + used.ru_stime))), flush=True)


def _one(path: Path, send: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    tempfile.tempdir = str(path.parent)
    signal.alarm(WALL)
    parser_process.begin(path.stat().st_size)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        outcome = read(path)
    if not is_isolated(path):  # there warnings are passed over
        foreign = [one for one in said if one.category is not UserWarning or not str(one.message).startswith(str(path))]
        if foreign and outcome.kind != "raw":
            outcome = Outcome("raw", f"warning: {foreign[0].message}")
    os.write(send, json.dumps(asdict(outcome)).encode())


class Forks:
    """A process that forks."""

    def __init__(self, *modules: str) -> None:
        environment = {**os.environ, **parser_process.ENVIRONMENT}
        tests = Path(__file__).parents[1]
        environment["PYTHONPATH"] = os.pathsep.join([str(tests), str(tests.parent / "src")])
        self._process = subprocess.Popen(
            [sys.executable, "-m", "support.forks", *modules],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )

    def read(self, path: Path) -> Outcome:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(str(path)) + "\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return Outcome(**answer)

    def __enter__(self) -> Forks:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, trace: TracebackType | None) -> None:
        self._process.kill()
        self._process.communicate()


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    work()
