"""The model: structure, transfer function and what follows from them; values, no state."""
