"""Solver: the estimate of a record, and the changes of plant and load within it."""
