"""The newest sound checkpoint: that of a path, or where it is damaged or missing the one before it."""

from __future__ import annotations

from replant.checkpoint.encoding import Contents, decode
from replant.checkpoint.files import AnyPath, previous, read
from replant.errors import CheckpointError, DamagedCheckpointError, MissingCheckpointError


def newest_sound(path: AnyPath) -> tuple[Contents, str | None]:
    """Return the checkpoint under ``path`` and None, or the previous one and why that under ``path`` cannot be used."""
    try:
        return _decoded(path), None
    except CheckpointError as error:
        refused = error
    try:
        return _decoded(previous(path)), str(refused)
    except MissingCheckpointError:
        raise refused from None
    except CheckpointError as error:
        kind = DamagedCheckpointError if isinstance(refused, DamagedCheckpointError) else CheckpointError
        raise kind(f"{refused}; {error}") from error


def _decoded(path: AnyPath) -> Contents:
    data = read(path)
    try:
        return decode(data)
    except DamagedCheckpointError as error:
        raise DamagedCheckpointError(f"{path}: {error}") from error
