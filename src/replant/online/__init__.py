"""The identifier that learns sample by sample."""
