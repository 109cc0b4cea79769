"""Measurement data files (.mf4, .mdf), with asammdf: channels by name, over the time of their groups.

asammdf may crash on damaged bytes: it runs in a separate process (`mdf_process`).
"""

from __future__ import annotations

import importlib.util
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from replant.data.logs import mdf_process, parser_process
from replant.data.logs.damage import damage_as_log_error
from replant.data.logs.merge_rasters import Signal
from replant.data.logs.parser_process import Parser
from replant.data.logs.rasters import Channel, channel_table
from replant.data.logs.table import Table
from replant.data.logs.text_units import with_units
from replant.errors import LogError, MissingDependencyError

MEMORY = 4 << 30
"""Memory that the reading process may take for any file: far above the need of a record, which compression makes at
most about ten times smaller [bytes].
"""
SECONDS = 120.0
"""Time that the reading process may take for any file [s]."""

_MAGIC = (b"MDF     ", b"UnFinMF ")
_REMEDY = "copy it again, or export it as CSV"


def read(path: Path) -> Table:
    """Open a measurement data file of version 3 or 4.

    A channel is called by its name; where several groups have it, as ``group/name``.

    Raises
    ------
    MissingDependencyError
        If asammdf is not installed.
    LogError
        If it is damaged or holds no channel over time.
    """
    if not _is_installed():
        raise MissingDependencyError(f"{path}: reading MDF needs asammdf: pip install asammdf")
    with path.open("rb") as file:
        if not file.read(len(_MAGIC[0])).startswith(_MAGIC):
            raise LogError(f"{path}: not a measurement data file; {_REMEDY}")
    with damage_as_log_error(path, "measurement data file", _REMEDY):
        if parser_process.is_possible():
            found = parser_process.message_of(_answer(path, ""))[0]["channels"]
        else:
            with mdf_process.opened(str(path)) as log:
                found = mdf_process.listed(log)
    twice = {name for name, count in Counter(name for _, _, _, name, _ in found).items() if count > 1}
    names = with_units(
        [f"{group}/{name}" if name in twice else name for _, _, group, name, _ in found], [unit for *_, unit in found]
    )
    places = [(group, number) for group, number, *_ in found]
    return channel_table(
        path,
        [Channel(name, partial(_signal, path, name, *place)) for name, place in zip(names, places, strict=True)],
    )


def _is_installed() -> bool:
    try:
        return importlib.util.find_spec("asammdf") is not None
    except ValueError:
        return False


def _answer(path: Path, channels: str) -> bytes:
    parser = Parser("a measurement data file", "asammdf", _REMEDY, SECONDS, MEMORY)
    return parser_process.run(parser, path, mdf_process.__file__, [str(path), channels])


def _signal(path: Path, name: str, group: int, number: int) -> Signal:
    with damage_as_log_error(path, "measurement data file", _REMEDY):
        if parser_process.is_possible():
            answer = _answer(path, f"{group}:{number}")
            message, at = parser_process.message_of(answer)
            (samples,) = message["samples"]
            both = None if samples is None else np.frombuffer(answer, np.float64, 2 * samples, at).reshape(2, samples)
        else:
            with mdf_process.opened(str(path)) as file:
                found = mdf_process.signal(file, group, number)
                both = None if found is None else np.array(found)
    if both is None:
        raise LogError(f"{path}: column {name!r} holds no numbers; choose another column")
    return Signal(both[0].copy(), both[1].copy())
