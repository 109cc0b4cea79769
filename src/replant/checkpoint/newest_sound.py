"""The newest sound checkpoint: that of a path, or where it is damaged or missing the one before it."""

from __future__ import annotations

from dataclasses import dataclass

from replant.checkpoint.encoding import Contents, decode
from replant.checkpoint.files import AnyPath, previous, read
from replant.errors import CheckpointError, DamagedCheckpointError, MissingCheckpointError


@dataclass(frozen=True, eq=False)
class Found:
    """A checkpoint that was read.

    Attributes
    ----------
    contents : Contents
    used_previous : str or None
        Why the previous checkpoint was used instead; None where it was not.
    """

    contents: Contents
    used_previous: str | None


def newest_sound(path: AnyPath) -> Found:
    """Return the checkpoint under ``path``, or the previous one where that cannot be used.

    Raises
    ------
    MissingCheckpointError
        If there is neither the file nor a previous one.
    DamagedCheckpointError, CheckpointError
        If none of them can be used; the message says why for each.
    """
    try:
        return Found(_decoded(path), None)
    except CheckpointError as error:
        refused = error
    try:
        return Found(_decoded(previous(path)), str(refused))
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
