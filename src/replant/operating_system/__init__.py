"""The operating system: threads whose start is checked, and its refusals in words."""
