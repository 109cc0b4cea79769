"""Inspection: what is in a recorded log, and which columns look like time, input, output and reference."""

from replant.data.inspection.inspect import Inspection, inspect, options_of

__all__ = ["Inspection", "inspect", "options_of"]
