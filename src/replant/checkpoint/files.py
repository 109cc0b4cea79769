"""A file that is whole at every moment: written beside, synced, put in place; the previous one is kept.

The order makes it so.  The file is replaced in one step, by bytes that are on the disk already; what it was has got a
second name before, and takes the place of the previous one when the new file is safe.  The previous one is thus given
up last: should the file have been damaged meanwhile, there is another until the new one is there.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import stat
from pathlib import Path

from replant.errors import CheckpointError, MissingCheckpointError

AnyPath = str | os.PathLike[str]

LARGEST = 2**36
"""Largest file that is read as a checkpoint [bytes]."""


def write(path: AnyPath, data: bytes) -> None:
    """Put ``data`` in the place of the file ``path``, and keep what was there as ``path`` + ".previous".

    When it returns, the data are on the disk.  One process may write a file; any may read it meanwhile.

    Raises
    ------
    CheckpointError
        If it cannot be written: no such folder, a full or read-only disk.  The file is then as it was.
    """
    file = _behind(path)
    try:
        if file.exists() and not file.is_file():  # not even root shall replace a device
            raise OSError(errno.EINVAL, "there is something that is not a file")
        _replace(file, data)
    except (OSError, ValueError) as error:
        raise CheckpointError(f"{path}: the checkpoint could not be written ({reason_of(error)})") from error


def read(path: AnyPath) -> bytes:
    """Return the bytes of a file.

    Raises
    ------
    MissingCheckpointError, CheckpointError
        If there is none, or it cannot be read.
    """
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
    """Return the name under which `write` keeps what was there before."""
    return _beside(_behind(path), ".previous")


def reason_of(error: Exception) -> str:
    """Return the system's own words for an error, on one line."""
    words = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return " ".join(words.split()) or type(error).__name__


def _behind(path: AnyPath) -> Path:
    """Return the file behind a link, for a link to stay one."""
    try:
        return Path(path).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a circle of links, a zero byte
        raise CheckpointError(f"{path}: no file can have this name ({reason_of(error)})") from error


def _beside(file: Path, ending: str) -> Path:
    return file.with_name(file.name + ending)


def _replace(file: Path, data: bytes) -> None:
    new, old = _beside(file, ".new"), _beside(file, ".old")
    try:
        _clear(new, old)  # left by a process that was killed
        with new.open("xb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        kept = _keep(file, old)
        new.replace(file)
        _sync_folder(file.parent)
        if kept:
            old.replace(_beside(file, ".previous"))
    finally:
        with contextlib.suppress(OSError):
            _clear(new, old)


def _clear(*files: Path) -> None:
    for file in files:
        file.unlink(missing_ok=True)


def _keep(file: Path, old: Path) -> bool:
    """Give the file a second name, or copy it where the disk knows no second names; return whether there is one."""
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
    """Bring a change of names down to the disk, where the system can."""
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
