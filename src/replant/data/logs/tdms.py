"""TDMS files of LabVIEW (.tdms), with npTDMS: channels as ``group/channel``.

A channel with waveform properties (wf_start_offset, wf_increment, perhaps wf_start_time) has time stamps of its own.
In a file where one has none, the time is a column, as in a table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replant.data.logs import limits
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.merge_rasters import Signal
from replant.data.logs.rasters import Channel, channel_table
from replant.data.logs.table import Table
from replant.data.logs.text_units import with_units
from replant.errors import LogError, MissingDependencyError

_COPIES = 3  # arrays held at once, each beside a column as float64: npTDMS's values, ours and the stamps [count]

_Place = tuple[str, str]


def read(path: Path) -> Table:
    """Open a TDMS file."""
    with _opened(path) as file:
        listed = limits.at_most(path, (one for group in file.groups() for one in group.channels()), "channels")
        channels = [one for one in listed if one.dtype.kind in "biufM" and len(one)]
        places: list[_Place] = [(one.group_name, one.name) for one in channels]
        names = with_units(
            [f"{group}/{name}" for group, name in places],
            [str(one.properties.get("unit_string", "")).strip() for one in channels],
        )
        stamps = frozenset(number for number, one in enumerate(channels) if one.dtype.kind == "M")
        clocks = [_clock(one) for one in channels]
    if not channels:
        raise LogError(f"{path}: no channel of numbers in the file; choose another file")
    if all(clock is not None for clock in clocks):
        known = [clock for clock in clocks if clock is not None]
        starts = [_nanoseconds(start) for start, _, _ in known if start is not None]
        origin = min(starts) if len(starts) == len(known) else None
        return channel_table(
            path,
            [
                Channel(name, partial(_signal, path, place, clock, origin))
                for name, place, clock in zip(names, places, known, strict=True)
            ],
        )
    return Table(path, names, partial(_blocks, path, places), in_seconds=stamps)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from nptdms import TdmsFile
    except ImportError as error:
        raise MissingDependencyError(f"{path}: reading TDMS needs npTDMS: pip install npTDMS") from error
    remedy = "copy it again, or export it as CSV"
    with damage_as_log_error(path, "TDMS file", remedy), path.open("rb") as opened, TdmsFile.open(opened) as file:
        yield file


def _clock(channel: Any) -> tuple[Any, float, float] | None:
    """Return start time (or None), offset and increment of a waveform; None if it is none."""
    about = channel.properties
    increment = float(about.get("wf_increment", 0.0))
    if not increment > 0.0 or channel.dtype.kind == "M":
        return None
    return about.get("wf_start_time"), float(about.get("wf_start_offset", 0.0)), increment


def _nanoseconds(start: Any) -> int:
    return int(np.datetime64(start, "ns").astype(np.int64))


def _signal(path: Path, place: _Place, clock: tuple[Any, float, float], origin: int | None) -> Signal:
    start, offset, increment = clock
    with _opened(path) as file:
        values = _values(file, place, path.stat().st_size)
    begin = offset + (0.0 if origin is None else (_nanoseconds(start) - origin) / 1e9)
    return Signal(np.asarray(begin + increment * np.arange(values.size), np.float64), values)


def _blocks(path: Path, places: Sequence[_Place], numbers: Sequence[int]) -> Iterator[list[NDArray[np.float64]]]:
    with _opened(path) as file:
        yield [_values(file, places[number], path.stat().st_size) for number in numbers]


def _values(file: Any, place: _Place, size: int) -> NDArray[np.float64]:
    group, name = place
    channel = file[group][name]
    limits.allow(held=_COPIES * 8 * min(len(channel), size))
    values = np.asarray(channel[:])
    if values.dtype.kind == "M":
        counts = values.astype("datetime64[ns]").astype(np.int64)
        return np.asarray((counts - counts[:1]) / 1e9, np.float64)
    return np.array(values, np.float64)
