"""Recorded logs: CSV, Parquet, MATLAB and npz files read into input, output and sampling time."""

from replant.logs.log import Log
from replant.logs.read import read_columns, read_log
from replant.logs.table import Table

__all__ = ["Log", "Table", "read_columns", "read_log"]
