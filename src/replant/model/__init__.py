"""The model: structure, transfer function, state space, response and uncertainty; immutable values."""
