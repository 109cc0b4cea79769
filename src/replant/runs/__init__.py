"""One pass over a record: progress, thinned history, comparison of methods."""

from replant.runs.run import OnlineResult, run_online

__all__ = ["OnlineResult", "run_online"]
