"""Runs of an identifier over a whole record, their results, and the comparison of methods."""
