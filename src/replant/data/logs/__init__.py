"""Recorded logs: CSV, Parquet, MATLAB and npz files read into input, output and sampling time."""

from replant.logs.log import Log
from replant.logs.read import open_recording, read_columns, read_log, stamped_interval
from replant.logs.recording import Recording
from replant.logs.table import Table

__all__ = ["Log", "Recording", "Table", "open_recording", "read_columns", "read_log", "stamped_interval"]
