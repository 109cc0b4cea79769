"""Identify continuous-time transfer functions while the plant runs."""
