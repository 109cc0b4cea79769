"""The workbench: a local page to inspect, cut, fit and compare recorded logs and models."""
