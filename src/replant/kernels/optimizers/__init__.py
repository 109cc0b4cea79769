"""The loops of the optimizers, by which the estimate moves."""
