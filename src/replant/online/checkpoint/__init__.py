"""Checkpoint: an identifier as bytes, the check of these bytes, and a file that is complete at every moment.

`encoding` writes and reads the bytes, `miso` those of an identifier of several inputs, `bank` those of a bank, and
`settings_json` the settings in them; `earlier_versions` turns older ones into these.  `content_check` is the check,
`files` the file.  `replant.online.saving` uses them to save an identifier and to load it again.
"""

import importlib
import warnings
from typing import Any

_MOVED = ("Loaded", "load", "save")


def __getattr__(name: str) -> Any:
    if name in _MOVED:
        warnings.warn(
            f"replant.online.checkpoint.{name} is deprecated: write replant.online.saving.{name}",
            DeprecationWarning,
            stacklevel=2,
        )
        return getattr(importlib.import_module("replant.online.saving"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
