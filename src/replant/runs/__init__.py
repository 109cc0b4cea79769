"""One pass over a record: progress, thinned history, comparison of methods."""

from replant.runs.run import Result, run_online

__all__ = ["Result", "run_online"]
