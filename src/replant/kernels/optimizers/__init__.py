"""The update loops of the optimizers."""
