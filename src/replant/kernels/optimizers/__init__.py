"""The loops by which the estimate moves."""
