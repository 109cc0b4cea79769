"""Simulation: the run of a model over a record, with fitted offset and initial state, and its fit in percent."""
