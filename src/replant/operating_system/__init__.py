"""The operating system: threads whose start is checked, files that are whole, and refusals in words."""
