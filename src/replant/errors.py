"""The errors that replant raises for a user's mistake: one hierarchy, each message one line that says what to do."""

from __future__ import annotations


class ReplantError(Exception):
    """Base of all errors of this package; the command line prints its message and exits with code 2."""


class InvalidArgumentError(ReplantError, ValueError):
    """An argument whose value cannot be used: the message names it and what is allowed."""


class ArgumentTypeError(ReplantError, TypeError):
    """An argument of the wrong type: the message names it and the type that came."""


class LogError(ReplantError, ValueError):
    """A log file that cannot be read as asked: the message names the file, the column and the row."""


class MissingDependencyError(ReplantError, ImportError):
    """An optional package that is not installed: the message names the extra that brings it."""


class SystemRefusedError(ReplantError):
    """The system gives no more memory, files, threads or room: the message says what it was for, and what to do."""


class UnsupportedDependencyError(ReplantError, ImportError):
    """A package in a version that replant is not tested with: the message names it and the versions that fit."""


class CheckpointError(ReplantError):
    """A checkpoint that cannot be written or read: the message names the file, why, and what is left as it was."""


class DamagedCheckpointError(CheckpointError, ValueError):
    """Bytes that are not a whole checkpoint which this version can read: the message says what is wrong with them."""


class MissingCheckpointError(CheckpointError, FileNotFoundError):
    """No checkpoint under that name, nor a previous one beside it."""
