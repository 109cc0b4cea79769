"""Plots of a `Model` and of a validation, for notebooks and scripts; those of a result lie in `report`."""
