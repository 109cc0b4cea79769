"""Plots of arrays, for notebooks and scripts: colours, and one function a kind of plot."""
