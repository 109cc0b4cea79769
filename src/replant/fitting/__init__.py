"""Fitting: fit and search over records, inspection of a log, and the `Model`: JSON, responses, validation."""
