"""The mathematics of a model: structure, transfer function, state space, response and uncertainty; immutable values."""
