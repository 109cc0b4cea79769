"""One message for a damaged file, whatever the library that met the damage raises."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from replant.errors import LogError, ReplantError


@contextmanager
def damage_refused(path: Path, kind: str, remedy: str) -> Iterator[None]:
    """Turn the errors of a library that parses a file into a LogError.

    On damaged bytes such a library fails with almost any exception. Errors of the operating system pass.

    Examples
    --------
    >>> with damage_refused(Path("log.npz"), ".npz archive", "save it with numpy.savez"):
    ...     raise KeyError("u.npy")
    Traceback (most recent call last):
    replant.errors.LogError: log.npz: not a readable .npz archive ('u.npy'); save it with numpy.savez
    """
    try:
        yield
    except ReplantError:
        raise
    except Exception as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        reason = " ".join(str(error).split()) or type(error).__name__
        raise LogError(f"{path}: not a readable {kind} ({reason[:120]}); {remedy}") from error
