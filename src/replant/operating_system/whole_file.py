"""A file that is whole or not there: written under another name, synced, renamed."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ENDING = ".new"


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give the name under which a file is written; it gets its own name when the ``with`` block ends without an error.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with replacing(Path(folder, "a")) as new:
    ...         _ = new.write_bytes(b"content")
    ...     [path.name for path in Path(folder).iterdir()]
    ['a']
    """
    named = zlib.crc32(os.fsencode(path.name))  # short: the name itself may be as long as names can be
    new = path.with_name(f".{named:08x}.{socket.gethostname()}.{os.getpid()}.{threading.get_ident()}{ENDING}")
    try:
        new.unlink(missing_ok=True)
        new.open("x").close()  # a new file, not what a link of this name leads to
        yield new
        with new.open("rb+") as stream:
            os.fsync(stream.fileno())
        new.replace(path)
    finally:
        with contextlib.suppress(OSError):
            new.unlink(missing_ok=True)
