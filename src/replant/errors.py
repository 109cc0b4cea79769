"""The errors that replant raises for a user's mistake: one hierarchy; each message is one line that says what to do."""

from __future__ import annotations


class ReplantError(Exception):
    """Base of all errors of this package; the command line prints its message and exits with code 2."""


class InvalidArgumentError(ReplantError, ValueError):
    """The value of an argument cannot be used: the message names the argument and the values allowed."""


class ArgumentTypeError(ReplantError, TypeError):
    """An argument has the wrong type: the message names the argument and the type that was passed."""


class LogError(ReplantError, ValueError):
    """A log file cannot be read: the message names the file, and column and row where they matter."""


class ModelFileError(ReplantError, ValueError):
    """A model cannot be written to a file or read from one: the message names the file and what is wrong."""


class MissingDependencyError(ReplantError, ImportError):
    """An optional package is not installed: the message names the extra that installs it."""


class SystemRefusedError(ReplantError):
    """The system grants no more memory, files, threads or disk space: the message says for what, and what to do."""


class InUseError(ReplantError, RuntimeError):
    """A call was made within another one on the same object: the message says from where, and what to do instead."""


class UnsupportedDependencyError(ReplantError, ImportError):
    """A package has a version that replant is not tested with: the message names it and the versions allowed."""


class CheckpointError(ReplantError):
    """A checkpoint cannot be written or read: the message names the file and the reason."""


class DamagedCheckpointError(CheckpointError, ValueError):
    """The bytes are not a complete checkpoint that this version can read: the message says what is wrong."""


class MissingCheckpointError(CheckpointError, FileNotFoundError):
    """There is no checkpoint under this name, nor a previous one beside it."""
