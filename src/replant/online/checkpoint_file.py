"""Checkpoint file, complete at every moment: written under another name, synced, renamed; the previous one is kept.

1. The new content is written to a file ``.new`` and synced to the disk.
2. The present file gets the second name ``.old``.
3. ``.new`` is renamed to the file's name, which replaces the file in one step.
4. ``.old`` is renamed to ``.previous``, which replaces the previous file.

The previous file is replaced last: if the present file is damaged, the previous one exists until the new one does.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Mapping
from pathlib import Path

from replant.errors import CheckpointError, MissingCheckpointError
from replant.numerics.limits import file_path
from replant.numerics.operating_system import reason_of

AnyPath = str | os.PathLike[str]
Progress = Mapping[str, int | float | str]  # what a checkpoint keeps beside the identifier

LARGEST = 2**36  # largest file that is read as a checkpoint [bytes]


def write(path: AnyPath, data: bytes) -> None:
    """Replace the content of the file ``path`` by ``data``, and keep the present file as ``path`` + ".previous".

    When the function returns, the data are on the disk.  Only one process may write a file; any process may read it.
    """
    file = _resolve_link(path)
    try:
        if file.exists() and not file.is_file():  # root could replace a device
            raise OSError(errno.EINVAL, "the path is not that of a regular file")
        _replace(file, data)
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{path}: the checkpoint could not be written ({reason_of(error)})") from error


def read(path: AnyPath) -> bytes:
    """Return the bytes of a file."""
    path = file_path("path", path)
    try:
        status = Path(path).stat()
        if stat.S_ISDIR(status.st_mode):
            raise CheckpointError(f"{path}: it is a directory; give the file inside it")
        if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST:
            raise CheckpointError(f"{path}: it is not a checkpoint")
        return Path(path).read_bytes()
    except FileNotFoundError as error:
        raise MissingCheckpointError(f"{path}: no such file") from error
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{path}: it cannot be read ({reason_of(error)})") from error


def previous(path: AnyPath) -> Path:
    """Return the path under which `write` keeps the previous file."""
    return _with_ending(_resolve_link(path), ".previous")


def _resolve_link(path: AnyPath) -> Path:
    """Return the file that a link points to, so that `write` does not replace the link."""
    path = file_path("path", path)
    try:
        return Path(path).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # circular links, or a zero byte in the name
        raise CheckpointError(f"{path}: no file can have this name ({reason_of(error)})") from error


def _with_ending(file: Path, ending: str) -> Path:
    return file.with_name(file.name + ending)


def _replace(file: Path, data: bytes) -> None:
    new, old = _with_ending(file, ".new"), _with_ending(file, ".old")
    try:
        _clear(new, old)  # left by a process that was killed
        with new.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        linked = _link_or_copy(file, old)
        new.replace(file)
        _sync_folder(file.parent)
        if linked:
            old.replace(_with_ending(file, ".previous"))
    finally:
        with contextlib.suppress(OSError):
            _clear(new, old)


def _clear(*files: Path) -> None:
    for file in files:
        file.unlink(missing_ok=True)


def _link_or_copy(file: Path, old: Path) -> bool:
    """Give the file a second name, or copy it if the disk has no hard links; return whether the file exists."""
    try:
        old.hardlink_to(file)
    except FileNotFoundError:
        return False
    except OSError:
        shutil.copyfile(file, old)
        with old.open("rb+") as copy:
            os.fsync(copy.fileno())
    return True


def _sync_folder(folder: Path) -> None:
    """Sync a change of names to the disk, if the system can."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # some network disks have no such operation
            raise
    finally:
        os.close(descriptor)
