"""The errors that replant raises for a user's mistake: one hierarchy; each message is one line with the remedy."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager

LONGEST = 400  # longest message of an error, whatever names and values it repeats [characters]
SHOWN = 60  # longest text of one value within a message [characters]


class ReplantError(Exception):
    """Base of all errors of this package; the command line prints its message and exits with code 2.

    The message is one line of at most 400 characters; the middle of a longer message is left out.
    """

    def __init__(self, message: object = "", *more: object) -> None:
        super().__init__(brief(str(message)), *more)


def brief(text: str, longest: int = LONGEST) -> str:
    """Return a text as one line; a longer text loses its middle, as the problem comes first and the remedy last.

    >>> brief("the name 'one of a great many words' is too long: choose another one", 54)
    "the name 'one of a great many w ... choose another one"
    """
    words = " ".join(text.split())
    if len(words) <= longest:
        return words
    end = longest // 3
    return f"{words[: longest - end - 5].rstrip()} ... {words[-end:].lstrip()}"


def shown(value: object) -> str:
    """Return a value as one short line for a message, however long or deeply nested it is.

    >>> shown("volt"), shown(10**5000), shown([1.0] * 1000)
    ("'volt'", 'a whole number of 5001 digits', '[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, ...]')
    """
    return brief(_SHORT.repr_int(value, 0) if isinstance(value, int) else _SHORT.repr(value), SHOWN)


class _Short(reprlib.Repr):
    """Short text of any value, also of a whole number of any size."""

    def repr_int(self, x: int, level: int) -> str:
        if abs(x) >= 10**SHOWN:  # Python refuses to print more than 4300 digits
            return f"a whole number of {int(x.bit_length() * math.log10(2)) + 1} digits"
        return super().repr_int(x, level)


_SHORT = _Short()
_SHORT.maxstring = _SHORT.maxother = SHOWN


class InvalidArgumentError(ReplantError, ValueError):
    """The value of an argument cannot be used: the message names the argument and the values allowed."""


class ArgumentTypeError(ReplantError, TypeError):
    """An argument has the wrong type: the message names the argument and the type that was passed."""


class LogError(ReplantError, ValueError):
    """A log file cannot be read: the message names the file, and column and row where they matter."""


class ModelFileError(ReplantError, ValueError):
    """A model cannot be written to a file or read from one: the message names the file and what is wrong."""


class MissingDependencyError(ReplantError, ImportError):
    """An optional package is not installed: the message names the extra that installs it."""


@contextmanager
def needs(what: str, extra: str) -> Iterator[None]:
    """Turn a failed import into an error that names what needs the package and the extra that installs it."""
    try:
        yield
    except ImportError as cause:
        raise MissingDependencyError(f"{what}: pip install 'replant[{extra}]'") from cause


class SystemRefusedError(ReplantError):
    """The system grants no more memory, files, threads or disk space: the message names the use and the remedy."""


class InUseError(ReplantError, RuntimeError):
    """A call was made during another call on the same object: the message names the caller and the remedy."""


class UnsupportedDependencyError(ReplantError, ImportError):
    """A package has a version that replant is not tested with: the message names it and the versions allowed."""


class CheckpointError(ReplantError):
    """A checkpoint cannot be written or read: the message names the file and the reason."""


class DamagedCheckpointError(CheckpointError, ValueError):
    """The bytes are not a complete checkpoint that this version can read: the message says what is wrong."""


class MissingCheckpointError(CheckpointError, FileNotFoundError):
    """Neither a checkpoint of this name nor a previous version of it exists."""
