"""Filters: state-variable banks, the chain of them, matrix exponential, Routh's test."""
