"""Live samples from a connection, a recorded log or a simulated rig: ``open_source(url).batches()``."""

from __future__ import annotations

from replant.live.streams.addresses import open_source
from replant.live.streams.reader_thread import Source
from replant.live.streams.source import UY, Batch, Signals

__all__ = ["UY", "Batch", "Signals", "Source", "open_source"]
