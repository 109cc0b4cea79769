"""Where estimates and records go."""
