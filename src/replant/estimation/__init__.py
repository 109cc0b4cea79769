"""Estimation: record in, estimate out: filters, optimizers, the kernels' state, simulation, the record solver."""
