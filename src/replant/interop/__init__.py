"""The way to python-control, SciPy, pandas and xarray."""
