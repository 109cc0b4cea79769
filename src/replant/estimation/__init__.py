"""Estimation from a record: filters, optimizers, the state of the kernels, simulation, the record solver."""
