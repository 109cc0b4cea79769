"""Checkpoint: exact save and resume.

`encoding` makes bytes of an identifier and back, `files` keeps bytes on disk through any crash, `store` joins them.
"""

from replant.online.saving import Loaded, load, save

__all__ = ["Loaded", "load", "save"]
