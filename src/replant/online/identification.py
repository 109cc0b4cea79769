"""Identification: what identifiers of all kinds have in common: copies, checkpoints, and a freeze."""

from __future__ import annotations

import copy
from typing import Self

from replant.errors import InvalidArgumentError
from replant.online.checkpoint_file import AnyPath, Progress, write
from replant.online.locking import Shared, changes, reads


def check_begun(is_begun: bool) -> None:
    """Raise InvalidArgumentError during a start-up, when there is nothing to freeze."""
    if not is_begun:
        raise InvalidArgumentError(
            "freezing needs a model, and the samples for the first one are still being collected: try again later"
        )


class Adapting(Shared):
    """Estimates that follow the samples, or are frozen."""

    @changes
    def freeze(self) -> None:
        """Stop adapting: the filters still take samples, the estimate does not change.

        Raises
        ------
        InvalidArgumentError
            During start-up, when there is no estimate yet; in an ensemble, while any member is in its start-up.
        """
        self._adapt(False)

    @changes
    def resume(self) -> None:
        """Adapt again after `freeze`.

        With several inputs sample by sample, without solutions and tests for changes until `reset`.

        Raises
        ------
        InvalidArgumentError
            As for `freeze`; never with several inputs.
        """
        self._adapt(True)

    def _adapt(self, adapt: bool) -> None:
        raise NotImplementedError


class Identification(Adapting):
    """Copies and checkpoints of an identifier."""

    def clone(self) -> Self:
        """Return an independent copy in the same state."""
        return copy.deepcopy(self)

    __copy__ = clone

    def save(self, path: AnyPath, progress: Progress | None = None) -> None:
        """Save the whole state to a file, from which `replant.load` continues to the bit.

        The file is replaced atomically; the one before is kept as ``path`` + ".previous".

        Parameters
        ----------
        path : path
        progress : dict, optional
            Values of int, float and str that `replant.online.saving.load` returns, such as the position in a source.

        Raises
        ------
        CheckpointError
            If the file cannot be written; the existing one stays.
        InvalidArgumentError
            If something cannot be saved, such as an ``input_map`` that is a function.
        """
        write(path, self.to_bytes(progress))

    @reads
    def to_bytes(self, progress: Progress | None = None) -> bytes:
        """Return the whole state as bytes for `Identifier.from_bytes`; equal states give equal bytes.  See `save`.

        Parameters
        ----------
        progress : dict, optional
            As in `save`.

        Raises
        ------
        InvalidArgumentError
            If something cannot be saved, such as an ``input_map`` that is a function.
        """
        return self._encoded(progress)

    def _encoded(self, progress: Progress | None) -> bytes:
        raise NotImplementedError
