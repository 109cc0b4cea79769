"""A separate Python process for a parser: compiled ones may crash on damaged bytes, and would take all with them.

The script is started by its path, so that it imports neither replant nor the user's script.  Its answer on standard
output is a line of JSON, and perhaps bytes after it.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from replant.errors import LogError

MEMORY_PER_BYTE = 32
"""Memory that the process may take for each byte of the file, beside that for any file [bytes]."""
SECONDS_PER_BYTE = 1e-6
"""Time that the process may take for each byte of the file, beside that for any file [s]."""

_CRASHES = {"SIGSEGV", "SIGBUS", "SIGABRT", "SIGFPE", "SIGILL"}


@dataclass(frozen=True)
class Parser:
    """What reads a kind of files.

    Parameters
    ----------
    kind : str
        The kind, for messages, as ``a MATLAB file``.
    library : str
        The library that parses it.
    remedy : str
        What to do about a damaged file.
    seconds : float
        Time that it may take for any file [s].
    memory : int
        Memory that it may take for any file [bytes].
    """

    kind: str
    library: str
    remedy: str
    seconds: float
    memory: int


def is_possible() -> bool:
    """Return whether there is a Python to start: not where it is part of a program."""
    return bool(sys.executable) and not getattr(sys, "frozen", False)


def run(parser: Parser, path: Path, script: str, arguments: Sequence[str] = (), stdin: BinaryIO | None = None) -> bytes:
    """Return what a script writes to standard output, called with the largest memory, the arguments, and ``sys.path``.

    Raises
    ------
    LogError
        If the process does not start, crashes or takes too long.
    """
    size = path.stat().st_size if stdin is None else os.fstat(stdin.fileno()).st_size
    seconds = parser.seconds + SECONDS_PER_BYTE * size
    folders = [entry for entry in sys.path if isinstance(entry, str)]
    command = [sys.executable, "-P", script, str(parser.memory + MEMORY_PER_BYTE * size), *arguments, *folders]
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command, stdin=stdin or subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            env=environment, timeout=seconds, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise LogError(f"{path}: the file is damaged: reading it takes over {seconds:.0f} s; {parser.remedy}") from None
    except OSError as error:
        reason = error.strerror or error
        raise LogError(
            f"{path}: {parser.kind} is read by a second Python, and {sys.executable} did not start ({reason}); "
            "save the signals as CSV"
        ) from error
    if done.returncode != 0:
        raise process_error(parser, path, done.returncode)
    return done.stdout


def process_error(parser: Parser, path: Path, code: int) -> LogError:
    """Return the error for a process that ended before it had read the file.

    Examples
    --------
    >>> parser = Parser("a MATLAB file", "SciPy", "save it again", seconds=120.0, memory=1 << 32)
    >>> str(process_error(parser, Path("log.mat"), 3))
    'log.mat: the process that reads it was ended (code 3); free some memory, and try again'
    """
    name = signal.Signals(-code).name if -code in set(signal.Signals) else f"code {code}"
    if name in _CRASHES or os.name == "nt":
        return LogError(
            f"{path}: the file is damaged: {parser.library}'s reader crashed on it ({name}); {parser.remedy}"
        )
    return LogError(f"{path}: the process that reads it was ended ({name}); free some memory, and try again")


def message_of(answer: bytes) -> tuple[dict[str, Any], int]:
    r"""Return the line of JSON that an answer begins with, and where its bytes begin.

    Raises
    ------
    ValueError
        If it is no such line, or an error.

    Examples
    --------
    >>> message_of(b'{"names": ["u"]}\n12345678')
    ({'names': ['u']}, 17)
    """
    end = answer.find(b"\n") + 1
    message: dict[str, Any] = json.loads(answer[:end])
    if "error" in message:
        raise ValueError(message["error"])
    return message, end
