"""Files of measured channels: MDF (asammdf), TDMS of LabVIEW (npTDMS), ULog of PX4 (pyulog), MCAP and ROS 2 (mcap).

TDMS: a channel with waveform properties (wf_start_offset, wf_increment, perhaps wf_start_time) has its own time stamps.
If a channel of the file has none, the file is a table, and the time is one of its columns.

MCAP: messages of ROS 2 (CDR) and JSON are decoded.  The time of a message is its recording time, on a clock that all
topics share; the stamp of a header is a separate column.
"""

from __future__ import annotations

import json
import math
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from replant.errors import LogError, shown
from replant.logs.merged_channels import Signal, channel_table
from replant.logs.parser_process import allow
from replant.logs.table import DEFLATE_RATIO, Arrays, Table, at_most, damage_as_log_error, needed
from replant.logs.text_cells import with_units

TIME = 1  # sync type of a master channel that is time; others are angle, distance and index [code]
_MAGIC = (b"MDF     ", b"UnFinMF ")
_REMEDY = "copy it again, or export it as CSV"
_COPIES = 4  # arrays held for a column: asammdf's bytes, stamps and values, and the result [count]


def read_mdf(path: Path) -> Table:
    """Open a measurement data file of version 3 or 4; a channel name of several groups becomes ``group/name``."""
    with _opened(path) as log:
        found = list(at_most(path, _listed(log), "channels"))
    twice = {name for name, count in Counter(name for _, _, _, name, _ in found).items() if count > 1}
    names = with_units(
        [f"{group}/{name}" if name in twice else name for _, _, group, name, _ in found], [unit for *_, unit in found]
    )
    places = [(group, number) for group, number, *_ in found]
    channels = [(name, partial(_signal, path, name, *place)) for name, place in zip(names, places, strict=True)]
    return channel_table(path, channels)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    asammdf = needed(path, "asammdf", "reading MDF needs asammdf", "asammdf")
    with path.open("rb") as file:
        if not file.read(len(_MAGIC[0])).startswith(_MAGIC):
            raise LogError(f"{path}: not a measurement data file; {_REMEDY}")
    with damage_as_log_error(path, "measurement data file", _REMEDY), asammdf.MDF(str(path)) as log:
        yield log


def _listed(file: Any) -> Iterator[tuple[int, int, str, str, str]]:
    """Yield the channels over time: group number, number in the group, name of the group, name, unit."""
    for group, about in enumerate(file.groups):
        master = file.masters_db.get(group)
        if master is None or getattr(about.channels[master], "sync_type", TIME) != TIME:
            continue
        name = str(getattr(about.channel_group, "acq_name", "") or f"group {group}")
        for number, channel in enumerate(about.channels):
            if number != master:
                stated = getattr(channel, "unit", "") or getattr(getattr(channel, "conversion", None), "unit", "")
                yield group, number, name, str(channel.name), str(stated or "").strip()


def _signal(path: Path, name: str, group: int, number: int) -> Signal:
    """Return stamps and values of a channel, NaN where the logger marked it as invalid."""
    with _opened(path) as file:
        rows = min(int(file.groups[group].channel_group.cycles_nr), DEFLATE_RATIO * path.stat().st_size)
        allow(held=_COPIES * 8 * rows)
        found = file.get(group=group, index=number, ignore_invalidation_bits=True)
        if found.samples.dtype.kind not in "biuf" or found.samples.ndim != 1:
            raise LogError(f"{path}: column {shown(name)} holds no numbers; choose another column")
        values = np.array(found.samples, np.float64)
        if found.invalidation_bits is not None:
            values[np.asarray(found.invalidation_bits, np.bool_)] = np.nan
        return Signal(np.array(found.timestamps, np.float64), values)


_TDMS_COPIES = 3  # arrays held at once for a column: npTDMS's values, the result and the stamps [count]

_Place = tuple[str, str]


def read_tdms(path: Path) -> Table:
    """Open a TDMS file."""
    with _opened_of_tdms(path) as file:
        listed = at_most(path, (one for group in file.groups() for one in group.channels()), "channels")
        channels = [one for one in listed if one.dtype.kind in "biufM" and len(one)]
        places: list[_Place] = [(one.group_name, one.name) for one in channels]
        names = with_units(
            [f"{group}/{name}" for group, name in places],
            [str(one.properties.get("unit_string", "")).strip() for one in channels],
        )
        stamps = frozenset(number for number, one in enumerate(channels) if one.dtype.kind == "M")
        clocks = [clock for one in channels if (clock := _clock(one)) is not None]
    if not channels:
        raise LogError(f"{path}: no channel of numbers in the file; choose another file")
    if len(clocks) == len(channels):
        starts = [start for start, _, _ in clocks if start is not None]
        origin = min(starts) if len(starts) == len(clocks) else None
        read = [partial(_signal_of_tdms, path, *each, origin) for each in zip(places, clocks, strict=True)]
        return channel_table(path, list(zip(names, read, strict=True)))
    return Table(
        path,
        names,
        lambda numbers: iter([_tdms_values(path, [places[number] for number in numbers])]),
        in_seconds=stamps,
    )


@contextmanager
def _opened_of_tdms(path: Path) -> Iterator[Any]:
    tdms = needed(path, "nptdms", "reading TDMS needs npTDMS", "npTDMS").TdmsFile
    with damage_as_log_error(path, "TDMS file", _REMEDY), path.open("rb") as opened, tdms.open(opened) as file:
        yield file


def _clock(channel: Any) -> tuple[int | None, float, float] | None:
    """Return start time in ns (or None), offset and increment in s of a waveform; None if it is none."""
    about = channel.properties
    increment = float(about.get("wf_increment", 0.0))
    if not increment > 0.0 or channel.dtype.kind == "M":
        return None
    start = about.get("wf_start_time")
    began = None if start is None else int(np.datetime64(start, "ns").astype(np.int64))
    return began, float(about.get("wf_start_offset", 0.0)), increment


def _signal_of_tdms(path: Path, place: _Place, clock: tuple[int | None, float, float], origin: int | None) -> Signal:
    start, offset, increment = clock
    (values,) = _tdms_values(path, [place])
    begin = offset + (0.0 if origin is None or start is None else (start - origin) / 1e9)
    return Signal(np.asarray(begin + increment * np.arange(values.size), np.float64), values)


def _tdms_values(path: Path, places: Sequence[_Place]) -> Arrays:
    arrays = []
    with _opened_of_tdms(path) as file:
        for group, name in places:
            channel = file[group][name]
            allow(held=_TDMS_COPIES * 8 * min(len(channel), path.stat().st_size))
            values = np.asarray(channel[:])
            if values.dtype.kind == "M":
                counts = values.astype("datetime64[ns]").astype(np.int64)
                values = (counts - counts[:1]) / 1e9
            arrays.append(np.array(values, np.float64))
    return arrays


_STAMP = "timestamp"
_ULOG_COPIES = 2  # memory of pyulog: the messages, and their fields as arrays [times the file]
_PER_SECOND = 1_000_000  # unit of the stamps [1/s]


def read_ulog(path: Path) -> Table:
    """Open a ULog file; several instances of a topic give the columns ``topic[0].field``, ``topic[1].field``."""
    pyulog = needed(path, "pyulog", "reading ULog needs pyulog", "'replant[ulog]'")
    with damage_as_log_error(path, "ULog file", "copy it again"), path.open("rb") as file:
        allow(held=_ULOG_COPIES * path.stat().st_size)  # pyulog holds the whole file
        log = pyulog.ULog(file)
        topics = [topic for topic in log.data_list if len(topic.data.get(_STAMP, ()))]
        instances = Counter(topic.name for topic in topics)
        notes = []
        if log.dropouts:
            lost = sum(dropout.duration for dropout in log.dropouts)
            notes.append(f"{path}: the logger lost samples for {lost / 1000:.3g} s, in {len(log.dropouts)} gaps")
        if log.file_corruption:
            notes.append(f"{path}: a part of the file is damaged and left out")
        channels = []
        for topic in topics:
            name = f"{topic.name}[{topic.multi_id}]" if instances[topic.name] > 1 else str(topic.name)
            stamps = topic.data.pop(_STAMP)
            channels += [
                (f"{name}.{field}", partial(_signal_of_ulog, stamps, values, log.start_timestamp))
                for field, values in topic.data.items()
                if values.dtype.kind in "biuf"
            ]
    return replace(channel_table(path, channels), notes=tuple(notes))


def _signal_of_ulog(stamps: Any, values: Any, start: int) -> Signal:
    elapsed = (np.asarray(stamps, np.uint64) - np.uint64(start % 2**64)).astype(np.int64)  # modulo 2**64
    return Signal(np.asarray(elapsed / _PER_SECOND, np.float64), np.array(values, np.float64))


MOST_ITEMS = 64  # longest list whose items become columns [items]
DEEPEST = 32  # deepest nesting of objects in a message that is read [count]
_COUNTED = 1 << 14  # messages between two requests for memory [messages]
_MCAP_COPIES = 3  # numbers held for each value: stamp and value while reading, and the resulting arrays [count]

_Keys = tuple[str | int, ...]


def read_mcap(path: Path) -> Table:
    """Open an MCAP file or the folder of a ROS 2 bag; the first message of each topic determines the columns."""
    parts = parts_of(path) if path.is_dir() else [path]
    first: dict[str, Any] = {}
    begins: list[int] = []
    encodings: set[str] = set()
    for part in parts:
        with _opened_of_mcap(part) as reader:
            from mcap.exceptions import DecoderNotFoundError

            summary = reader.get_summary()
            topics = {channel.topic for channel in summary.channels.values()} if summary is not None else set()
            for topic in sorted(topics):
                for _, channel, message in islice(reader.iter_messages(topics=[topic]), 1):
                    begins.append(message.log_time)
                    if topic in first:
                        continue
                    try:
                        first[topic] = next(reader.iter_decoded_messages(topics=[topic])).decoded_message
                    except DecoderNotFoundError:
                        encodings.add(channel.message_encoding)
    if not first:
        known = f" ({', '.join(sorted(encodings))})" if encodings else ""
        raise LogError(f"{path}: no message of ROS 2 or JSON in the file{known}; choose another file")
    columns = at_most(
        path, ((topic, keys) for topic, message in first.items() for keys in _keys_of(message)), "columns"
    )
    channels = []
    for topic, keys in columns:
        name = topic + "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys)
        channels.append((name, partial(_signal_of_mcap, parts, topic, keys, min(begins))))
    return channel_table(path, channels)


def parts_of(folder: Path) -> list[Path]:
    """Return the MCAP files in a folder, in the order of the numbers at the end of their names."""
    found = [part for part in folder.iterdir() if part.suffix.lower() == ".mcap" and not part.name.startswith(".")]
    return sorted(found, key=lambda part: (len(part.name), part.name))


@contextmanager
def _opened_of_mcap(path: Path) -> Iterator[Any]:
    ros2, mcap = (
        needed(path, module, "reading MCAP needs mcap", "'replant[mcap]'")
        for module in ("mcap_ros2.decoder", "mcap.reader")
    )
    with damage_as_log_error(path, "MCAP file", "repair it with: mcap recover"), path.open("rb") as file:
        as_json = SimpleNamespace(decoder_for=lambda encoding, schema: json.loads if encoding == "json" else None)
        yield mcap.make_reader(file, validate_crcs=True, decoder_factories=[as_json, ros2.DecoderFactory()])


def _signal_of_mcap(parts: Sequence[Path], topic: str, keys: _Keys, origin: int) -> Signal:
    stamps, values = array("q"), array("d")  # compact: a list takes five times the memory
    for part in parts:
        with _opened_of_mcap(part) as reader:
            for _, _, message, decoded in reader.iter_decoded_messages(topics=[topic]):
                stamps.append(message.log_time - origin)
                values.append(_number_at(decoded, keys))
                if len(stamps) % _COUNTED == 0:
                    allow(held=_MCAP_COPIES * 8 * _COUNTED)
    return Signal(np.array(stamps, np.int64) / 1e9, np.array(values, np.float64))


def _items(value: Any) -> Iterator[tuple[str | int, Any]] | None:
    """Return the keys and values of a message or a part of it; None if it is a single value."""
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


def _number_at(message: Any, keys: _Keys) -> float:
    for key in keys:
        message = dict(_items(message) or ()).get(key)
    return float(message) if isinstance(message, bool | int | float) else math.nan
