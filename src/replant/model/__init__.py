"""The mathematics of a model: structure, transfer function, state space, forced response and uncertainty; immutable values."""
