"""Fitting: fit and search over records, a first look at a log, and the kept `Model`: JSON, responses, validation."""
