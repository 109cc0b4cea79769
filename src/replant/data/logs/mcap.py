"""MCAP files (.mcap) and ROS 2 bags of them, with mcap: fields of messages as ``/topic.field``, over their log times.

Messages of ROS 2 (CDR) and JSON are decoded.  The time of a message is that at which it was recorded, which all topics
share; the stamp of a header is a column of its own.
"""

from __future__ import annotations

import json
import math
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.data.logs import reading
from replant.data.logs.rasters import Channel, Signal, channel_table
from replant.data.logs.reading import damage_as_log_error
from replant.data.logs.table import Table
from replant.errors import LogError, MissingDependencyError

MOST_ITEMS = 64  # length up to which the items of a list are columns [items]

DEEPEST = 32  # objects within each other in a message that are looked into [count]
_COUNTED = 1 << 14  # messages after which memory is asked for [messages]
_COPIES = 3  # numbers held at once for each value: stamps and values while they are read, and as arrays [count]

_Keys = tuple[str | int, ...]


def read(path: Path) -> Table:
    """Open an MCAP file, or the folder of a ROS 2 bag with such files.  The columns are those of each first message."""
    parts = parts_of(path) if path.is_dir() else [path]
    first: dict[str, Any] = {}
    origin: int | None = None
    encodings: set[str] = set()
    for part in parts:
        with _opened(part) as reader:
            for topic, begin in _first_messages(reader):
                origin = begin if origin is None else min(origin, begin)
                if topic in first:
                    continue
                try:
                    _, first[topic] = next(_messages(reader, topic))
                except _UnknownEncodingError as error:
                    encodings.add(str(error))
    if not first:
        known = f" ({', '.join(sorted(encodings))})" if encodings else ""
        raise LogError(f"{path}: no message of ROS 2 or JSON in the file{known}; choose another file")
    assert origin is not None
    fields = ((topic, keys) for topic, message in first.items() for keys in _keys_of(message))
    return channel_table(
        path,
        [
            Channel(topic + _written(keys), partial(_signal, parts, topic, keys, origin))
            for topic, keys in reading.at_most(path, fields, "columns")
        ],
    )


def parts_of(folder: Path) -> list[Path]:
    """Return the MCAP files in a folder, in the order of the numbers in their names.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     for name in ("bag_10.mcap", "bag_2.mcap", "metadata.yaml"):
    ...         Path(folder, name).touch()
    ...     [part.name for part in parts_of(Path(folder))]
    ['bag_2.mcap', 'bag_10.mcap']
    """
    found = [part for part in folder.iterdir() if part.suffix.lower() == ".mcap" and not part.name.startswith(".")]
    return sorted(found, key=lambda part: (len(part.name), part.name))


class _UnknownEncodingError(ValueError):
    """The messages of a topic cannot be decoded."""


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        import mcap_ros2.decoder  # noqa: F401 - said here rather than at the first message
        from mcap.reader import make_reader
    except ImportError as error:
        raise MissingDependencyError(f"{path}: reading MCAP needs mcap: pip install 'replant[mcap]'") from error
    remedy = "repair it with: mcap recover"
    with damage_as_log_error(path, "MCAP file", remedy), path.open("rb") as file:
        yield make_reader(file, validate_crcs=True)


def _first_messages(reader: Any) -> Iterator[tuple[str, int]]:
    """Yield each topic with the time of its first message, in ns."""
    summary = reader.get_summary()
    topics = {channel.topic for channel in summary.channels.values()} if summary is not None else set()
    for topic in sorted(topics):
        for _, _, message in reader.iter_messages(topics=[topic]):
            yield topic, message.log_time
            break


def _messages(reader: Any, topic: str) -> Iterator[tuple[int, Any]]:
    from mcap_ros2.decoder import DecoderFactory

    factory = DecoderFactory()
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for schema, channel, message in reader.iter_messages(topics=[topic]):
        decode = decoders.get(channel.id)
        if decode is None:
            is_json = channel.message_encoding == "json"
            decode = json.loads if is_json else factory.decoder_for(channel.message_encoding, schema)
            if decode is None:
                raise _UnknownEncodingError(channel.message_encoding)
            decoders[channel.id] = decode
        yield message.log_time, decode(message.data)


def _signal(parts: Sequence[Path], topic: str, keys: _Keys, origin: int) -> Signal:
    stamps, values = array("q"), array("d")  # compact: a list takes five times the memory
    for part in parts:
        with _opened(part) as reader:
            for stamp, message in _messages(reader, topic):
                stamps.append(stamp - origin)
                values.append(_number(_item(message, keys)))
                if len(stamps) % _COUNTED == 0:
                    reading.allow(held=_COPIES * 8 * _COUNTED)
    return Signal(np.array(stamps, np.int64) / 1e9, np.array(values, np.float64))


def _items(value: Any) -> Iterator[tuple[str | int, Any]] | None:
    """Return keys and values of what a message holds; None if it is a single value."""
    if isinstance(value, Mapping):
        return iter(value.items())
    if isinstance(value, list | tuple | array):
        return iter(enumerate(value)) if len(value) <= MOST_ITEMS else iter(())
    slots = getattr(type(value), "__slots__", None)  # a message of ROS 2
    return None if slots is None or isinstance(value, str | bytes) else ((name, getattr(value, name)) for name in slots)


def _keys_of(value: Any, above: _Keys = ()) -> Iterator[_Keys]:
    items = _items(value)
    if items is not None and len(above) < DEEPEST:
        for key, item in items:
            yield from _keys_of(item, (*above, key))
    elif isinstance(value, bool | int | float):
        yield above


def _written(keys: _Keys) -> str:
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)


def _item(message: Any, keys: _Keys) -> Any:
    for key in keys:
        message = dict(_items(message) or ()).get(key)
    return message


def _number(value: Any) -> float:
    return float(value) if isinstance(value, bool | int | float) else math.nan
