"""Live identification: a session reads samples from a source, learns them, and sends the estimates to outputs."""
