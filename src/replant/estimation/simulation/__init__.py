"""Simulation: a model run over a record, its offset and initial state fitted, and its fit in percent."""
