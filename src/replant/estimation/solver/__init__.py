"""Solver: the estimate of a record, of each candidate, and of what may have changed within it."""
