"""ULog files of PX4 (.ulg), with pyulog: fields as ``topic.field``, over the logger's time stamps."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from replant.data.logs import limits
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.merge_rasters import Signal
from replant.data.logs.rasters import Channel, channel_table
from replant.data.logs.table import Table
from replant.errors import MissingDependencyError

_STAMP = "timestamp"
_COPIES = 2  # size of what pyulog holds: the messages, and their fields as arrays [times the file]
_PER_SECOND = 1_000_000  # unit of the stamps [1/s]


def read(path: Path) -> Table:
    """Open a ULog file.  Of several instances of a topic the columns are ``topic[0].field``, ``topic[1].field``."""
    try:
        from pyulog import ULog
    except ImportError as error:
        raise MissingDependencyError(f"{path}: reading ULog needs pyulog: pip install 'replant[ulog]'") from error
    with damage_as_log_error(path, "ULog file", "copy it again"), path.open("rb") as file:
        limits.allow(held=_COPIES * path.stat().st_size)  # pyulog holds all that is in it
        log = ULog(file)
        topics = [topic for topic in log.data_list if len(topic.data.get(_STAMP, ()))]
        instances = Counter(topic.name for topic in topics)
        channels = [
            _channel(f"{_name(topic, instances)}.{field}", topic.data[_STAMP], values, log.start_timestamp)
            for topic in topics
            for field, values in topic.data.items()
            if field != _STAMP and values.dtype.kind in "biuf"
        ]
        notes = _notes(path, log)
    table = channel_table(path, channels)
    return Table(table.path, table.names, table.blocks, table.describe_row, notes=notes, stamps=table.stamps)


def _name(topic: Any, instances: Counter[str]) -> str:
    return f"{topic.name}[{topic.multi_id}]" if instances[topic.name] > 1 else str(topic.name)


def _channel(name: str, stamps: Any, values: Any, start: int) -> Channel:
    def read_channel() -> Signal:
        elapsed = (np.asarray(stamps, np.uint64) - np.uint64(start % 2**64)).astype(np.int64)  # modulo 2**64
        return Signal(np.asarray(elapsed / _PER_SECOND, np.float64), np.array(values, np.float64))

    return Channel(name, read_channel)


def _notes(path: Path, log: Any) -> tuple[str, ...]:
    notes = []
    if log.dropouts:
        lost = sum(dropout.duration for dropout in log.dropouts)
        notes.append(f"{path}: the logger lost samples for {lost / 1000:.3g} s, in {len(log.dropouts)} gaps")
    if log.file_corruption:
        notes.append(f"{path}: a part of the file is damaged and left out")
    return tuple(notes)
