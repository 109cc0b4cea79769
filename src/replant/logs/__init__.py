"""Recorded logs: files of many formats read into input, output and sampling time; columns, roles, conditioning."""

from replant.logs.columns import stamped_interval
from replant.logs.file_formats import read_columns
from replant.logs.log import Log
from replant.logs.read import open_recording, read_log
from replant.logs.recording import Recording
from replant.logs.table import Table

__all__ = [
    "Log",
    "Recording",
    "Table",
    "open_recording",
    "read_columns",
    "read_log",
    "stamped_interval",
]
