"""Curves and panels that all figures of the article share."""
