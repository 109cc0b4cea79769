"""Recorded logs: files of many formats read into input, output and sampling time."""

from replant.data.logs.formats import read_columns
from replant.data.logs.read import (
    doubtful_unit,
    open_recording,
    read_log,
    stamped_interval,
    with_inputs,
)
from replant.data.logs.recording import Recording
from replant.data.logs.table import Table
from replant.log import Log

__all__ = [
    "Log",
    "Recording",
    "Table",
    "doubtful_unit",
    "open_recording",
    "read_columns",
    "read_log",
    "stamped_interval",
    "with_inputs",
]
