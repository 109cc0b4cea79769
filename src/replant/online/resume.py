"""Resume: an identifier loaded from its checkpoint (`rp.load`)."""

from __future__ import annotations

import warnings

from replant.online import saving
from replant.online.checkpoint_file import AnyPath
from replant.online.identifier import Identifier


def load(path: AnyPath) -> Identifier:
    """Return the identifier that `Identifier.save` wrote; it continues to the bit as if it had never stopped.

    If the file is damaged or missing, the previous one (``path`` + ".previous") is used, with a warning.

    Parameters
    ----------
    path : path

    Raises
    ------
    MissingCheckpointError
        If there is no such file.
    DamagedCheckpointError
        If it is not a checkpoint, damaged, cut off, or of a version that cannot be read: one line says which.
    CheckpointError
        If the system does not allow reading it.

    See Also
    --------
    replant.online.saving.load : also returns the progress saved with it, and why the previous file was used.

    Examples
    --------
    >>> import tempfile, replant as rp
    >>> ident = rp.Identifier(rp.Structure(poles=1), dt=0.01)
    >>> _ = ident.update(1.0, 0.0)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     ident.save(f"{folder}/rig")
    ...     again = rp.load(f"{folder}/rig")
    >>> again.samples, again.to_bytes() == ident.to_bytes()
    (1, True)
    """
    loaded = saving.load(path)
    if loaded.used_previous:
        warnings.warn(f"{loaded.used_previous}; the previous checkpoint is used instead", stacklevel=2)
    return loaded.identifier
