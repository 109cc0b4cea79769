"""Fleets: a model of each of thousands of rigs, and sweeps over records, on the executors of one machine or many.

See docs/fleet.md.
"""

from replant.fleet.fit import Fleet, Trial, fit, load, sweep
from replant.fleet.page import write_page

__all__ = ["Fleet", "Trial", "fit", "load", "sweep", "write_page"]
