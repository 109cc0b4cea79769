"""One pass over a record: progress, thinned history, comparison of methods."""

from replant.runs.run import run_online

__all__ = ["run_online"]
