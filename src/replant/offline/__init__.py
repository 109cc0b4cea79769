"""Estimates from a whole record."""
