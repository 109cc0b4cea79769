"""The session: one loop from source to outputs, with checkpoints."""
