"""Runs of an identifier over a whole record, their results, and the comparison of methods."""

from replant.online.runs.run import run_online

__all__ = ["run_online"]
