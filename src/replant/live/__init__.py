"""Live identification: a session takes samples from a source, learns them, and hands the estimates on."""
