"""Conversion to and from python-control, SciPy, pandas and xarray."""
