"""The mathematics of a model: structure, G(s), state space, forced response and uncertainty; immutable values."""
