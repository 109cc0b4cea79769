"""Damage: the errors of the libraries that parse files, turned into one `LogError`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replant.errors import LogError, ReplantError


@contextmanager
def damage_as_log_error(path: Path, kind: str, remedy: str) -> Iterator[None]:
    """Turn the errors of a library that parses a file into a LogError.

    On damaged bytes such a library fails with almost any exception.  Errors of the operating system and of replant are
    raised as they are.

    >>> with damage_as_log_error(Path("log.npz"), ".npz archive", "save it with numpy.savez"):
    ...     raise KeyError("u.npy")
    Traceback (most recent call last):
    replant.errors.LogError: log.npz: not a readable .npz archive ('u.npy'); save it with numpy.savez
    """
    try:
        yield
    except ReplantError:
        raise
    except MemoryError:
        reason = "reading it takes more memory than its samples justify"
        raise LogError(f"{path}: not a readable {kind} ({reason}); {remedy}") from None
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LogError(f"{path}: not a readable {kind} ({reason[:120]}); {remedy}") from error
