"""Saving: load an identifier from its checkpoint file, or from the previous one."""

from __future__ import annotations

from dataclasses import dataclass

from replant.errors import CheckpointError, DamagedCheckpointError, MissingCheckpointError
from replant.online.checkpoint.encoding import decode
from replant.online.checkpoint_file import AnyPath, previous, read
from replant.online.identifier import Identifier, restored


@dataclass(frozen=True, eq=False)
class Loaded:
    """The contents of a checkpoint."""

    identifier: Identifier  # in the state in which it was saved, to the bit
    progress: dict[str, int | float | str]  # the numbers and words given to `save`
    used_previous: str | None  # why the previous checkpoint was used instead; None if it was not


def load(path: AnyPath) -> Loaded:
    """Return the contents of the file ``path``, or of the previous one if it is damaged or missing.

    Raises
    ------
    MissingCheckpointError
        If there is neither the file nor a previous one.
    DamagedCheckpointError, CheckpointError
        If none of them can be used; the message says why for each.

    Examples
    --------
    >>> import tempfile, replant as rp
    >>> ident = rp.Identifier(rp.Structure(poles=1), dt=0.01)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     ident.save(f"{folder}/rig", {"sequence": 17})
    ...     loaded = load(f"{folder}/rig")
    >>> loaded.progress, loaded.used_previous
    ({'sequence': 17}, None)
    """
    try:
        return _loaded(path)
    except CheckpointError as error:
        refused = error
    try:
        return _loaded(previous(path), str(refused))
    except MissingCheckpointError:
        raise refused from None
    except CheckpointError as error:
        kind = DamagedCheckpointError if isinstance(refused, DamagedCheckpointError) else CheckpointError
        raise kind(f"{refused}; {error}") from error


def _loaded(path: AnyPath, used_previous: str | None = None) -> Loaded:
    data = read(path)
    try:
        contents = decode(data)
        return Loaded(restored(contents.attributes), contents.progress, used_previous)
    except DamagedCheckpointError as error:
        raise DamagedCheckpointError(f"{path}: {error}") from error
