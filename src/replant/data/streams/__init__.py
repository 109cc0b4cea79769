"""Live samples from a wire, a log or a simulated rig: ``open_source(url).batches()``."""

from __future__ import annotations

from replant.sources.batch import Batch
from replant.sources.opening import open_source
from replant.sources.source import Source

__all__ = ["Batch", "Source", "open_source"]
