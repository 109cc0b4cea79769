"""Accuracy: Monte Carlo over scenarios and methods, beside the truth and beside what is promised."""
