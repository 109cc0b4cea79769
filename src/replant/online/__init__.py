"""The identifier that learns sample by sample, and everything that belongs to its life."""
