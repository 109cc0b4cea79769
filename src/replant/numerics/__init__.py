"""Numerics: checks of arguments, limits, linear algebra, projections, autoregression, and the levels of all tests."""
