"""Measurement data files (.mf4, .mdf), with asammdf: channels by name, over the time of their groups."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replant.data.logs import limits
from replant.data.logs.archive import DEFLATE_RATIO
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.merge_rasters import Signal
from replant.data.logs.rasters import Channel, channel_table
from replant.data.logs.table import Table
from replant.data.logs.text_units import with_units
from replant.errors import LogError, MissingDependencyError, shown

TIME = 1  # kind of a group's master channel that is time; others are angle, distance and index [code]

_MAGIC = (b"MDF     ", b"UnFinMF ")
_REMEDY = "copy it again, or export it as CSV"
_COPIES = 4
"""Arrays held at once, each beside a column as float64: asammdf's bytes, stamps and values, and ours [count]."""


def read(path: Path) -> Table:
    """Open a measurement data file of version 3 or 4.

    A channel is called by its name; where several groups have it, as ``group/name``.
    """
    with _opened(path) as log:
        found = list(limits.at_most(path, _listed(log), "channels"))
    twice = {name for name, count in Counter(name for _, _, _, name, _ in found).items() if count > 1}
    names = with_units(
        [f"{group}/{name}" if name in twice else name for _, _, group, name, _ in found], [unit for *_, unit in found]
    )
    places = [(group, number) for group, number, *_ in found]
    return channel_table(
        path,
        [Channel(name, partial(_signal, path, name, *place)) for name, place in zip(names, places, strict=True)],
    )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        from asammdf import MDF
    except ImportError as error:
        raise MissingDependencyError(f"{path}: reading MDF needs asammdf: pip install asammdf") from error
    with path.open("rb") as file:
        if not file.read(len(_MAGIC[0])).startswith(_MAGIC):
            raise LogError(f"{path}: not a measurement data file; {_REMEDY}")
    with damage_as_log_error(path, "measurement data file", _REMEDY), MDF(str(path)) as log:
        yield log


def _listed(file: Any) -> Iterator[tuple[int, int, str, str, str]]:
    """Yield the channels over time: group, number in the group, name of the group, name, unit."""
    for group, about in enumerate(file.groups):
        master = file.masters_db.get(group)
        if master is None or getattr(about.channels[master], "sync_type", TIME) != TIME:
            continue
        name = str(getattr(about.channel_group, "acq_name", "") or f"group {group}")
        for number, channel in enumerate(about.channels):
            if number != master:
                yield group, number, name, str(channel.name), _unit(channel)


def _unit(channel: Any) -> str:
    conversion = getattr(channel, "conversion", None)
    return str(getattr(channel, "unit", "") or getattr(conversion, "unit", "") or "").strip()


def _signal(path: Path, name: str, group: int, number: int) -> Signal:
    """Return stamps and values of a channel, NaN where the logger marked it as invalid."""
    with _opened(path) as file:
        rows = min(int(file.groups[group].channel_group.cycles_nr), DEFLATE_RATIO * path.stat().st_size)
        limits.allow(held=_COPIES * 8 * rows)
        found = file.get(group=group, index=number, ignore_invalidation_bits=True)
        if found.samples.dtype.kind not in "biuf" or found.samples.ndim != 1:
            raise LogError(f"{path}: column {shown(name)} holds no numbers; choose another column")
        values = np.array(found.samples, np.float64)
        if found.invalidation_bits is not None:
            values[np.asarray(found.invalidation_bits, np.bool_)] = np.nan
        return Signal(np.array(found.timestamps, np.float64), values)
